"""One frame of the flexible tracker: the head moves the body, four particle filters and the springs follow it
(Hecht et al. 2009, sec. III), then measured points pull the body onto themselves. Compiled.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.compile.executable import program
from voodoo_jax.trackers.flexible.cylinders import PARTS, closest
from voodoo_jax.trackers.flexible.flexible_body import HEAD, IS_ARM, LIMBS, FlexibleBody, bone_lengths
from voodoo_jax.trackers.flexible.image_features import COARSE
from voodoo_jax.trackers.flexible.physics import (
    LimbSpace,
    frames,
    inverse_masses,
    length,
    limb_spaces,
    project_limb,
    relax,
    unit,
    verlet,
)
from voodoo_jax.trackers.flexible.scores import (
    LimbContext,
    Score,
    View,
    Weighing,
    drawn,
    learn,
    limb_score,
    log_weight,
    occlusion,
    project,
    read,
    systematic,
)

_PROJECTIONS = 3  # sweeps over a particle's constraints: more change little, by hand
_DAMPING = 0.6  # share of the dangling body's velocity lost in a frame: it is overwritten by the filters, by hand
_HOLD = 4.0  # points' worth with which a body point stays where it is in the refinement, by hand
_PULL = 1.2  # how far it goes where its points pull it, by hand: over one, as springs take some of it back
_SWEEPS = 3  # relaxations after each pull, by hand
# in the refinement the head may move, but less than other points: its place is measured, by hand
_REFINED_MASSES = np.where(np.arange(16) == HEAD, np.float32(3), np.float32(1))
_REACH = 0.25  # metres, by hand: points farther from the body than this pull nothing
_NOT_CLOTHES = 0.3  # metres: more than what is told apart by distances, by hand
_FACE = 0.11  # of the stature: skin so near the head point may be the face's, measured on rendered people
_BARE_WEIGHT = 3.0  # points of skin weigh so much more for arms: a hand has few, by hand
_ANKLE, _STANCE = 0.041, 0.1  # height of an ankle, share of stature (the study's rest pose); metres, by hand
_UNEXPLAINED = 0.06  # metres, by hand: points nearer to the rest of the body than this are no other limb's
_EXPLAINED = 0.06  # metres, on real people's surface by cylinders: by hand


class Shape(NamedTuple):
    """What a program is compiled for."""

    particles: int
    layers: int
    relaxations: int
    refine: int
    restarts: int
    flow: bool
    points: bool  # whether measured points are used at all


class Numbers(NamedTuple):
    """Settings that are traced: changing them compiles nothing."""

    weighing: Weighing
    velocity: Float[Array, ""]
    depth_share: Float[Array, ""]
    depth_noise: Float[Array, "3"]  # metres
    base_noise: Float[Array, ""]
    spread_noise: Float[Array, ""]
    motion_noise: Float[Array, ""]
    follow: Float[Array, "2"]  # level, up
    gravity: Float[Array, ""]
    masses: Float[Array, "3"]  # base, variable, falloff per metre
    legs_apart: Float[Array, ""]
    floor: Float[Array, "4"]  # normal upwards and offset, metres


class State(NamedTuple):
    """What goes from frame to frame."""

    x: Float[Array, "16 3"]  # metres, fixed frame
    before: Float[Array, "16 3"]  # a frame earlier
    particles: Float[Array, "4 particle 3 3"]
    previous: Float[Array, "4 particle 3 3"]
    spread: Float[Array, "4 3"]  # standard deviation of the particles, metres
    colours: Float[Array, "4 2 ring 3"]
    learnt: Float[Array, "4 2 ring"]


class Inputs(NamedTuple):
    """What is seen in a frame."""

    view: View
    points: Float[Any, "point 3"]  # on the person, metres
    share: Float[Any, "point"]  # 0: none
    bare: Float[Any, "point"]  # how likely each is skin, 0..1
    head: Float[Any, "3"]  # metres
    head_seen: Float[Any, ""]  # 0 or 1
    up: Float[Any, "3"]
    dt: Float[Any, ""]  # seconds since the last frame
    index: Int[Any, ""]
    learn: Float[Any, ""]  # what the image counts for the colours; 0: nothing
    valid: Bool[Any, ""]  # False: no frame, only there to fill up


class Seen(NamedTuple):
    """What a frame says of itself."""

    x: Float[Array, "16 3"]
    spread: Float[Array, "4 3"]
    masses: Float[Array, " 16"]
    score: Score  # of each limb
    explained: Float[Array, ""]  # share of the points near the body
    residual: Float[Array, ""]  # root mean square distance of these, metres
    support: Float[Array, " part"]  # points of each part, see cylinders
    off: Float[Array, " part"]  # root mean square distance of each part's points, metres


def start(key: Array, body: FlexibleBody, x: Float[Array, "16 3"], shape: Shape) -> State:
    """The state before the first frame, the particles a little around a pose."""
    noise = 0.03 * jax.random.normal(key, (4, shape.particles, 3, 3))
    p = x[LIMBS][:, None] + noise
    # with the types that a frame's state has: else the second chunk would be a program of its own
    full = lambda shape, value: jnp.full(shape, value, x.dtype)  # noqa: E731
    return State(x, x, p, p, full((4, 3), 0.05), full((4, 2, 10, 3), 0.5), full((4, 2, 10), 0.0))


@program
def track_chunk(
    body: FlexibleBody, state: State, inputs: Inputs, key: Array, numbers: Numbers, shape: Shape
) -> tuple[State, Seen]:
    """Some frames, one after the other; leading axis of `inputs` and of what is seen: frame."""

    def one(state, given):
        after, seen = frame(body, state, given, jax.random.fold_in(key, given.index), numbers, shape)
        return jax.tree.map(lambda a, b: jnp.where(given.valid, a, b), after, state), seen

    return lax.scan(one, state, inputs)


def frame(body: FlexibleBody, state: State, given: Inputs, key: Array, n: Numbers, shape: Shape) -> tuple[State, Seen]:
    """One frame: prediction, filters, springs, refinement."""
    view, keys = given.view, jax.random.split(key, 3)
    # torso and head first: else limbs are drawn to the points that a bow leaves unexplained
    x = settled(body, _moved(body, state, given, n), body.masses, shape.refine // 2, given, n, shape)
    space, context = limb_spaces(body, x, n.legs_apart, n.floor), _context(body, state, x, given, shape)
    origin = state.particles
    ahead = _ahead(keys[0], state, view, n, shape)
    if shape.restarts:
        new = restarted(keys[1], body, x, context, given, n.floor, shape)
        ahead = ahead.at[:, -shape.restarts :].set(
            jnp.where(new[1][:, :, None, None], new[0], ahead[:, -shape.restarts :])
        )
        origin = origin.at[:, -shape.restarts :].set(
            jnp.where(new[1][:, :, None, None], new[0], origin[:, -shape.restarts :])
        )
    p, origin, mean, spread = _layers(keys[2], ahead, origin, state.spread, space, context, view, n, shape)
    masses = body.masses.at[LIMBS.ravel()].set((n.masses[0] + n.masses[1] * jnp.exp(-n.masses[2] * spread)).ravel())
    x = settled(body, x.at[LIMBS.ravel()].set(mean.reshape(12, 3)), masses, shape.refine, given, n, shape)
    shift = (x[LIMBS] - mean)[:, None] if shape.refine else jnp.zeros((4, 1, 3, 3))
    sure = jnp.exp(-n.masses[2] * spread)
    rate = given.learn * jnp.stack([sure[:, :2].mean(1), sure[:, 1:].mean(1)], 1)
    colours, learnt = learn(body, x, frames(x), view, state.colours, state.learnt, rate)
    after = State(x, state.x, p + shift, origin + shift, spread, colours, learnt)
    return after, _seen(body, x, spread, masses, given, context, n)


def _moved(body: FlexibleBody, state: State, given: Inputs, n: Numbers) -> Float[Array, "16 3"]:
    """The body with its head where it was measured, the rest following, a Verlet step later; not yet relaxed."""
    move = jnp.where(given.head_seen > 0, given.head - state.x[HEAD], 0.0)
    high = jnp.sum(move * given.up) * given.up
    follow = n.follow[0] * (move - high) + n.follow[1] * high
    x = (state.x + follow).at[HEAD].add(move - follow)
    free = inverse_masses(body.masses)[:, None] > 0
    pull = jnp.broadcast_to(-n.gravity * given.up, x.shape)
    later = verlet(x, state.before + follow, pull, given.dt, _DAMPING)
    return jnp.where(free, later, x)


# 7 parameters: model, state and measurements, traced each
def settled(
    body: FlexibleBody, x: Float[Array, "16 3"], masses: Float[Array, " 16"], rounds: int, given: Inputs, n: Numbers,
    shape: Shape,
) -> Float[Array, "16 3"]:  # fmt: skip
    """Springs and limits, then `rounds` of the refinement: one loop, so that both are compiled once."""

    def one(number, x):
        pulls = number > 0
        move = lambda: pulled(body, x, given.points, given.share, given.bare)  # noqa: E731
        x = lax.cond(pulls, move, lambda: x) if rounds else x
        sweeps = jnp.where(pulls, _SWEEPS, shape.relaxations)
        return relax(body, x, jnp.where(pulls, _REFINED_MASSES, masses), sweeps, n.legs_apart, True, n.floor)

    return lax.fori_loop(0, 1 + rounds, one, x)


def _context(body: FlexibleBody, state: State, x: Float[Array, "16 3"], given: Inputs, shape: Shape) -> LimbContext:
    hidden = occlusion(body, x, given.view)
    if shape.points:
        d = jnp.abs(closest(body, x, given.points).distance) + _clothed(given.bare)
        own = jnp.asarray(np.concatenate([np.repeat(np.eye(4, dtype=bool), 3, 1), np.zeros((4, 3), bool)], 1))
        others = jnp.min(jnp.where(own[:, None], 10.0, d), -1)
    else:
        others = jnp.full((4, len(given.points)), 10.0)
    each = lambda v: jnp.broadcast_to(v, (4, *v.shape))  # noqa: E731
    more = jnp.where(jnp.asarray(IS_ARM)[:, None], 1 + _BARE_WEIGHT * given.bare, 1.0)
    return LimbContext(
        hidden, state.colours, state.learnt, each(given.points), others, given.share * more, each(frames(x).lower[0]),
        jnp.asarray(IS_ARM, x.dtype), body.radii, body.tips, each(jnp.append(x[HEAD], _FACE * body.stature)),
    )  # fmt: skip


def _clothed(bare: Float[Array, " point"]) -> Float[Array, "point part"]:
    """By how much farther bare skin is from what is clothed than it seems to be: it is of a face, an arm or a hand."""
    covered = np.ones(PARTS, np.float32)
    covered[:6] = covered[12] = 0
    return _NOT_CLOTHES * bare[:, None] * covered


def _ahead(key: Array, state: State, view: View, n: Numbers, shape: Shape) -> Float[Array, "4 particle 3 3"]:
    """Where the particles are expected: damped constant velocity, every second one by the optical flow."""
    p = state.particles
    by_velocity = p + n.velocity * (p - state.previous)
    if not shape.flow:
        return by_velocity
    at, z = project(view, p)
    flow, inside = read(view.flow, (at - (COARSE - 1) / 2) / COARSE)
    flow = jnp.where(inside[..., None], flow, 0.0)
    across = jnp.concatenate([flow / view.focal[:2] * z[..., None], jnp.zeros_like(z)[..., None]], -1)
    by_flow = p + across @ view.turn
    return jnp.where((jnp.arange(p.shape[1]) % 2 == 0)[:, None, None], by_flow, by_velocity)


# 7 parameters: model, state and measurements, traced each
def restarted(
    key: Array, body: FlexibleBody, x: Float[Array, "16 3"], context: LimbContext, given: Inputs,
    floor: Float[Array, "4"], shape: Shape,
) -> tuple[Float[Array, "4 restart 3 3"], Bool[Array, "4 restart"]]:  # fmt: skip
    """Limbs anew: their ends where points are that the rest of the body does not explain, their middles anywhere around
    the line to it; of legs, every second one stands on the floor, for the points of a leg may be near the other one.
    And whether there is such a place within reach."""
    bones, up = bone_lengths(body), floor[:3]
    second = jnp.arange(shape.restarts) % 2 == 0

    def limb(key, root, bones, others, arm, tip):
        keys = jax.random.split(key, 4)
        far = length(given.points - root)[:, 0] / jnp.sum(bones)
        weight = given.share * jnp.clip(others - _UNEXPLAINED, 0, 0.2) * jnp.where(far < 1.15, far**2, 0.0)
        at = drawn(keys[0], weight + 1e-9, shape.restarts)
        end = given.points[at] + 0.03 * jax.random.normal(keys[1], (shape.restarts, 3))
        high = root @ up - floor[3] - _ANKLE * body.stature
        foot = root - high * up + _STANCE * jax.random.normal(keys[1], end.shape)
        stands = second & (arm == 0) & (high < 1.5 * jnp.sum(bones))
        end = jnp.where(stands[:, None], foot, end)
        # of an arm, the point may be anywhere on the hand
        lower = bones[1] + arm * tip * jax.random.uniform(keys[3], (shape.restarts, 1))
        line = end - root
        whole = bones[0] + lower
        reach = jnp.clip(length(line), 0.3 * whole, 0.999 * whole)
        way = unit(line)
        along = (bones[0] ** 2 - lower**2 + reach**2) / (2 * reach)
        high = jnp.sqrt(jnp.maximum(bones[0] ** 2 - along**2, 0.0))
        pole = jax.random.normal(keys[2], line.shape)
        pole = jnp.where(arm > 0, pole, 0.3 * pole + 2 * context.forward[0])
        pole = unit(pole - way * jnp.sum(pole * way, -1, keepdims=True))
        middle = root + along * way + high * pole
        last = middle + (root + reach * way - middle) * bones[1] / lower
        p = jnp.stack([jnp.broadcast_to(root, line.shape), middle, last], 1)
        return p, (weight[at] > 0) | stands

    arms = jnp.asarray(IS_ARM, x.dtype)
    return jax.vmap(limb)(jax.random.split(key, 4), x[LIMBS[:, 0]], bones, context.others, arms, body.tips)


# 9 parameters: model, state and measurements of a limb, traced each
def _layers(
    key: Array, p: Array, origin: Array, spread: Array, space: LimbSpace, context: LimbContext, view: View, n: Numbers,
    shape: Shape,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Spreads, weighs and draws the particles anew, in each layer finer: particles, where they came from, their
    weighted mean and standard deviation [limb, point]."""
    count = shape.layers
    scales = jnp.asarray([0.5**k for k in range(count)], jnp.float32)
    powers = jnp.asarray([(k + 1) / count for k in range(count)], jnp.float32)

    # 8 parameters: model, state and measurements of a limb, traced each
    def limb_layer(key, p, origin, spread, space, context, scale, power):
        keys = jax.random.split(key, 5)
        at, _ = project(view, p)
        motion, inside = read(view.motion, (at - (COARSE - 1) / 2) / COARSE)
        motion = jnp.where(inside, motion.astype(jnp.float32) / 255, 0.0)
        sigma = n.base_noise + n.spread_noise * jnp.minimum(spread, 0.2) + n.motion_noise * motion
        plain = sigma[..., None] * jax.random.normal(keys[0], p.shape)
        ray = unit(p + view.shift @ view.turn)  # from the camera's centre, -shift in its own frame
        deep = (n.depth_noise * jax.random.normal(keys[1], p.shape[:2]))[..., None] * ray
        pick = jax.random.uniform(keys[2], (len(p), 1, 1)) < n.depth_share
        p = p + scale * jnp.where(pick, deep, plain)
        p = jax.vmap(project_limb, (0, None, None, None))(p, jnp.ones(3), space, _PROJECTIONS)
        logs = log_weight(jax.vmap(limb_score, (0, None, None, None))(p, context, view, n.weighing), n.weighing)
        w = jnp.exp(power * (logs - jnp.max(logs)))
        w = w / jnp.sum(w)
        mean = jnp.einsum("n,nij->ij", w, p)
        deviation = jnp.sqrt(jnp.einsum("n,nij->i", w, (p - mean) ** 2) + 1e-9)
        again = systematic(keys[3], w)
        return p[again], origin[again], mean, deviation

    def layer(carry, given):
        number, scale, power = given
        p, origin, _, spread = carry
        keys = jax.random.split(jax.random.fold_in(key, number), 4)
        return jax.vmap(limb_layer, (0, 0, 0, 0, 0, 0, None, None))(
            keys, p, origin, spread, space, context, scale, power
        ), None

    first = p, origin, jnp.zeros((4, 3, 3)), spread
    return lax.scan(layer, first, (jnp.arange(count), scales, powers))[0]


