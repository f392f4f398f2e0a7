"""The largest eigenvalue's vector of a symmetric 4x4 matrix, with a derivative that stays finite."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# Relative damping of the pseudo-inverse in the derivative of the eigenvector: smooth where the gap closes
# (docs/numerics.md#eigenvector).
GAP_DAMPING = 1e-6
SAFE = 0.05  # least product of the gaps between eigenvalues, of a matrix of spread 1, for the closed form


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
