"""Physics of the flexible body (Hecht et al. 2009, sec. II): Verlet steps, relaxation of springs and limits.

Everything is pure and takes arrays of fixed shapes, so that it is compiled once and mapped over particles, bodies and
recordings; gradients flow through positions, lengths and stiffnesses.
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

# least cosines of the first bone's direction with an axis of the torso (forward, outward, up; signs as in the rows);
# ranges of motion of shoulders and hips, set by hand: backward, across, and for legs outward and up
_ARM_LIMITS = (((1, 0, 0), -0.80), ((0, 1, 0), -0.65), ((0, -1, 0), -1.0), ((0, 0, -1), -1.0))
# as above, by hand
_LEG_LIMITS = (((1, 0, 0), -0.55), ((0, 1, 0), -0.45), ((0, -1, 0), -0.80), ((0, 0, -1), -0.70))
# both, by hand
_LIMITS = np.array([[(*n, c) for n, c in rows] for rows in (_ARM_LIMITS,) * 2 + (_LEG_LIMITS,) * 2], np.float32)
_SHARPEST = 0.52  # least angle between two bones of a limb, radians: set by hand, 30 degrees
_KNEE_BACK = 0.02  # metres that a knee may be behind the line from hip to ankle, set by hand
# share of the standing distance from the hips' middle to the neck that is left when a person bows: spines bend, hips do
# the rest. Measured on rendered people (0.915 to 0.95), whose flat bodies else fold at the waist
_BOWED = 0.92
# how near the two knees and the two ankles come to each other, shares of stature: measured on 27 recordings of people
# who stand, walk, run and bow (knees 0.072 and more, ankles 0.053)
_LEGS_NEAR = np.array([0.075, 0.058], np.float32)
_OVER = 0.035  # share of the stature that an ankle is above the floor, measured on the built-in body
_NO_FLOOR = np.array([0.0, 0.0, 1.0, -1e3], np.float32)  # by hand: a kilometre down
_TINY = 1e-9  # square metres: float32 has no smaller distances here


class Frames(NamedTuple):
    """Directions of the torso's two parts, from positions of points; rows: forward, left, up."""

    upper: Float[Array, "3 3"]
    lower: Float[Array, "3 3"]
    middle: Float[Array, "3"]  # of the hips, metres
    top: Float[Array, "3"]  # of the shoulders, metres


def length(v: Float[Array, "*b 3"]) -> Float[Array, "*b 1"]:
    """Lengths, kept as an axis; smooth at zero."""
    return jnp.sqrt(jnp.sum(v * v, -1, keepdims=True) + _TINY)


