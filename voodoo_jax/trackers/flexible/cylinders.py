"""The cylinder model that follows from the points (Hecht et al. 2009, sec. II): two cylinders a limb, with hands and
feet, the two parts of the torso as rounded patches, the head. Distances of points to it, and which points carry them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from voodoo_jax.trackers.flexible.flexible_body import HEAD, IS_ARM, LIMBS, LOWER, NECK, UPPER, FlexibleBody
from voodoo_jax.trackers.flexible.physics import frames, length, unit

# of the paper, with hands and feet: 12 of the limbs (limb by limb), the head, upper and lower torso
PARTS = 15
_FOOT_DOWN = 0.25  # how much a foot points down, share of how much it points forward: set by hand
# how far the flat part of a torso patch reaches from side to side (share of its width), measured on rendered people
_UPPER_SPAN, _LOWER_SPAN = (0.28, 0.72), (0.15, 0.85)


class Segments(NamedTuple):
    """Axes of cylinders, ends `a` and `b`, with radii at both; leading axes free. Metres."""

    a: Float[Array, "*n 3"]
    b: Float[Array, "*n 3"]
    radii: Float[Array, "*n 2"]


class Closest(NamedTuple):
    """For each point and each part of the body where it is nearest, and which body points carry that place."""

    distance: Float[Array, "point part"]  # to the surface, metres; negative inside
    away: Float[Array, "point part 3"]  # unit, from the axis or patch to the point
    carriers: Int[Array, "part 4"]  # of the body's 16 points
    weights: Float[Array, "point part 4"]  # how far the place moves with each


def limb_segments(
    p: Float[Array, "3 3"], forward: Float[Array, "3"], is_arm: Float[Array, ""], radii: Float[Array, "3 2"],
    tip: Float[Array, ""],
) -> Segments:  # fmt: skip
    """The three cylinders of a limb: hands go on from forearms, feet point forward."""
    bone = unit(p[2] - p[1])
    ahead = unit(forward - jnp.sum(forward * bone) * bone + _FOOT_DOWN * bone)
    end = p[2] + tip * jnp.where(is_arm > 0, bone, ahead)
    return Segments(jnp.stack([p[0], p[1], p[2]]), jnp.stack([p[1], p[2], end]), radii)


def segment_distance(s: Segments, q: Float[Array, "point 3"]) -> Float[Array, "point segment"]:
    """Distances of points to the surfaces of cylinders with round ends, metres."""
    d = s.b - s.a
    t = jnp.clip(jnp.sum((q[:, None] - s.a) * d, -1) / (jnp.sum(d * d, -1) + 1e-9), 0, 1)
    off = q[:, None] - s.a - t[..., None] * d
    return length(off)[..., 0] - (s.radii[:, 0] + t * (s.radii[:, 1] - s.radii[:, 0]))


def _patch(corners, span, q):
    """Of points the nearest place on a torso patch: offset from it and bilinear weights of its corners."""
    a, b, c, d = corners  # left and right above, left and right below
    top, down = (a + b) / 2, (c + d) / 2 - (a + b) / 2
    v = jnp.clip((q - top) @ down / (jnp.sum(down * down) + 1e-9), 0, 1)[:, None]
    left, right = a + v * (c - a), b + v * (d - b)
    across = left - right
    u = jnp.sum((q - right) * across, -1, keepdims=True) / (jnp.sum(across**2, -1, keepdims=True) + 1e-9)
    u = jnp.clip(u, span[0], span[1])
    weights = jnp.concatenate([u * (1 - v), (1 - u) * (1 - v), u * v, (1 - u) * v], -1)
    return q - right - u * across, weights


def _carriers() -> np.ndarray:
    out = np.zeros((PARTS, 4), int)
    for limb, (root, middle, end) in enumerate(LIMBS):
        out[3 * limb : 3 * limb + 3, :2] = (root, middle), (middle, end), (middle, end)
    out[12, :2], out[13], out[14] = (NECK, HEAD), UPPER, LOWER
    return out


CARRIERS = _carriers()


def skull_segment(body: FlexibleBody, x: Float[Array, "16 3"]) -> Segments:
    """The head as a cylinder with round ends, from the middle of the neck on."""
    up = unit(x[HEAD] - x[NECK])
    radius = jnp.stack([body.skull[0], body.skull[0]])
    return Segments(x[HEAD] - 0.2 * (x[HEAD] - x[NECK]), x[HEAD] + body.skull[1] * up, radius)


def all_limb_segments(body: FlexibleBody, x: Float[Array, "16 3"]) -> Segments:
    """Of all limbs, leading axes limb, cylinder."""
    forward = frames(x).lower[0]
    return jax.vmap(limb_segments, (0, None, 0, 0, 0))(
        x[LIMBS], forward, jnp.asarray(IS_ARM, x.dtype), body.radii, body.tips
    )


def closest(body: FlexibleBody, x: Float[Array, "16 3"], q: Float[Array, "point 3"]) -> Closest:
    """Distances of points to all parts of the body."""
    limbs, skull = all_limb_segments(body, x), skull_segment(body, x)
    a = jnp.concatenate([limbs.a.reshape(12, 3), skull.a[None]])
    b = jnp.concatenate([limbs.b.reshape(12, 3), skull.b[None]])
    radii = jnp.concatenate([limbs.radii.reshape(12, 2), skull.radii[None]])
    d = b - a
    t = jnp.clip(jnp.sum((q[:, None] - a) * d, -1) / (jnp.sum(d * d, -1) + 1e-9), 0, 1)
    off = q[:, None] - a - t[..., None] * d
    radius = radii[:, 0] + t * (radii[:, 1] - radii[:, 0])
    # how a place on an axis moves with the points: hands as the forearm's continuation, feet with the ankle
    reach = body.tips / jnp.maximum(body.lengths[:8].reshape(4, 2)[:, 1], 1e-3)
    hand = jnp.asarray(IS_ARM, x.dtype) * reach
    last = t[:, 2:12:3] * hand
    share = t.at[:, 2:12:3].set(1 + last).at[:, 12].set(1.0)
    weights = jnp.stack([1 - share, share, jnp.zeros_like(share), jnp.zeros_like(share)], -1)
    upper, upper_weights = _patch([x[i] for i in UPPER], _UPPER_SPAN, q)
    lower, lower_weights = _patch([x[i] for i in LOWER], _LOWER_SPAN, q)
    off = jnp.concatenate([off, upper[:, None], lower[:, None]], 1)
    thick = jnp.broadcast_to(body.torso[1], (len(q), 2))
    far = length(off)
    return Closest(
        far[..., 0] - jnp.concatenate([radius, thick], 1),
        off / far,
        jnp.asarray(CARRIERS),
        jnp.concatenate([weights, upper_weights[:, None], lower_weights[:, None]], 1),
    )
