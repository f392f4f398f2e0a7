"""One frame of the flexible tracker: the head moves the body, four particle filters and the springs follow it
(Hecht et al. 2009, sec. III), then measured points pull the body onto themselves. Compiled.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.compile.executable import program
from voodoo_jax.trackers.flexible.cylinders import PARTS, nearest_places, surface_distance
from voodoo_jax.trackers.flexible.flexible_body import HEAD, IS_ARM, LIMBS, FlexibleBody, bone_lengths
from voodoo_jax.trackers.flexible.image_features import COARSE
from voodoo_jax.trackers.flexible.physics import (
    Limb,
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
    drawn,
    learn,
    limb_score,
    log_weight,
    occlusion,
    project,
    read,
    systematic,
    worthwhile,
)
from voodoo_jax.trackers.flexible.state import Inputs, Numbers, Seen, Shape, State
from voodoo_jax.trackers.flexible.vectors import Vector, kept, turned, vector, vectors

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
# share of a frame's points that a limb's particles look at: a leg has a fifth of a person's surface, by hand
_WORTHWHILE = 1 / 3
_EXPLAINED = 0.06  # metres, on real people's surface by cylinders: by hand; nearer points are no other part's


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
        run = lambda: frame(body, state, given, jax.random.fold_in(key, given.index), numbers, shape)  # noqa: E731
        return lax.cond(given.valid, run, lambda: (state, _nothing(state)))

    return lax.scan(one, state, inputs)


def _nothing(state: State) -> Seen:
    """What no frame says of itself: written down, for to ask `frame` for its shapes would trace it twice."""
    none = lambda *shape: jnp.zeros(shape, state.x.dtype)  # noqa: E731
    score = Score(none(4), none(4), none(4), none(4), none(4))
    return Seen(none(16, 3), none(4, 3), none(16), score, none(), none(), none(PARTS), none(PARTS))


def frame(body: FlexibleBody, state: State, given: Inputs, key: Array, n: Numbers, shape: Shape) -> tuple[State, Seen]:
    """One frame: prediction, filters, springs, refinement."""
    view, args = given.view, (body, state, given, key, n)
    filters = jax.jit(_filtered, static_argnums=6)  # it is traced once, for its shapes and for itself
    x, blank = head_moved(body, state, given, n), jax.eval_shape(filters, *args, state.x, shape)
    none = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), blank)

    def settle(phase, carry):
        """Torso and head first: else limbs are drawn to the points that a bow leaves unexplained."""
        x, found = carry
        found = lax.cond(phase > 0, lambda: filters(*args, x, shape), lambda: found._replace(x=x, masses=body.masses))
        rounds = jnp.where(phase > 0, shape.refine, shape.refine // 2)
        return settled(body, found.x, found.masses, rounds, given, n, shape), found

    x, found = lax.fori_loop(0, 2, settle, (x, none))  # so that both are compiled once
    p, origin, mean, spread, masses = found.particles, found.origin, found.mean, found.spread, found.masses
    near = found.near
    shift = (x[LIMBS] - mean)[:, None] if shape.refine else jnp.zeros((4, 1, 3, 3))
    sure = jnp.exp(-n.masses[2] * spread)
    rate = given.learn * jnp.stack([sure[:, :2].mean(1), sure[:, 1:].mean(1)], 1)

    def more():
        known = learn(body, x, frames(x), view, found.hidden, state.colours, state.learnt, rate)
        for other, hidden in zip(view.more, found.more):
            known = learn(body, x, frames(x), other, hidden, *known, rate * other.there)
        return known

    colours, learnt = lax.cond(given.learn > 0, more, lambda: (state.colours, state.learnt))
    after = State(x, state.x, p + shift, origin + shift, spread, colours, learnt)
    return after, _seen(body, x, spread, masses, given, near, n)


class Filtered(NamedTuple):
    """What the filters say of a frame."""

    x: Float[Array, "16 3"]  # the body with their means, metres
    masses: Float[Array, " 16"]
    particles: Float[Array, "4 particle 3 3"]
    origin: Float[Array, "4 particle 3 3"]  # where each came from
    mean: Float[Array, "4 3 3"]
    spread: Float[Array, "4 3"]  # standard deviation, metres
    near: LimbContext  # with the points that limbs look at
    hidden: Float[Array, "4 row column"]  # see scores.occlusion
    more: tuple[Float[Array, "4 row column"], ...]  # the same in the views of further cameras


# 7 parameters: model, state and measurements, traced each
def _filtered(
    body: FlexibleBody, state: State, given: Inputs, key: Array, n: Numbers, x: Float[Array, "16 3"], shape: Shape
) -> Filtered:
    """The filters of all limbs, of a body whose trunk stands."""
    view, keys = given.view, jax.random.split(key, 3)
    space, context = limb_spaces(body, vectors(x), n.legs_apart, n.floor), _context(body, state, x, given, shape)
    origin = state.particles
    ahead = carried_on(state, view, n, shape)
    if shape.restarts:
        new = restarted(keys[1], body, x, context, given, n.floor, shape)
        ahead = ahead.at[:, -shape.restarts :].set(
            jnp.where(new[1][:, :, None, None], new[0], ahead[:, -shape.restarts :])
        )
        origin = origin.at[:, -shape.restarts :].set(
            jnp.where(new[1][:, :, None, None], new[0], origin[:, -shape.restarts :])
        )
    near = jax.vmap(lambda one: worthwhile(one, round(_WORTHWHILE * len(given.points)), n.weighing))(context)
    p, origin, mean, spread = spread_and_drawn(keys[2], ahead, origin, state.spread, space, near, view, n, shape)
    masses = body.masses.at[LIMBS.ravel()].set((n.masses[0] + n.masses[1] * jnp.exp(-n.masses[2] * spread)).ravel())
    x = x.at[LIMBS.ravel()].set(mean.reshape(12, 3))
    return Filtered(x, masses, p, origin, mean, spread, near, context.hidden, context.more)


def head_moved(body: FlexibleBody, state: State, given: Inputs, n: Numbers) -> Float[Array, "16 3"]:
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
    body: FlexibleBody, x: Float[Array, "16 3"], masses: Float[Array, " 16"], rounds: Int[Array, ""], given: Inputs,
    n: Numbers, shape: Shape,
) -> Float[Array, "16 3"]:  # fmt: skip
    """Springs and limits, then `rounds` of the refinement: one loop, so that both are compiled once."""

    def one(number, x):
        pulls = number > 0
        move = lambda: pulled(body, x, given.points, given.share, given.bare)  # noqa: E731
        x = lax.cond(pulls, move, lambda: x) if shape.refine else x
        sweeps = jnp.where(pulls, _SWEEPS, shape.relaxations)
        return relax(body, x, jnp.where(pulls, _REFINED_MASSES, masses), sweeps, n.legs_apart, True, n.floor)

    return lax.fori_loop(0, 1 + rounds, one, x)


def _context(body: FlexibleBody, state: State, x: Float[Array, "16 3"], given: Inputs, shape: Shape) -> LimbContext:
    hidden = occlusion(body, x, given.view)
    used = len(given.points) if shape.points or shape.restarts else 0
    if shape.points:
        d = jnp.abs(surface_distance(body, x, vectors(given.points))) + clothed(given.bare)
        own = np.concatenate([np.repeat(np.eye(4, dtype=bool), 3, 1), np.zeros((4, 3), bool)], 1)
        others = kept(given.view.focal[0] > 0, lambda d: jnp.min(jnp.where(own[..., None], 10.0, d), 1), d)
    else:
        others = jnp.full((4, used), 10.0)
    each = lambda v: jnp.broadcast_to(v, (4, *v.shape))  # noqa: E731
    more = jnp.where(jnp.asarray(IS_ARM)[:, None], 1 + _BARE_WEIGHT * given.bare, 1.0)
    return LimbContext(
        hidden, state.colours, state.learnt, each(given.points[:used]), others, (given.share * more)[:, :used],
        jnp.zeros((4, 2)), each(frames(x).lower[0]),
        jnp.asarray(IS_ARM, x.dtype), body.radii, body.tips, each(jnp.append(x[HEAD], _FACE * body.stature)),
        tuple(occlusion(body, x, view) for view in given.view.more),
    )  # fmt: skip


def clothed(bare: Float[Array, " point"]) -> Float[Array, "part point"]:
    """By how much farther bare skin is from what is clothed than it seems to be: it is of a face, an arm or a hand."""
    covered = np.ones((PARTS, 1), np.float32)
    covered[:6] = covered[12] = 0
    return _NOT_CLOTHES * jnp.asarray(covered) * bare


def carried_on(state: State, view: View, n: Numbers, shape: Shape) -> Float[Array, "4 particle 3 3"]:
    """Where the particles are expected: damped constant velocity, every second one by the optical flow."""
    p = state.particles
    by_velocity = p + n.velocity * (p - state.previous)
    if not shape.flow:
        return by_velocity
    at = project(view, vectors(p))
    flow, inside = read(view.flow, at, COARSE)
    u, v = (jnp.where(inside, flow[..., k], 0.0) / view.focal[k] * at.z for k in range(2))
    by_flow = p + turned(view.turn.T, vector(u, v, 0.0)).stacked()
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
        weight = given.share * jnp.clip(others - _EXPLAINED, 0, 0.2) * jnp.where(far < 1.15, far**2, 0.0)
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
def spread_and_drawn(
    key: Array, p: Array, origin: Array, spread: Array, space: LimbSpace, context: LimbContext, view: View, n: Numbers,
    shape: Shape,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Spreads, weighs and draws the particles anew, in each layer finer: particles, where they came from, their
    weighted mean and standard deviation [limb, point]."""
    count, particles = shape.layers, shape.particles
    keys = jax.random.split(key, 3)
    # all at once: a draw costs as much for few numbers as for many
    normal = jax.random.normal(keys[0], (count, 4, 4, 3, particles))
    pick = jax.random.uniform(keys[1], (count, 4, particles))
    offset = jax.random.uniform(keys[2], (count, 4))
    scales = jnp.asarray([0.5**k for k in range(count)], jnp.float32)
    powers = jnp.asarray([(k + 1) / count for k in range(count)], jnp.float32)
    camera = -view.shift @ view.turn

    # 8 parameters: model, state and measurements of a limb, traced each
    def limb_layer(noise, p, origin, spread, space, context, scale, power):
        normal, pick, offset = noise
        space = jax.tree.map(lambda a: a[..., None], space)
        points = []
        for i in range(3):
            own = Vector(p[i])
            motion, inside = read(view.motion, project(view, own), COARSE)
            motion = jnp.where(inside, motion.astype(jnp.float32) / 255, 0.0)
            sigma = n.base_noise + n.spread_noise * jnp.minimum(spread[i], 0.2) + n.motion_noise * motion
            plain = Vector(normal[:3, i]) * sigma
            deep = (own - Vector(camera)).unit() * (n.depth_noise[i] * normal[3, i])
            points.append(own + deep.where(pick < n.depth_share, plain) * scale)
        moved = project_limb((points[0], points[1], points[2]), jnp.ones((3, 1)), space, _PROJECTIONS)

        def drawn_again(points: Limb) -> tuple[Array, ...]:
            logs = log_weight(limb_score(points, context, view, n.weighing), n.weighing)
            w = jnp.exp(power * (logs - jnp.max(logs)))
            w = w / jnp.sum(w)
            p = jnp.stack([v.v for v in points])  # [point, axis, particle]
            mean = p @ w
            deviation = jnp.sqrt((jnp.sum((p - mean[..., None]) ** 2, 1) @ w) + 1e-9)
            again = systematic(offset, w)
            return p[..., again], origin[..., again], mean, deviation

        return kept(view.focal[0] > 0, drawn_again, moved)

    def layer(carry, given):
        noise, scale, power = given
        p, origin, _, spread = carry
        return jax.vmap(limb_layer, (0, 0, 0, 0, -1, 0, None, None))(
            noise, p, origin, spread, space, context, scale, power
        ), None

    last = lambda a: jnp.moveaxis(a, 1, -1)  # noqa: E731
    first = last(p), last(origin), jnp.zeros((4, 3, 3)), spread
    p, origin, mean, deviation = lax.scan(layer, first, ((normal, pick, offset), scales, powers))[0]
    return jnp.moveaxis(p, -1, 1), jnp.moveaxis(origin, -1, 1), mean, deviation


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
    q = vectors(points)
    distance = jnp.abs(surface_distance(body, x, q)) + (0.0 if bare is None else clothed(bare))
    best = kept(body.stature > 0, partial(jnp.argmin, axis=0), lax.stop_gradient(distance))
    near = nearest_places(body, x, q, best)
    d = near.distance
    use = share * (jnp.abs(d) < _REACH) / (1 + (d / 0.08) ** 2)
    held = near.carriers[:, None] == np.arange(16)[:, None]  # [carrier, body point, point]
    full = sum(jnp.where(at, w, 0.0) for at, w in zip(held, near.weights * use))
    pull = full @ (near.away * d).stacked()
    norm = jnp.abs(full).sum(1)
    return x + _PULL * pull / (norm + _HOLD)[:, None]


# 7 parameters: model, state and measurements, traced each
def _seen(
    body: FlexibleBody, x: Float[Array, "16 3"], spread: Array, masses: Array, given: Inputs, context: LimbContext,
    n: Numbers,
) -> Seen:  # fmt: skip
    one, two, three = (vectors(x[LIMBS[:, k], None]) for k in range(3))
    limb = jax.vmap(limb_score, (1, 0, None, None))
    score = jax.tree.map(lambda a: a[:, 0], limb((one, two, three), context, given.view, n.weighing))
    d = jnp.abs(surface_distance(body, x, vectors(given.points)))
    best, nearest = jnp.argmin(d, 0), jnp.min(d, 0)
    near = given.share * (nearest < _EXPLAINED)
    total = jnp.maximum(jnp.sum(given.share), 1e-6)
    residual = jnp.sqrt(jnp.sum(near * nearest**2) / jnp.maximum(jnp.sum(near), 1e-6))
    mine = jax.nn.one_hot(best, PARTS) * given.share[:, None]
    support = mine.sum(0)
    off = jnp.sqrt((mine * nearest[:, None] ** 2).sum(0) / jnp.maximum(support, 1e-6))
    return Seen(x, spread, masses, score, jnp.sum(near) / total, residual, support, off)
