"""Uncertainty of limbs and joints: covariances from the normal equations of a frame's solve, calibrated.

The normal matrix says how well the measurements hold a limb, up to the variance of one of them. Neighbouring points err
together, and a person's shape differs from the body's the same way in all frames: so the variance of a measurement and
that of the shape are two numbers, found by maximum likelihood on recordings with known truth, depth only and with
features. Found on one half of the bodies, 93 % of the other half's joints lie in their 95 % regions, and the other way
round; both are set for 95 % here.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.kernels.gauss_newton import point_covariance
from voodoo_jax.model.body import Body

NOISE = 0.037  # metres, standard deviation of a measurement of weight 1, were all independent
SHAPE = 0.0158  # metres, standard deviation along each axis of a joint of a person in the model's


def limb_covariances(twist: Float[Array, "limb 6 6"]) -> Float[Array, "limb 6 6"]:
    """Covariance of each limb's pose (turn in radians, shift in metres; limb frame) from kernels.gauss_newton's."""
    shape = jnp.diag(jnp.array([0, 0, 0, 1, 1, 1], twist.dtype)) * SHAPE**2
    return NOISE**2 * twist + shape


def joint_covariances(body: Body, poses: Poses, twist: Float[Array, "limb 6 6"]) -> Float[Array, "centre 3 3"]:
    """Covariance of each joint centre in the frame of the poses, square metres."""
    limbs = jnp.array(body.topology.centre_limbs, int)
    found = jax.vmap(point_covariance)(twist[limbs], poses[limbs], body.centres)
    return NOISE**2 * found + SHAPE**2 * jnp.eye(3, dtype=twist.dtype)


def covariances(
    body: Body, poses: Poses, twist: Float[Array, "frame limb 6 6"]
) -> tuple[Float[Array, "frame limb 6 6"], Float[Array, "frame centre 3 3"]]:
    """Covariances of limbs and joint centres of several frames; `poses` with a leading frame axis."""
    return jax.vmap(limb_covariances)(twist), jax.vmap(joint_covariances, (None, 0, 0))(body, poses, twist)
