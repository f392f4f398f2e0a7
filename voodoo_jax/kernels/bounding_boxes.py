"""Which point may belong to which limb: bounding boxes and the overlap rule (Knoop 2007, sec. 5.2)."""

from typing import Literal

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from voodoo_jax.geometry.rigid import Poses, matrix

Overlap = Literal["exclusive", "shared", "adjacent", "soft"]


def body_box(
    sizes: Float[Array, "limb 5"], poses: Poses, enlarge: Float[Array, ""], present: Bool[Array, " limb"] | None = None
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Axis-aligned box around the limbs that are present, enlarged on every side: lower and upper corner, world frame,
    metres.

    Tight for elliptic ends: an ellipse with half axes u, v reaches sqrt(u_k^2 + v_k^2) along world axis k.
    """
    r = matrix(poses.rotation)
    length = sizes[:, 4:5]
    bottom, top = poses.translation, poses.translation + r[..., 2] * length
    reach0 = jnp.sqrt((r[..., 0] * sizes[:, 0:1]) ** 2 + (r[..., 1] * sizes[:, 1:2]) ** 2)
    reach1 = jnp.sqrt((r[..., 0] * sizes[:, 2:3]) ** 2 + (r[..., 1] * sizes[:, 3:4]) ** 2)
    there = True if present is None else present[:, None]
    low = jnp.minimum(bottom - reach0, top - reach1).min(0, where=there, initial=jnp.inf) - enlarge
    high = jnp.maximum(bottom + reach0, top + reach1).max(0, where=there, initial=-jnp.inf) + enlarge
    return low, high


def in_box(low: Float[Array, "3"], high: Float[Array, "3"], points: Float[Array, "point 3"]) -> Bool[Array, " point"]:
    """Whether points lie in an axis-aligned box."""
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    return (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]) & (z >= low[2]) & (z <= high[2])


def in_limb_box(
    size: Float[Array, "5"],
    x: Float[Array, " point"],
    y: Float[Array, " point"],
    z: Float[Array, " point"],
    enlarge: Float[Array, ""],
) -> Bool[Array, " point"]:
    """Whether points in the limb frame lie in the limb's own box (aligned with the limb), enlarged on every side."""
    rx, ry = jnp.maximum(size[0], size[2]) + enlarge, jnp.maximum(size[1], size[3]) + enlarge
    return (jnp.abs(x) <= rx) & (jnp.abs(y) <= ry) & (z >= -enlarge) & (z <= size[4] + enlarge)


def resolve_overlap(
    rule: Overlap,
    candidate: Bool[Array, "limb point"],
    distance: Float[Array, "limb point"],
    adjacent: Bool[Array, "limb limb"],
) -> Bool[Array, "limb point"]:
    """Settles points that lie in several limbs' boxes.

    `shared`: they count for every one of these limbs; `exclusive`: for the closest limb only; `adjacent`: for the
    closest one and those of the others that hang on it by a joint, so that limbs without a common joint never pull at
    the same point; `soft`: for all of them, each by its share (see shares). `distance` is signed (inside is closer);
    `adjacent[l, m]` is true on the diagonal too.
    """
    if rule in ("shared", "soft"):
        return candidate
    winner = jnp.argmin(jnp.where(candidate, distance, jnp.inf), 0)
    limb = jnp.arange(candidate.shape[0])
    if rule == "exclusive":
        return candidate & (limb[:, None] == winner[None, :])
    return candidate & adjacent[winner].T


def shares(
    candidate: Bool[Array, "limb point"], distance: Float[Array, "limb point"], softness: Float[Array, ""]
) -> Float[Array, "limb point"]:
    """What each limb has of a point, 1 in all: a soft minimum of the signed squared distances (metres), so that a point
    goes from one limb to the next gradually. `softness` metres: a limb so much farther off than another one at the
    surface has a share of 1 / (1 + e) beside it."""
    away = jnp.where(candidate, distance * jnp.abs(distance) / softness**2, jnp.inf)
    nearest = jnp.min(away, 0, where=candidate, initial=jnp.inf)
    parts = jnp.where(candidate, jnp.exp(-jnp.where(candidate, away - nearest, 0.0)), 0.0)
    return parts / jnp.maximum(jnp.sum(parts, 0), 1.0)
