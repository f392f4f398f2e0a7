"""Weighted absolute orientation by unit quaternions (Horn 1987, doi:10.1364/JOSAA.4.000629), from moments; the largest
eigenvalue's vector of a symmetric 4x4 matrix, with a derivative that stays finite.

All pairs of a limb, measured or artificial, enter as one 4x4 matrix of moments, sum of w [1, c] [1, p]^T with model
points c and data points p: longer lists and heavier weights cost nothing (Knoop 2007, sec. 4.3).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from voodoo_jax.geometry.rigid import quat_normalize, rotate

# Relative damping of the pseudo-inverse in the derivative of the eigenvector: smooth where the gap closes
# (docs/numerics.md#eigenvector).
GAP_DAMPING = 1e-6
SAFE = 0.05  # least product of the gaps between eigenvalues, of a matrix of spread 1, for the closed form


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


@jax.custom_jvp
def top_eigenpair(k: Float[Array, "4 4"]) -> tuple[Float[Array, "4"], Float[Array, "4"]]:
    """Eigenvalues (ascending) and the eigenvector of the largest one of a symmetric matrix.

    The derivative of `eigh` is NaN in reverse mode when any two eigenvalues meet, even if the wanted one stands apart
    (docs/numerics.md#eigenvector); this rule needs only the top one to stand apart and is damped, hence finite, where
    it does not. Second derivatives hold for the top pair; those of the other three eigenvalues leave out the turn of
    their vectors.
    """
    return jnp.linalg.eigvalsh(k), _top_vectors(k[None])[0]


@jax.custom_batching.custom_vmap
def _top_vectors(k: Float[Array, "limb 4 4"]) -> Float[Array, "limb 4"]:
    """Unit eigenvectors of the largest eigenvalues: in closed form, but by `eigh` where they would lose digits in it
    (points nearly on a line; docs/numerics.md#closed-forms)."""
    vectors, safe = _closed_form(k.transpose(1, 2, 0))
    # limb by limb: what one limb gets does not depend on the others
    checked = lambda: jnp.where(safe[:, None], vectors.T, jnp.linalg.eigh(k)[1][:, :, -1])  # noqa: E731
    return jax.lax.cond(jnp.all(safe), lambda: vectors.T, checked)


@_top_vectors.def_vmap
def _top_vectors_vmap(size, batched, k):
    # one batch of all, so that the branch stays a branch: mapped, both of its sides would be computed
    return _top_vectors(k.reshape(-1, 4, 4)).reshape(*k.shape[:2], 4), True


def _closed_form(k):
    """Top eigenvectors [4, limb] of matrices k[4, 4, limb] as align makes them, without a trace and with eigenvalues
    whose squares sum to 4; and which vectors have all their digits.

    Newton's method finds the largest root of the characteristic polynomial from above, Rayleigh quotients polish it;
    the vector is a column of the adjugate of k - root, whose length is the product of the gaps to the others.
    """
    (a, ab, ac, ad), (_, b, bc, bd), (_, _, c, cd), (_, _, _, d) = k

    def column(root):
        b_, c_, d_ = b - root, c - root, d - root
        lower = (c_ * d_ - cd * cd, bc * d_ - cd * bd, bc * cd - c_ * bd)  # minors of the last two rows
        upper = (ac * d_ - cd * ad, ac * cd - c_ * ad)
        return (
            b_ * lower[0] - bc * lower[1] + bd * lower[2],
            bc * upper[0] - ab * lower[0] - bd * upper[1],
            ab * lower[1] - b_ * upper[0] + bd * (ac * bd - bc * ad),
            b_ * upper[1] - ab * lower[2] - bc * (ac * bd - bc * ad),
        )

    w, x, y, z = column(0.0)
    constant = a * w + ab * x + ac * y + ad * z
    square = (a * a + b * b + c * c + d * d) / 2 + ab * ab + ac * ac + ad * ad + bc * bc + bd * bd + cd * cd
    minors = w + _det(a, c, d, ac, ad, cd) + _det(a, b, d, ab, ad, bd) + _det(a, b, c, ab, ac, bc)
    root = jnp.sqrt(1.5 * square)  # above all roots
    for _ in range(7):
        value = ((root * root - square) * root - minors) * root + constant
        root = root - value / ((4 * root * root - 2 * square) * root - minors)
    above = root
    for _ in range(3):
        w, x, y, z = column(root)
        across = w * (ab * x + ac * y + ad * z) + x * (bc * y + bd * z) + cd * y * z
        root = (a * w * w + b * x * x + c * y * y + d * z * z + 2 * across) / (w * w + x * x + y * y + z * z)
    vector = jnp.stack(column(root))
    length = jnp.sqrt(jnp.sum(vector * vector, 0))
    # with these gaps no other eigenvalue is between the one found and the bound from above
    alone = (length > SAFE) & (above - root < SAFE / 12)
    return vector / length, alone & (jnp.abs(a + b + c + d) < 1e-3) & (jnp.abs(square - 2) < 1e-3)


def _det(a, b, c, ab, ac, bc):
    """Determinant of a symmetric 3x3 matrix."""
    return a * (b * c - bc * bc) - ab * (ab * c - bc * ac) + ac * (ab * bc - b * ac)


@top_eigenpair.defjvp
def _top_eigenpair_jvp(primals, tangents):
    (k,), (dk,) = primals, tangents
    values, top = top_eigenpair(k)
    dkv = jnp.sum(dk * top, -1)
    others = _frozen_vectors(k)[:, :-1]
    dothers = jnp.sum(others * jnp.sum(dk[:, :, None] * others[None], 1), 0)
    return (values, top), (jnp.append(dothers, jnp.sum(top * dkv)), jnp.sum(_turn_of_top(k) * dkv, -1))


@jax.custom_jvp
def _frozen_vectors(k: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """Eigenvectors held constant: not even their derivative times zero is taken, which would be NaN."""
    return jnp.linalg.eigh(k)[1]


@_frozen_vectors.defjvp
def _frozen_vectors_jvp(primals, tangents):
    vectors = _frozen_vectors(*primals)
    return vectors, jnp.zeros_like(vectors)


@jax.custom_jvp
def _turn_of_top(k: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """Damped pseudo-inverse of (top eigenvalue - k): takes a change of k times the top eigenvector to its turn."""
    values, vectors = jnp.linalg.eigh(k)
    gaps = values[-1] - values
    scale = jnp.maximum(jnp.max(jnp.abs(values)), 1e-30)
    inverse = gaps / (gaps * gaps + (GAP_DAMPING * scale) ** 2)  # damped 1/gap; 0 for the top one itself
    return _product(vectors * inverse, vectors.T)


@_turn_of_top.defjvp
def _turn_of_top_jvp(primals, tangents):
    # derivative of a pseudo-inverse of constant rank (Golub and Pereyra 1973), damping held constant
    (k,), (dk,) = primals, tangents
    _, top = top_eigenpair(k)
    inverse = _turn_of_top(k)
    change = jnp.sum(top * jnp.sum(dk * top, -1)) * jnp.eye(4, dtype=k.dtype) - dk
    across = _product(inverse, _product(inverse, jnp.sum(change * top, -1)[:, None])) * top
    return inverse, across + across.T - _product(inverse, _product(change, inverse))


def _product(a, b):
    """Matrix product as sums: no reduced precision on any device (docs/numerics.md#tf32)."""
    return jnp.sum(a[:, :, None] * b[None], 1)
