"""Physics of the flexible body (Hecht et al. 2009, sec. II): Verlet steps, relaxation of springs and limits.

All functions are pure with arrays of fixed shapes, so they compile once and map over particles, bodies and recordings.
They are differentiable in positions, lengths and stiffnesses.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from voodoo_jax.trackers.flexible.flexible_body import (
    COLOURING,
    IS_ARM,
    LIMBS,
    LOWER,
    NECK,
    SIDE,
    SPRINGS,
    FlexibleBody,
    bone_lengths,
)
from voodoo_jax.trackers.flexible.vectors import TINY, Vector, vectors

# least cosines of the first bone's direction with an axis of the torso (forward, outward, up, with the signs of the
# rows): ranges of motion of shoulders and hips. Measured: without them a kick is 0.8 cm worse; with those of the
# American Academy of Orthopaedic Surgeons (extension 60 and 30 degrees, adduction 30, abduction 45, flexion 120) it is
# 0.6 cm better, but a freely dangling body gains energy and swings up
_ARM_LIMITS = (((1, 0, 0), -0.80), ((0, 1, 0), -0.65), ((0, -1, 0), -1.0), ((0, 0, -1), -1.0))
# as above, measured
_LEG_LIMITS = (((1, 0, 0), -0.55), ((0, 1, 0), -0.45), ((0, -1, 0), -0.80), ((0, 0, -1), -0.70))
# for the paper's left and right arm, left and right leg
_LIMITS = np.array([[(*n, c) for n, c in rows] for rows in (_ARM_LIMITS,) * 2 + (_LEG_LIMITS,) * 2], np.float32)
# radians, least angle between the two bones of a limb: in the paper of that academy (1965) elbows bend by 150 degrees
_SHARPEST = np.pi / 6
# metres that a knee may be behind the line from hip to ankle. Measured: 0.013 and 0.03 give the same, 0 is 0.4 cm
# worse in a bow
_KNEE_BACK = 0.02
# distance from the hips' middle to the neck of a bowing person, share of the standing distance: spines bend, hips do
# the rest. Measured on rendered people (0.915 to 0.95); without it their flat bodies fold at the waist
_BOWED = 0.92
# least distance between both knees and between both ankles, shares of stature: measured on 27 recordings of people
# standing, walking, running and bowing (knees 0.072 and more, ankles 0.053)
LEGS_NEAR = np.array([0.075, 0.058], np.float32)
ANKLE = 0.035  # height of an ankle above the floor, share of stature, measured on the built-in body
NO_FLOOR = np.array([0.0, 0.0, 1.0, -1e3], np.float32)  # a kilometre down: any gives the same below the feet


class Frames(NamedTuple):
    """Directions of the torso's two parts; rows: forward, left, up."""

    upper: Float[Array, "3 3"]
    lower: Float[Array, "3 3"]
    middle: Float[Array, "3"]  # of the hips, metres


class _Axes(NamedTuple):
    forward: Vector
    left: Vector
    up: Vector


def length(v: Float[Array, "*b 3"]) -> Float[Array, "*b 1"]:
    """Lengths, with a last axis of size 1; smooth at zero."""
    return vectors(v).length()[..., None]


