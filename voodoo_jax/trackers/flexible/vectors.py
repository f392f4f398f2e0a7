"""Vectors with their components on the first axis, so that operations on many vectors act on long rows.

With a last axis of length 3, XLA's programs for CPUs sum three numbers at a time: measured 20 times slower.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

TINY = 1e-9  # square metres: float32 has no smaller distances here


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Vector:
    """Vectors of any shape *b, which broadcast like scalars of that shape."""

    v: Float[Any, "3 *b"]

    x = property(lambda self: self.v[0])
    y = property(lambda self: self.v[1])
    z = property(lambda self: self.v[2])

    @property
    def ndim(self) -> int:
        return self.v.ndim - 1

    def wide(self, ndim: int) -> Float[Any, "3 *b"]:
        """The components with `ndim` axes besides the first."""
        return self.v.reshape(3, *[1] * (ndim - self.ndim), *self.v.shape[1:])

    def __add__(self, other: "Vector") -> "Vector":
        ndim = max(self.ndim, other.ndim)
        return Vector(self.wide(ndim) + other.wide(ndim))

    def __sub__(self, other: "Vector") -> "Vector":
        ndim = max(self.ndim, other.ndim)
        return Vector(self.wide(ndim) - other.wide(ndim))

    def __mul__(self, factor: Any) -> "Vector":
        return Vector(self.wide(max(self.ndim, jnp.ndim(factor))) * factor)

    def __getitem__(self, at: Any) -> "Vector":
        return Vector(self.v[(slice(None), *at) if isinstance(at, tuple) else (slice(None), at)])

    def dot(self, other: "Vector") -> Float[Array, "*b"]:
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: "Vector") -> "Vector":
        a, b = self, other
        return vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)

    def length(self) -> Float[Array, "*b"]:
        """Lengths, smooth at zero."""
        return jnp.sqrt(self.dot(self) + TINY)

    def unit(self) -> "Vector":
        return self * (1 / self.length())

    def where(self, condition: Any, other: "Vector") -> "Vector":
        """These vectors where the condition holds, else the others."""
        ndim = max(self.ndim, other.ndim, jnp.ndim(condition))
        return Vector(jnp.where(condition, self.wide(ndim), other.wide(ndim)))

    def stack(self, *others: "Vector") -> "Vector":
        """These vectors and others along a new first axis."""
        return Vector(jnp.stack([self.v, *(other.v for other in others)], 1))

    def stacked(self) -> Float[Array, "*b 3"]:
        return jnp.moveaxis(self.v, 0, -1)


def vector(x: Any, y: Any, z: Any) -> Vector:
    """Vectors from components."""
    return Vector(jnp.stack(jnp.broadcast_arrays(x, y, z)))


def vectors(v: Float[Any, "*b 3"]) -> Vector:
    """Vectors from an array with the components on the last axis."""
    return Vector(jnp.moveaxis(jnp.asarray(v), -1, 0))


def turned(rows: Float[Any, "3 3"], v: Vector) -> Vector:
    """Vectors multiplied by a matrix, given by its rows."""
    return vector(*(v.x * rows[i, 0] + v.y * rows[i, 1] + v.z * rows[i, 2] for i in range(3)))


def least(value: Float[Array, "of *n"]) -> Int[Array, "*n"]:
    """As argmin along the first axis, which XLA for CPUs computes number by number (measured: eight times slower)."""
    number = np.arange(len(value), dtype=np.int32).reshape(-1, *[1] * (value.ndim - 1))
    return jnp.min(jnp.where(value == jnp.min(value, 0), number, len(value) - 1), 0)


def kept(true: Any, function: Callable[..., Any], *operands: Any) -> Any:
    """Calls a function on operands that are each computed once and kept in memory: XLA for CPUs otherwise recomputes
    them at every use (measured: three times slower). It does not do so across a branch.

    **Arguments:** `true` a condition that always holds, but that the compiler cannot know.
    """
    out = jax.eval_shape(function, *operands)
    nothing = lambda *_: jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), out)  # noqa: E731
    return lax.cond(true, function, nothing, *operands)
