"""Rigid poses of limbs: unit quaternions (wxyz) and translations, written out by component.

Products over an axis of length 3 or 4 are slow and imprecise on some devices (matrix units), so everything here is sums
of components. Last axis is always the component; leading axes are free.
"""

from typing import Any

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# The functions here serve the host side too: products of NumPy arrays are NumPy arrays again, for every JAX operation
# outside of a program is compiled and called by itself.
AnyArray = Array | np.ndarray


def _stack(components: list[Any]) -> AnyArray:
    """Components as the last axis: in NumPy where all are NumPy's."""
    return (np if all(isinstance(c, (np.ndarray, np.generic)) for c in components) else jnp).stack(components, -1)


def cross_matrix(v: Float[AnyArray, "*b 3"]) -> Float[Any, "*b 3 3"]:
    """Matrix of the cross product: cross_matrix(v) w = v x w."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    o = np.zeros_like(x) if isinstance(v, np.ndarray) else jnp.zeros_like(x)
    rows = [_stack(row) for row in ([o, -z, y], [z, o, -x], [-y, x, o])]
    return (np if isinstance(v, np.ndarray) else jnp).stack(rows, -2)


def on_host(tree: Any) -> Any:
    """A tree with NumPy arrays for JAX's, to be computed with on the host; as it is where something in it is traced."""
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree)):
        return tree
    return jax.tree.map(lambda leaf: np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf, tree)


def on_device(tree: Any) -> Any:
    """A tree with JAX's arrays for NumPy's."""
    return jax.tree.map(lambda leaf: jax.device_put(leaf) if isinstance(leaf, np.ndarray | np.generic) else leaf, tree)


class Poses(eqx.Module):
    """One rigid pose per limb, `T_world_limb`: world point = rotate(rotation, limb point) + translation."""

    rotation: Float[AnyArray, "*limb 4"]  # unit quaternion wxyz
    translation: Float[AnyArray, "*limb 3"]  # metres

    def __getitem__(self, index: Any) -> "Poses":
        return Poses(self.rotation[index], self.translation[index])


def quat_multiply(p: Float[AnyArray, "*#b 4"], q: Float[AnyArray, "*#b 4"]) -> Float[Any, "*b 4"]:
    """Hamilton product p q: first rotate by q, then by p."""
    pw, px, py, pz = p[..., 0], p[..., 1], p[..., 2], p[..., 3]
    qw, qx, qy, qz = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    return _stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ]
    )


def quat_conjugate(q: Float[AnyArray, "*b 4"]) -> Float[Any, "*b 4"]:
    """Inverse of a unit quaternion."""
    return q * np.array([1, -1, -1, -1], q.dtype)


def quat_normalize(q: Float[AnyArray, "*b 4"]) -> Float[Array, "*b 4"]:
    """Scales to unit length; the zero quaternion becomes the identity (docs/numerics.md#roots: no division by zero)."""
    n2 = jnp.sum(q * q, -1, keepdims=True)
    zero = n2 < 1e-30
    unit = q / jnp.sqrt(jnp.where(zero, 1.0, n2))
    return jnp.where(zero, jnp.array([1, 0, 0, 0], q.dtype), unit)


def rotate(q: Float[AnyArray, "*#b 4"], v: Float[AnyArray, "*#b 3"]) -> Float[Any, "*b 3"]:
    """Rotates v by the unit quaternion q: v + 2 w (u x v) + 2 u x (u x v)."""
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    a, b, c = v[..., 0], v[..., 1], v[..., 2]
    tx, ty, tz = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return _stack([a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx])


def unrotate(q: Float[AnyArray, "*#b 4"], v: Float[AnyArray, "*#b 3"]) -> Float[Any, "*b 3"]:
    """Rotates v by the inverse of the unit quaternion q."""
    return rotate(quat_conjugate(q), v)


def matrix(q: Float[AnyArray, "*b 4"]) -> Float[Array, "*b 3 3"]:
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(r, -1) for r in rows], -2)


def quat_exp(r: Float[AnyArray, "*b 3"]) -> Float[Array, "*b 4"]:
    """Unit quaternion of a rotation vector (axis times angle, radians); smooth at zero."""
    angle2 = jnp.sum(r * r, -1, keepdims=True)
    small = angle2 < 1e-8
    half = 0.5 * jnp.sqrt(jnp.where(small, 1.0, angle2))
    scale = jnp.where(small, 0.5 - angle2 / 48, 0.5 * jnp.sin(half) / half)
    w = jnp.where(small, 1 - angle2 / 8, jnp.cos(half))
    return jnp.concatenate([w, scale * r], -1)


def quat_log(q: Float[AnyArray, "*b 4"]) -> Float[Array, "*b 3"]:
    """Rotation vector (radians, length at most pi) of a unit quaternion; smooth at the identity."""
    q = q * jnp.where(q[..., :1] >= 0, 1.0, -1.0).astype(q.dtype)
    w, v = q[..., :1], q[..., 1:]
    n2 = jnp.sum(v * v, -1, keepdims=True)
    small = n2 < 1e-10
    n = jnp.sqrt(jnp.where(small, 1.0, n2))
    safe_w = jnp.where(small, 1.0, w)
    return jnp.asarray(v * jnp.where(small, 2 + n2 / 3, 2 * jnp.arctan2(n, safe_w) / n))


def compose(a: Poses, b: Poses) -> Poses:
    """T_x_z = T_x_y T_y_z."""
    return Poses(quat_multiply(a.rotation, b.rotation), a.translation + rotate(a.rotation, b.translation))


def inverse(a: Poses) -> Poses:
    """T_y_x of T_x_y."""
    q = quat_conjugate(a.rotation)
    return Poses(q, -rotate(q, a.translation))


def apply(a: Poses, point: Float[AnyArray, "*#b 3"]) -> Float[Any, "*b 3"]:
    """World point of a limb point."""
    return rotate(a.rotation, point) + a.translation
