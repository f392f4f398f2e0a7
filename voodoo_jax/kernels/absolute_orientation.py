"""Weighted absolute orientation by unit quaternions (Horn 1987, doi:10.1364/JOSAA.4.000629), from moments.

All pairs of a limb, measured or artificial, enter as one 4x4 matrix of moments, sum of w [1, c] [1, p]^T with model
points c and data points p: longer lists and heavier weights cost nothing (Knoop 2007, sec. 4.3).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from voodoo_jax.geometry.rigid import quat_normalize, rotate
from voodoo_jax.kernels.eigen import top_eigenpair


class Alignment(NamedTuple):
    """Rigid motion that takes the model points to the data points."""

    rotation: Float[Array, "4"]  # unit quaternion wxyz, the half of the double cover nearest to the identity
    translation: Float[Array, "3"]  # metres
    gap: Float[Array, ""]  # gap of the two largest eigenvalues over the spread: 0 where rotation is undetermined
    weight: Float[Array, ""]  # total weight


def horn_matrix(s: Float[Array, "3 3"]) -> Float[Array, "4 4"]:
    """Horn's symmetric 4x4 matrix of a cross-covariance s[i, j] = sum of w c_i p_j (Horn 1987, sec. 4.A)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = [[s[i, j] for j in range(3)] for i in range(3)]
    rows = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ]
    return jnp.stack([jnp.stack(r) for r in rows])


def align(moments: Float[Array, "4 4"]) -> Alignment:
    """The rotation and translation that minimise the weighted sum of squares |R c + t - p|^2.

    **Arguments:** `moments` sum of w [1, c] [1, p]^T, model points c, data points p, metres. Give both in a frame near
    the limb: the moments are centred here by subtraction, which loses digits far from the origin
    (docs/numerics.md#float32).

    **Returns:** the identity for no pairs at all; for pairs that leave the rotation undetermined (fewer than three, on
    one line, mirrored) one of the best rotations, with `gap` near zero.
    """
    weight = moments[0, 0]
    none = weight <= 1e-12
    w = jnp.where(none, 1.0, weight)
    model, data = moments[1:, 0] / w, moments[0, 1:] / w
    cross = moments[1:, 1:] / w - model[:, None] * data[None, :]
    spread2 = jnp.sum(cross * cross)
    flat = spread2 < 1e-24
    spread = jnp.sqrt(jnp.where(flat, 1.0, spread2))  # the root of 0 has no derivative (docs/numerics.md#roots)
    # normalised by the limb's own spread: eigenvalues near one, whatever unit or weight (docs/numerics.md#scale)
    k = horn_matrix(cross / spread)
    identity = jnp.diag(jnp.array([3, -1, -1, -1], k.dtype)) / 3**0.5
    values, q = top_eigenpair(jnp.where(flat, identity, k))
    # nearest to the identity, never sign(): that is 0 at 0 (docs/numerics.md#sign)
    q = quat_normalize(q * jnp.where(q[0] >= 0, 1.0, -1.0))
    t = jnp.where(none, jnp.zeros_like(data), data - rotate(q, model))
    return Alignment(q, t, jnp.where(flat, 0.0, values[-1] - values[-2]), weight)