# 7 parameters: model, state and measurements, traced each
def refined(
    body: FlexibleBody, x: Float[Array, "16 3"], points: Float[Array, "point 3"], share: Float[Array, "point"],
    rounds: int, legs_apart: Float[Array, ""] | float = 0.0, floor: Float[Array, "4"] | None = None,
    bare: Float[Array, "point"] | None = None,
) -> Float[Array, "16 3"]:  # fmt: skip
    """Points pull the nearest axes and patches until they lie on the surface, then springs and limits hold: in turn.
    Differentiable: which part is nearest is held fixed."""

    def one(_, x):
        moved = pulled(body, x, points, share, bare)
        return relax(body, moved, jnp.asarray(_REFINED_MASSES), _SWEEPS, legs_apart, True, floor)

    return lax.fori_loop(0, rounds, one, x) if rounds else x


def pulled(
    body: FlexibleBody, x: Float[Array, "16 3"], points: Float[Array, "point 3"], share: Float[Array, "point"],
    bare: Float[Array, "point"] | None = None,
) -> Float[Array, "16 3"]:  # fmt: skip
    """The body's points moved to where measured points pull the nearest axes and patches."""
    found = closest(body, x, points)
    farther = 0.0 if bare is None else _clothed(bare)
    best = lax.stop_gradient(jnp.argmin(jnp.abs(found.distance) + farther, 1))
    pick = lambda a: jnp.take_along_axis(a, best.reshape(-1, *[1] * (a.ndim - 1)), 1)[:, 0]  # noqa: E731
    d, away, weights = pick(found.distance), pick(found.away), pick(found.weights)
    carriers = found.carriers[best]
    use = share * (jnp.abs(d) < _REACH) / (1 + (d / 0.08) ** 2)
    full = jnp.sum(weights[..., None] * jax.nn.one_hot(carriers, 16), 1)  # [point, body point]
    pull = (full * use[:, None]).T @ (d[:, None] * away)
    norm = jnp.abs(full * use[:, None]).sum(0)
    return x + _PULL * pull / (norm + _HOLD)[:, None]


# 7 parameters: model, state and measurements, traced each
def _seen(
    body: FlexibleBody, x: Float[Array, "16 3"], spread: Array, masses: Array, given: Inputs, context: LimbContext,
    n: Numbers,
) -> Seen:  # fmt: skip
    score = jax.vmap(limb_score, (0, 0, None, None))(x[LIMBS], context, given.view, n.weighing)
    d = closest(body, x, given.points).distance
    best = jnp.argmin(jnp.abs(d), 1)
    nearest = jnp.take_along_axis(d, best[:, None], 1)[:, 0]
    near = given.share * (jnp.abs(nearest) < _EXPLAINED)
    total = jnp.maximum(jnp.sum(given.share), 1e-6)
    residual = jnp.sqrt(jnp.sum(near * nearest**2) / jnp.maximum(jnp.sum(near), 1e-6))
    mine = jax.nn.one_hot(best, PARTS) * given.share[:, None]
    support = mine.sum(0)
    off = jnp.sqrt((mine * nearest[:, None] ** 2).sum(0) / jnp.maximum(support, 1e-6))
    return Seen(x, spread, masses, score, jnp.sum(near) / total, residual, support, off)