def unit(v: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    return v / length(v)


def _frame(left: Float[Array, "3"], up: Float[Array, "3"]) -> Float[Array, "3 3"]:
    up = unit(up)
    left = unit(left - up * jnp.sum(left * up))
    return jnp.stack([jnp.cross(left, up), left, up])


def frames(x: Float[Array, "16 3"]) -> Frames:
    """The torso's frames: limits of shoulders hold in the upper one, of hips in the lower one."""
    shoulders, waist, hips = (x[2] + x[5]) / 2, (x[8] + x[9]) / 2, (x[10] + x[13]) / 2
    return Frames(_frame(x[2] - x[5], shoulders - waist), _frame(x[10] - x[13], waist - hips), hips, shoulders)


def verlet(
    x: Float[Array, "16 3"], before: Float[Array, "16 3"], acceleration: Float[Array, "16 3"], dt: Float[Array, ""],
    damping: Float[Array, ""] | float = 0.0,
) -> Float[Array, "16 3"]:  # fmt: skip
    """Positions one step of `dt` seconds later (Verlet 1967); `damping` takes this share of the velocity away."""
    return x + (1 - damping) * (x - before) + acceleration * dt**2


def inverse_masses(masses: Float[Array, " 16"]) -> Float[Array, " 16"]:
    """1/m, 0 for what cannot be moved."""
    return jnp.where(jnp.isinf(masses), 0.0, 1 / jnp.where(jnp.isinf(masses), 1.0, masses))


def relax_springs(body: FlexibleBody, x: Float[Array, "16 3"], inverse: Float[Array, " 16"]) -> Float[Array, "16 3"]:
    """One Gauss-Seidel sweep over the springs, group by group; no spring moves a point of inverse mass 0."""
    lengths, stiffness = body.lengths[COLOURING.springs], body.stiffness[COLOURING.springs]

    def group(x, given):
        incidence, rest, stiff = given
        d = incidence @ x
        weight = jnp.abs(incidence) @ inverse
        now = length(d)[:, 0]
        pull = stiff * (now - rest) / now / jnp.maximum(weight, 1e-6)
        return x - inverse[:, None] * (incidence.T @ (pull[:, None] * d)), None

    return lax.scan(group, x, (jnp.asarray(COLOURING.incidence), lengths, stiffness))[0]


class LimbSpace(NamedTuple):
    """What the limits of one limb refer to. All but the limb itself stays where it is."""

    frame: Float[Array, "3 3"]  # rows: forward, outward, up of the limb's part of the torso
    limits: Float[Array, "4 4"]  # direction in that frame and least cosine
    bones: Float[Array, "2"]  # lengths, metres
    is_arm: Float[Array, ""]  # 1 or 0
    middle: Float[Array, "3"]  # of the hips, metres
    outward: Float[Array, "3"]
    trunk: Float[Array, "3 3"]  # forward, left, up of the whole torso
    size: Float[Array, "3"]  # half depth, half width and height of the torso, metres
    apart: Float[Array, ""]  # least distance of knee and ankle from the plane between the legs, metres
    anchors: Float[Array, "5 3"]  # points that springs join to the limb's root
    anchor_lengths: Float[Array, "5"]  # metres
    anchor_stiffness: Float[Array, "5"]  # 0: no such spring
    floor: Float[Array, "4"]  # normal upwards, and its offset: nothing of a limb is below; metres
    over: Float[Array, ""]  # so high above it are the points at least, metres


def _anchor_tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points, springs, used = np.zeros((4, 5), int), np.zeros((4, 5), int), np.zeros((4, 5), np.float32)
    for limb, (root, middle, _) in enumerate(LIMBS):
        mine = [(n, s) for n, s in enumerate(SPRINGS) if root in s[:2] and middle not in s[:2]]
        for slot, (number, (i, j, _)) in enumerate(mine):
            points[limb, slot], springs[limb, slot] = (j if i == root else i), number
            used[limb, slot] = 1
    return points, springs, used


_ANCHOR_POINTS, _ANCHOR_SPRINGS, _ANCHOR_USED = _anchor_tables()


def limb_spaces(
    body: FlexibleBody, x: Float[Array, "16 3"], apart: Float[Array, ""] | float, floor: Float[Array, "4"] | None = None
) -> LimbSpace:
    """Of the four limbs, as the rest of the body stands now; leading axis: limb.

    **Arguments:** `apart` least distance of knees and ankles from the plane between the legs, a share of the stature;
    `floor` normal and offset, metres; None: there is none.
    """
    f = frames(x)
    arm, side = jnp.asarray(IS_ARM), jnp.asarray(SIDE, x.dtype)[:, None]
    frame = jnp.where(arm[:, None, None], f.upper, f.lower)
    outward = side * frame[:, 1]
    frame = frame.at[:, 1].set(outward)
    trunk = _frame(f.upper[1] + f.lower[1], f.top - f.middle)
    high = length(f.top - f.middle)[0]
    size = jnp.stack([0.9 * body.torso[0], 0.085 * body.stature, high])
    each = lambda v: jnp.broadcast_to(v, (4, *v.shape))  # noqa: E731
    return LimbSpace(
        frame, jnp.asarray(_LIMITS), bone_lengths(body), arm.astype(x.dtype), each(f.middle), side * f.lower[1],
        each(trunk), each(size), each(apart * body.stature), x[_ANCHOR_POINTS], body.lengths[_ANCHOR_SPRINGS],
        body.stiffness[_ANCHOR_SPRINGS] * _ANCHOR_USED,
        each(jnp.asarray(_NO_FLOOR) if floor is None else floor), each(_OVER * body.stature),
    )  # fmt: skip


def limb_bones(p: Float[Array, "3 3"], inverse: Float[Array, "3"], space: LimbSpace) -> Float[Array, "3 3"]:
    """Springs of a limb alone: its two bones, and those that hold its root to the rest, which does not move."""
    d = p[0] - space.anchors
    now = length(d)[:, 0]
    pull = space.anchor_stiffness * (now - space.anchor_lengths) / now
    stiff = jnp.maximum(jnp.sum(space.anchor_stiffness), 1e-6)
    p = p.at[0].add(-jnp.where(inverse[0] > 0, 1.0, 0.0) * jnp.sum(pull[:, None] * d, 0) / jnp.maximum(stiff, 1.0))
    for bone in (0, 1):
        d = p[bone + 1] - p[bone]
        now, weight = length(d)[0], jnp.maximum(inverse[bone] + inverse[bone + 1], 1e-6)
        move = d * (now - space.bones[bone]) / now / weight
        p = p.at[bone].add(inverse[bone] * move).at[bone + 1].add(-inverse[bone + 1] * move)
    return p


def limb_limits(p: Float[Array, "3 3"], inverse: Float[Array, "3"], space: LimbSpace) -> Float[Array, "3 3"]:
    """Projects a limb to where its limits and collisions allow it to be: points of inverse mass 0 stay."""
    free = jnp.where(inverse > 0, 1.0, 0.0)
    # the first bone's direction
    d = p[1] - p[0]
    over = jnp.maximum(space.limits[:, 3] * length(d)[0] - (space.limits[:, :3] @ space.frame) @ d, 0.0)
    push = over @ (space.limits[:, :3] @ space.frame)
    p = p + free[:, None] * jnp.array([0.0, 1.0, 1.0])[:, None] * push
    # two bones never fold flat on each other
    a, b = space.bones[0], space.bones[1]
    least = jnp.sqrt(a * a + b * b - 2 * a * b * jnp.cos(_SHARPEST))
    d = p[2] - p[0]
    now = length(d)[0]
    p = p.at[2].add(free[2] * unit(d) * jnp.maximum(least - now, 0.0))
    # knees bend forward
    line = p[2] - p[0]
    at = jnp.clip(jnp.sum((p[1] - p[0]) * line) / jnp.sum(line * line + _TINY), 0.0, 1.0)
    behind = -jnp.sum((p[1] - p[0] - at * line) * space.frame[0]) - _KNEE_BACK
    back = (1 - space.is_arm) * jnp.maximum(behind, 0.0) * space.frame[0]
    p = p + free[:, None] * jnp.array([0.0, 1.0, -0.5])[:, None] * back
    p = p.at[1:].set(_apart(p[1:], free[1:], space))
    up = space.floor[:3]
    return p + (free * jnp.maximum(space.over - (p @ up - space.floor[3]), 0.0))[:, None] * up


def _apart(p: Float[Array, "2 3"], free: Float[Array, "2"], space: LimbSpace) -> Float[Array, "2 3"]:
    """Elbows and wrists out of the torso (an anisotropically scaled cylinder), knees and ankles on their own side."""
    local = (p - space.middle) @ space.trunk.T
    scaled = local[:, :2] / space.size[:2]
    r = jnp.sqrt(jnp.sum(scaled**2, -1) + _TINY)
    inside = (r < 1) & (local[:, 2] > 0) & (local[:, 2] < space.size[2])
    out = scaled * (1 / jnp.maximum(r, 0.05) - 1)[:, None] * space.size[:2]
    push = jnp.where(inside[:, None], out, 0.0) @ space.trunk[:2]
    across = jnp.maximum(space.apart - (p - space.middle) @ space.outward, 0.0)
    return p + free[:, None] * (space.is_arm * push + (1 - space.is_arm) * across[:, None] * space.outward)


def stiff_trunk(body: FlexibleBody, x: Float[Array, "16 3"], inverse: Float[Array, " 16"]) -> Float[Array, "16 3"]:
    """Neck and hips moved apart as far as a bowed spine holds them: the flat torso's springs alone let it fold at the
    waist (the paper's waist is relatively stiff, sec. IV-B)."""
    hips = np.array([LOWER[2], LOWER[3]])
    span = lambda points: points[NECK] - points[hips].mean(0)  # noqa: E731
    d, least = span(x), _BOWED * length(span(body.rest))[0]
    own, others = inverse[NECK], inverse[hips].mean()
    move = jnp.maximum(least - length(d)[0], 0.0) * unit(d) / jnp.maximum(own + others, 1e-6)
    return x.at[NECK].add(own * move).at[hips].add(-others * move)


def separate_legs(body: FlexibleBody, x: Float[Array, "16 3"], inverse: Float[Array, " 16"]) -> Float[Array, "16 3"]:
    """Knees and ankles moved apart, along the hips' line, to where two legs have room: else a leg that another one
    hides is drawn into it. Legs one before the other may cross."""
    left, right = np.array(LIMBS[2][1:]), np.array(LIMBS[3][1:])
    d, outward = x[left] - x[right], unit(x[LIMBS[2][0]] - x[LIMBS[3][0]])
    along = d @ outward
    across = d - along[:, None] * outward
    room = (_LEGS_NEAR * body.stature) ** 2 - jnp.sum(across**2, -1)
    short = jnp.where(room > 0, jnp.maximum(jnp.sqrt(jnp.maximum(room, _TINY)) - along, 0.0), 0.0)
    one, other = inverse[left], inverse[right]
    move = (short / jnp.maximum(one + other, 1e-6))[:, None] * outward
    return x.at[left].add(one[:, None] * move).at[right].add(-other[:, None] * move)


# 7 parameters: the body, its state and what acts on it, traced each
def relax(
    body: FlexibleBody, x: Float[Array, "16 3"], masses: Float[Array, " 16"], iterations: int | Int[Array, ""],
    apart: Float[Array, ""] | float = 0.0, limits: bool = True, floor: Float[Array, "4"] | None = None,
) -> Float[Array, "16 3"]:  # fmt: skip
    """Applies all springs and limits in turn, so many times (like Gauss-Seidel; sec. II).

    **Arguments:** `masses` relative, infinite for what stays; `apart` see limb_spaces; `limits` False: springs only;
        `floor` see limb_spaces.
    """
    inverse = inverse_masses(masses)

    def sweep(_, x):
        x = relax_springs(body, x, inverse)
        if not limits:
            return x
        x = separate_legs(body, stiff_trunk(body, x, inverse), inverse)
        moved = jax.vmap(limb_limits)(x[LIMBS], inverse[LIMBS], limb_spaces(body, x, apart, floor))
        return x.at[LIMBS.ravel()].set(moved.reshape(12, 3))

    if isinstance(iterations, int) and not iterations:
        return x
    return lax.fori_loop(0, iterations, sweep, x)


def project_limb(
    p: Float[Array, "3 3"], inverse: Float[Array, "3"], space: LimbSpace, iterations: int
) -> Float[Array, "3 3"]:
    """A particle moved to where the active constraints let a limb be, all other points fixed (sec. III-A)."""
    step = lambda _, p: limb_limits(limb_bones(p, inverse, space), inverse, space)  # noqa: E731
    return limb_bones(lax.fori_loop(0, iterations, step, p), inverse, space)


# 9 parameters: the body, its state and what acts on it, traced each
def step(
    body: FlexibleBody, x: Float[Array, "16 3"], before: Float[Array, "16 3"], gravity: Float[Array, "3"],
    dt: Float[Array, ""] | float, damping: float, iterations: int,
    apart: Float[Array, ""] | float = 0.0, floor: Float[Array, "4"] | None = None,
) -> Float[Array, "16 3"]:  # fmt: skip
    """The body a time step later, dangling from its head, which stays where it is (sec. II)."""
    free = inverse_masses(body.masses)[:, None] > 0
    moved = jnp.where(free, verlet(x, before, jnp.broadcast_to(gravity, x.shape), jnp.asarray(dt), damping), x)
    return relax(body, moved, body.masses, iterations, apart, True, floor)


def energy(
    body: FlexibleBody, x: Float[Array, "16 3"], before: Float[Array, "16 3"], dt: float, gravity: float = 9.81
) -> Float[Array, ""]:
    """Kinetic and potential energy of the points that can move, relative masses times square metres per square second.
    Heights along z."""
    m = jnp.where(jnp.isinf(body.masses), 0.0, body.masses)
    speed = (x - before) / dt
    return jnp.sum(m * (0.5 * jnp.sum(speed**2, -1) + gravity * (x[:, 2] + before[:, 2]) / 2))
