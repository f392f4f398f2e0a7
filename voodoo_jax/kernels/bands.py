"""Artificial point pairs: elastic bands between limbs (Knoop 2007, sec. 4.3) and weak pairs towards a predicted pose.

Both are added to the moments of the measured pairs: one path for measurements and model knowledge.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from voodoo_jax.geometry.rigid import Poses, compose, inverse, matrix, rotate, unrotate
from voodoo_jax.model.body import Links


def _pair_moments(
    weight: Float[Array, " pair"], model: Float[Array, "pair 3"], data: Float[Array, "pair 3"]
) -> Float[Array, "4 4"]:
    """Sum of w [1, c] [1, p]^T over a few pairs."""
    one = jnp.ones_like(weight)[:, None]
    c, p = jnp.concatenate([one, model], -1), jnp.concatenate([one, data], -1)
    return jnp.sum((weight[:, None] * c)[:, :, None] * p[:, None, :], 0)


def link_moments(links: Links, poses: Poses, strength: Float[Array, " limb"]) -> Float[Array, "limb 4 4"]:
    """Moments of linked points, each pair added twice: model to data on one limb, data to model on the other (4.3).

    **Arguments:** `strength` [limb] what a pair of weight 1 weighs on that limb: ratio r times the limb's measured
    weight, with a floor so that a limb without measurements still hangs on its bands.

    **Returns:** moments [limb], both points of each pair in the frame of the limb.
    """

    def side(limbs, others, own_points, other_points):
        own, other = poses[limbs], poses[others]
        world = rotate(other.rotation[:, None], other_points) + other.translation[:, None]
        data = unrotate(own.rotation[:, None], world - own.translation[:, None])
        return jax.vmap(_pair_moments)(links.weights * strength[limbs][:, None], own_points, data)

    there = side(links.first, links.second, links.first_points, links.second_points)
    back = side(links.second, links.first, links.second_points, links.first_points)
    zero = jnp.zeros((strength.shape[0], 4, 4), there.dtype)
    return zero.at[links.first].add(there).at[links.second].add(back)


def prior_moments(
    middle: Float[Array, "3"], pose: Poses, predicted: Poses, weight: Float[Array, ""], square: Float[Array, ""]
) -> tuple[Float[Array, "4 4"], Float[Array, "3 3"]]:
    """Moments of six weak pairs that pull one limb to its predicted pose and determine it where nothing else does.

    **Arguments:** `middle` of the limb, limb frame; `pose`, `predicted` of this limb; `weight` of all six pairs
    together; `square` that weight times the square of the pairs' distance, metres, from the middle along the limb's
    axes: turning by an angle costs 2/3 square angle^2 (docs/numerics.md#null-directions: never leave a direction
    undetermined).

    **Returns:** sum of w [1, c] [1, p]^T and sum of w c c^T.
    """
    difference = compose(inverse(pose), predicted)
    data = rotate(difference.rotation, middle) + difference.translation
    # the sum over the pairs written out: of the offsets +-radius along each axis, only their squares are left
    moments = _pair_moments(weight[None], middle[None], data[None])
    moments = moments.at[1:, 1:].add(square / 3 * matrix(difference.rotation).T)
    second = weight * middle[:, None] * middle[None] + square / 3 * jnp.eye(3, dtype=middle.dtype)
    return moments, second