def unit(v: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    return v / length(v)


def _orthogonalise(left: Vector, up: Vector) -> _Axes:
    up = up.unit()
    left = (left - up * left.dot(up)).unit()
    return _Axes(left.cross(up), left, up)


def _find_torso(x: Vector) -> tuple[_Axes, _Axes, Vector, Vector]:
    """Axes of the upper and lower torso, the middle of the hips and that of the shoulders."""
    shoulders, waist, hips = ((x[i] + x[j]) * 0.5 for i, j in ((2, 5), (8, 9), (10, 13)))
    return _orthogonalise(x[2] - x[5], shoulders - waist), _orthogonalise(x[10] - x[13], waist - hips), hips, shoulders


def frames(x: Float[Array, "16 3"]) -> Frames:
    """The torso's frames: shoulders are limited in the upper frame, hips in the lower one."""
    upper, lower, hips, _ = _find_torso(vectors(x))
    rows = lambda axes: jnp.stack([axis.v for axis in axes])  # noqa: E731
    return Frames(rows(upper), rows(lower), hips.v)


def verlet(
    x: Float[Array, "16 3"], before: Float[Array, "16 3"], acceleration: Float[Array, "16 3"], dt: Float[Array, ""],
    damping: Float[Array, ""] | float = 0.0,
) -> Float[Array, "16 3"]:  # fmt: skip
    """Positions one step of `dt` seconds later (Verlet 1967), metres; `damping` share of the velocity that is lost."""
    return x + (1 - damping) * (x - before) + acceleration * dt**2


def inverse_masses(masses: Float[Array, " 16"]) -> Float[Array, " 16"]:
    """Inverse masses, 0 for fixed points."""
    return jnp.where(jnp.isinf(masses), 0.0, 1 / jnp.where(jnp.isinf(masses), 1.0, masses))


class _Pulls(NamedTuple):
    """For each group of springs and each point, the spring of the group at this point, if there is one."""

    rest: Float[Array, "group 16"]  # metres
    share: Float[Array, "group 16"]  # share of the spring's error that the point corrects; 0: no spring


def _prepare_springs(body: FlexibleBody, inverse: Float[Array, " 16"]) -> _Pulls:
    spring, partner = COLOURING.spring, COLOURING.partner
    both = jnp.maximum(inverse + inverse[partner], 1e-6)
    share = jnp.where(partner == np.arange(16), 0.0, body.stiffness[spring] * inverse / both)
    return _Pulls(body.lengths[spring], share)


def _relax_springs(x: Vector, pulls: _Pulls) -> Vector:
    """One Gauss-Seidel sweep over the springs, group by group."""
    for group, partner in enumerate(COLOURING.partner):
        d = x[partner] - x
        now = d.length()
        x = x + d * (pulls.share[group] * (now - pulls.rest[group]) / now)
    return x


class LimbSpace(NamedTuple):
    """The fixed surroundings of limbs, to which their limits refer. Last axis: limb."""

    forward: Vector  # of the limb's part of the torso
    limits: tuple[Vector, ...]  # directions that limit the first bone
    least: Float[Array, "limit limb"]  # least cosines of the first bone with them
    bones: Float[Array, "2 limb"]  # lengths, metres
    is_arm: Float[Array, " limb"]  # 1 or 0
    middle: Vector  # of the hips, metres
    outward: Vector
    trunk: _Axes  # of the whole torso
    size: Float[Array, "3 limb"]  # half depth, half width and height of the torso, metres
    apart: Float[Array, " limb"]  # least distance of knee and ankle from the plane between the legs, metres
    anchors: Vector  # points that springs connect to the limb's root; axes anchor (5), limb
    anchor_lengths: Float[Array, "5 limb"]  # metres
    anchor_stiffness: Float[Array, "5 limb"]  # 0: no such spring
    up: Vector  # normal of the floor, the lower limit of limbs
    floor: Float[Array, " limb"]  # its offset, metres
    over: Float[Array, " limb"]  # least height of the points above the floor, metres


def _list_anchors() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points, springs, used = np.zeros((4, 5), np.int32), np.zeros((4, 5), np.int32), np.zeros((4, 5), np.float32)
    for limb, (root, middle, _) in enumerate(LIMBS):
        mine = [(n, s) for n, s in enumerate(SPRINGS) if root in s[:2] and middle not in s[:2]]
        for slot, (number, (i, j, _)) in enumerate(mine):
            points[limb, slot], springs[limb, slot] = (j if i == root else i), number
            used[limb, slot] = 1
    return points, springs, used


_ANCHOR_POINTS, _ANCHOR_SPRINGS, _ANCHOR_USED = _list_anchors()


def limb_spaces(
    body: FlexibleBody, x: Vector, apart: Float[Array, ""] | float, floor: Float[Array, "4"] | None
) -> LimbSpace:
    """The surroundings of the four limbs in the body's present pose; last axis: limb.

    **Arguments:** `apart` least distance of knees and ankles from the plane between the legs, a share of the stature;
    `floor` normal and offset, metres; None: no floor.
    """
    upper, lower, middle, top = _find_torso(x)
    arm, side = jnp.asarray(IS_ARM), jnp.asarray(SIDE, x.v.dtype)
    forward, outward, up = (a.where(arm, b) for a, b in zip(upper, lower))
    outward = outward * side
    rows = np.swapaxes(_LIMITS, 0, 1)
    limits = tuple(forward * row[:, 0] + outward * row[:, 1] + up * row[:, 2] for row in rows)
    line = top - middle
    trunk = _orthogonalise(upper.left + lower.left, line)
    size = jnp.stack([0.9 * body.torso[0], 0.085 * body.stature, line.length()])
    ground = jnp.asarray(NO_FLOOR) if floor is None else floor
    each = lambda v: jax.tree.map(lambda a: jnp.broadcast_to(a[..., None], (*a.shape, 4)), v)  # noqa: E731
    return LimbSpace(
        forward, limits, jnp.asarray(rows[:, :, 3]), bone_lengths(body).T, arm.astype(x.v.dtype), each(middle),
        lower.left * side, each(trunk), each(size), each(apart * body.stature), x[_ANCHOR_POINTS.T],
        body.lengths[_ANCHOR_SPRINGS.T], body.stiffness[_ANCHOR_SPRINGS.T] * _ANCHOR_USED.T,
        each(vectors(ground[:3])), each(ground[3]), each(ANKLE * body.stature),
    )  # fmt: skip


Limb = tuple[Vector, Vector, Vector]  # root, middle, end; last axis: limb


def limb_bones(p: Limb, inverse: Float[Array, "3 #limb"], space: LimbSpace) -> Limb:
    """Relaxes the springs of limbs alone: two bones, and the springs from their roots to the fixed surroundings."""
    d = p[0] - space.anchors
    now = d.length()
    pull = space.anchor_stiffness * (now - space.anchor_lengths) / now
    stiff = jnp.maximum(jnp.sum(space.anchor_stiffness, 0), 1.0)
    whole = sum(((d * pull)[n] for n in range(1, len(pull))), (d * pull)[0])
    root, middle, end = p
    root = root - whole * (jnp.where(inverse[0] > 0, 1.0, 0.0) / stiff)
    d = middle - root
    move = d * _correction(d, space.bones[0], inverse[0] + inverse[1])
    root, middle = root + move * inverse[0], middle - move * inverse[1]
    d = end - middle
    move = d * _correction(d, space.bones[1], inverse[1] + inverse[2])
    return root, middle + move * inverse[1], end - move * inverse[2]


def _correction(d: Vector, rest: Array, weight: Array) -> Array:
    now = d.length()
    return (now - rest) / now / jnp.maximum(weight, 1e-6)


def limb_limits(p: Limb, inverse: Float[Array, "3 #limb"], space: LimbSpace) -> Limb:
    """Projects limbs onto their limits and out of collisions; points of inverse mass 0 stay."""
    root, middle, end = p
    free = jnp.where(inverse > 0, 1.0, 0.0)
    # limits of the first bone's direction
    d = middle - root
    now = d.length()
    over = [jnp.maximum(least * now - n.dot(d), 0.0) for n, least in zip(space.limits, space.least)]
    push = sum((n * o for n, o in zip(space.limits[1:], over[1:])), space.limits[0] * over[0])
    middle, end = middle + push * free[1], end + push * free[2]
    # two bones never fold flat on each other
    a, b = space.bones
    least = jnp.sqrt(a * a + b * b - 2 * a * b * jnp.cos(_SHARPEST))
    d = end - root
    now = d.length()
    end = end + d * (free[2] / now * jnp.maximum(least - now, 0.0))
    # knees bend forward
    line, own = end - root, middle - root
    at = jnp.clip(own.dot(line) / (line.dot(line) + 3 * TINY), 0.0, 1.0)
    behind = -(own - line * at).dot(space.forward) - _KNEE_BACK
    back = space.forward * ((1 - space.is_arm) * jnp.maximum(behind, 0.0))
    middle, end = middle + back * free[1], end - back * (0.5 * free[2])
    middle, end = _push_out(middle, free[1], space), _push_out(end, free[2], space)
    out = [p + space.up * (f * jnp.maximum(space.over - (p.dot(space.up) - space.floor), 0.0))
           for p, f in zip((root, middle, end), free)]  # fmt: skip
    return out[0], out[1], out[2]


def _push_out(p: Vector, free: Float[Array, " #limb"], space: LimbSpace) -> Vector:
    """Moves elbows and wrists out of the torso (an elliptic cylinder), knees and ankles to their own side."""
    local = p - space.middle
    deep, wide, high = (local.dot(v) for v in space.trunk)
    deep, wide = deep / space.size[0], wide / space.size[1]
    r = jnp.sqrt(deep**2 + wide**2 + TINY)
    inside = (r < 1) & (high > 0) & (high < space.size[2])
    out = jnp.where(inside, space.is_arm * (1 / jnp.maximum(r, 0.05) - 1), 0.0)
    push = space.trunk.forward * (deep * out * space.size[0]) + space.trunk.left * (wide * out * space.size[1])
    across = (1 - space.is_arm) * jnp.maximum(space.apart - local.dot(space.outward), 0.0)
    return p + (push + space.outward * across) * free


def _replace_points(x: Vector, rows: np.ndarray, new: Vector) -> Vector:
    """The points with some rows replaced; by a gather, since XLA is slow at writing few numbers."""
    order = np.arange(16, dtype=np.int32)
    order[rows.ravel()] = 16 + np.arange(rows.size)
    return Vector(jnp.concatenate([x.v, new.v.reshape(3, -1)], 1)[:, order])


def _span_trunk(x: Vector) -> Vector:
    return x[NECK] - (x[LOWER[2]] + x[LOWER[3]]) * 0.5


def stiff_trunk(x: Vector, inverse: Float[Array, " 16"], least: Float[Array, ""]) -> Vector:
    """Moves neck and hips apart to at least `least`, metres, as a bowed spine does: the springs alone let the flat
    torso fold at the waist (the paper's waist is relatively stiff, sec. IV-B)."""
    d = _span_trunk(x)
    now = d.length()
    own, others = inverse[NECK], (inverse[LOWER[2]] + inverse[LOWER[3]]) / 2
    size = jnp.maximum(least - now, 0.0) / now / jnp.maximum(own + others, 1e-6)
    moved = np.zeros((2, 16), np.float32)
    moved[0, NECK] = moved[1, LOWER[2:]] = 1
    by = size * (own * moved[0] - others * moved[1])
    return x + d * by


def separate_legs(x: Vector, inverse: Float[Array, " 16"], near: Float[Array, "2"]) -> Vector:
    """Moves knees and ankles apart along the hips' line, to at least `near`, metres: otherwise a hidden leg is drawn
    into the leg in front of it. Legs may cross one in front of the other."""
    left, right = np.array(LIMBS[2][1:]), np.array(LIMBS[3][1:])
    d, outward = x[left] - x[right], (x[LIMBS[2][0]] - x[LIMBS[3][0]]).unit()
    along = d.dot(outward)
    across = d - outward * along
    room = near**2 - across.dot(across)
    short = jnp.where(room > 0, jnp.maximum(jnp.sqrt(jnp.maximum(room, TINY)) - along, 0.0), 0.0)
    one, other = inverse[left], inverse[right]
    move = outward * (short / jnp.maximum(one + other, 1e-6))
    first, second = x[left] + move * one, x[right] - move * other
    return _replace_points(x, np.stack([left, right]), first.stack(second))


# 7 parameters: the body, its state and what acts on it, traced each
def relax(
    body: FlexibleBody, x: Float[Array, "16 3"], masses: Float[Array, " 16"], iterations: int | Int[Array, ""],
    apart: Float[Array, ""] | float = 0.0, limits: bool = True, floor: Float[Array, "4"] | None = None,
) -> Float[Array, "16 3"]:  # fmt: skip
    """Applies all springs and limits in turn, `iterations` times (like Gauss-Seidel; sec. II). Metres.

    **Arguments:** `masses` relative, infinite for fixed points; `apart` and `floor` see limb_spaces; `limits` False:
        springs only.
    """
    inverse = inverse_masses(masses)
    pulls, least = _prepare_springs(body, inverse), _BOWED * _span_trunk(vectors(body.rest)).length()
    near = jnp.asarray(LEGS_NEAR) * body.stature
    rows = np.ascontiguousarray(LIMBS.T)  # roots, middles, ends

    def sweep(_, x):
        x = _relax_springs(x, pulls)
        if not limits:
            return x
        x = separate_legs(stiff_trunk(x, inverse, least), inverse, near)
        moved = limb_limits((x[rows[0]], x[rows[1]], x[rows[2]]), inverse[rows], limb_spaces(body, x, apart, floor))
        return _replace_points(x, rows, moved[0].stack(*moved[1:]))

    if isinstance(iterations, int) and not iterations:
        return x
    return lax.fori_loop(0, iterations, sweep, vectors(x)).stacked()


def project_limb(p: Limb, inverse: Float[Array, "3 #limb"], space: LimbSpace, iterations: int) -> Limb:
    """Projects particles onto the active constraints of a limb, with all other points fixed (sec. III-A). `space` of
    one limb, broadcast to the particles."""
    step = lambda _, p: limb_limits(limb_bones(p, inverse, space), inverse, space)  # noqa: E731
    return limb_bones(lax.fori_loop(0, iterations, step, p), inverse, space)
