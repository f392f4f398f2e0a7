"""The cylinder model spanned by the body's points (Hecht et al. 2009, sec. II): two cylinders per limb, hands and feet,
two rounded patches for the torso, and the head. Distances of measured points to it, and the body points that carry each
place.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from voodoo_jax.trackers.flexible.flexible_body import (
    HEAD,
    IS_ARM,
    LIMBS,
    LOWER,
    NECK,
    UPPER,
    FlexibleBody,
    bone_lengths,
)
from voodoo_jax.trackers.flexible.physics import frames
from voodoo_jax.trackers.flexible.vectors import Vector, vectors

# the paper's parts, and hands and feet: 12 of the limbs (limb by limb), the head, upper and lower torso
PARTS = 15
# ends of the flat part of a torso patch from side to side (shares of its width), measured on rendered people
_UPPER_SPAN, _LOWER_SPAN = (0.28, 0.72), (0.15, 0.85)


class Segment(NamedTuple):
    """Cylinders: ends `a` and `b` of the axes, and radii at both; any shape. Metres."""

    a: Vector
    b: Vector
    begin: Any  # radius at a
    end: Any  # radius at b


class Nearest(NamedTuple):
    """For each measured point the nearest place on a part of the body, and the body points that carry that place."""

    distance: Float[Array, " point"]  # to the surface, metres; negative inside
    away: Vector  # unit, from the axis or patch to the point
    carriers: Int[Array, "4 point"]  # of the body's 16 points
    weights: Float[Array, "4 point"]  # motion of the place per motion of each carrier


def limb_segments(
    p: tuple[Vector, Vector, Vector], forward: Vector, is_arm: Any, radii: Float[Array, "*limb 3 2"], tip: Any
) -> tuple[Segment, Segment, Segment]:
    """The three cylinders of limbs: hands continue forearms, feet point forward. Shapes must broadcast."""
    bone = (p[2] - p[1]).unit()
    ahead = (forward - bone * forward.dot(bone)).unit()
    end = p[2] + bone.where(is_arm > 0, ahead) * tip
    places = ((p[0], p[1]), (p[1], p[2]), (p[2], end))
    first, second, third = (Segment(*place, radii[..., n, 0], radii[..., n, 1]) for n, place in enumerate(places))
    return first, second, third


def segment_distance(s: Segment, q: Vector) -> Float[Array, "*n"]:
    """Distances of points to the surfaces of cylinders with round ends, metres; negative inside."""
    d = s.b - s.a
    x, y, z = q.x - s.a.x, q.y - s.a.y, q.z - s.a.z
    t = jnp.clip((x * d.x + y * d.y + z * d.z) * (1 / (d.dot(d) + 1e-9)), 0, 1)
    x, y, z = x - d.x * t, y - d.y * t, z - d.z * t
    return jnp.sqrt(x * x + y * y + z * z + 1e-9) - (s.begin + t * (s.end - s.begin))


def _project_to_patch(corners: list[Vector], span: tuple[float, float], q: Vector) -> tuple[Vector, list[Array]]:
    """Nearest places of points on a torso patch: offset of each point from it, and bilinear weights of the corners."""
    a, b, c, d = corners  # left and right above, left and right below
    top = (a + b) * 0.5
    down = (c + d) * 0.5 - top
    v = jnp.clip((q - top).dot(down) / (down.dot(down) + 1e-9), 0, 1)
    right = b + (d - b) * v
    across = a + (c - a) * v - right
    u = jnp.clip((q - right).dot(across) / (across.dot(across) + 1e-9), span[0], span[1])
    return q - right - across * u, [u * (1 - v), (1 - u) * (1 - v), u * v, (1 - u) * v]


def _list_carriers() -> np.ndarray:
    out = np.zeros((PARTS, 4), np.int32)
    for limb, (root, middle, end) in enumerate(LIMBS):
        out[3 * limb : 3 * limb + 3, :2] = (root, middle), (middle, end), (middle, end)
    out[12, :2], out[13], out[14] = (NECK, HEAD), UPPER, LOWER
    return out


CARRIERS = _list_carriers()


def body_segments(body: FlexibleBody, x: Vector) -> Segment:
    """Cylinders of the whole body: three of each limb, and the head with round ends, from the middle of the neck on;
    axis: part."""
    forward = vectors(frames(x.stacked()).lower[0])
    points = x[LIMBS[:, 0]], x[LIMBS[:, 1]], x[LIMBS[:, 2]]
    limbs = limb_segments(points, forward, jnp.asarray(IS_ARM, x.v.dtype), body.radii, body.tips)
    neck = x[HEAD] - x[NECK]
    skull = Segment(x[HEAD] - neck * 0.2, x[HEAD] + neck.unit() * body.skull[1], body.skull[0], body.skull[0])

    def row(last: Array, *own: Array) -> Array:
        flat = jnp.stack(own, -1)
        return jnp.concatenate([flat.reshape(*flat.shape[:-2], -1), last[..., None]], -1)

    return jax.tree.map(row, skull, *limbs)


def surface_distance(body: FlexibleBody, x: Float[Array, "16 3"], q: Vector) -> Float[Array, "part *n"]:
    """Distances of points to the surfaces of all parts of the body, metres; negative inside."""
    at = vectors(x)
    segments = jax.tree.map(lambda a: a.reshape(*a.shape, *[1] * q.ndim), body_segments(body, at))
    patches = [
        _project_to_patch([at[i] for i in corners], span, q)[0].length() - body.torso[1]
        for corners, span in ((UPPER, _UPPER_SPAN), (LOWER, _LOWER_SPAN))
    ]
    return jnp.concatenate([segment_distance(segments, q[None]), jnp.stack(patches)])


def nearest_places(body: FlexibleBody, x: Float[Array, "16 3"], q: Vector, part: Int[Array, " point"]) -> Nearest:
    """The nearest place of each point on its part of the body."""
    at, segments = vectors(x), body_segments(body, vectors(x))
    s = jax.tree.map(lambda a: a[..., jnp.minimum(part, 12)], segments)  # torso patches replace 13 and 14 below
    d, off = s.b - s.a, q - s.a
    t = jnp.clip(off.dot(d) * (1 / (d.dot(d) + 1e-9)), 0, 1)
    # motion of a place on an axis with its body points: hands continue the forearm, feet move with the ankle
    reach = jnp.asarray(IS_ARM, x.dtype) * body.tips / jnp.maximum(bone_lengths(body)[:, 1], 1e-3)
    base = np.zeros(PARTS, np.float32)
    base[2:12:3] = base[12] = 1
    slope = jnp.asarray(1 - base, reach.dtype).at[2:12:3].set(reach)
    share, zero = jnp.asarray(base)[part] + slope[part] * t, jnp.zeros_like(t)
    off, weights = off - d * t, [1 - share, share, zero, zero]
    radius = s.begin + t * (s.end - s.begin)
    for number, corners, span in ((13, UPPER, _UPPER_SPAN), (14, LOWER, _LOWER_SPAN)):
        own, own_weights = _project_to_patch([at[i] for i in corners], span, q)
        here = part == number
        off = own.where(here, off)
        weights = [jnp.where(here, a, b) for a, b in zip(own_weights, weights)]
        radius = jnp.where(here, body.torso[1], radius)
    far = off.length()
    return Nearest(far - radius, off * (1 / far), jnp.asarray(CARRIERS.T)[:, part], jnp.stack(weights))
