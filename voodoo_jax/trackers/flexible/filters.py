"""One frame of the flexible tracker: the head moves the body, four particle filters and the springs follow (Hecht et
al. 2009, sec. III), then measured points pull the body's surface onto them. Compiled.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int
from scipy.special import ndtri

from voodoo_jax.compile.executable import program
from voodoo_jax.trackers.flexible.cylinders import PARTS, nearest_places, surface_distance
from voodoo_jax.trackers.flexible.flexible_body import HEAD, IS_ARM, LIMBS, NECK, FlexibleBody
from voodoo_jax.trackers.flexible.image_features import COARSE
from voodoo_jax.trackers.flexible.physics import (
    Limb,
    LimbSpace,
    frames,
    inverse_masses,
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
    learn,
    limb_score,
    log_weight,
    occlusion,
    project,
    read,
    sided,
    systematic,
    worthwhile,
)
from voodoo_jax.trackers.flexible.state import Inputs, Numbers, Seen, Shape, State
from voodoo_jax.trackers.flexible.vectors import Vector, kept, least, vectors
from voodoo_jax.trackers.shared.confidence import EXPLAINED

_SWEEPS = 3  # over a particle's constraints, and over springs after each pull; more change little; by hand
# share of the velocity that the dangling body loses per frame; measured: 0.4 and 0.9 give the same, 1 is 1.0 cm worse
_DAMPING = 0.6
# refinement: weight of a body point's own position, in measured points, and share of the pull that it follows: above
# one, since springs undo a part of it. Measured: 2.7 and 6 give the same, 1.8 is as good, 0.8 is 0.3 to 1.3 cm worse
_HOLD, _PULL = 4.0, 1.2
# in the refinement the head moves less than other points, since its position is measured. Measured: 2 and 4.5 give the
# same, 1 is 0.2 cm worse
_REFINED_MASSES = np.where(np.arange(16) == HEAD, np.float32(3), np.float32(1))
_BARE_WEIGHT = 3.0  # additional weight of skin points for arms, by hand: a hand has few points
_REACH = 0.25  # metres: farther points do not pull; measured: 0.17 and 0.38 give the same, no limit is 0.3 cm worse
_NOT_CLOTHES = 0.3  # metres: any gives the same above the distance at which points are capped (Weighing.cap, 0.2 m)
_FACE = 0.11  # share of the stature: skin closer to the head point may belong to the face, measured on rendered people
# share of a frame's points that weigh a limb's particles: a leg has a fifth of a person's surface, by hand
_WORTHWHILE = 1 / 3
# hypotheses: share of a body's turning rate that persists, most radians per frame that count, and penalty on the
# logarithm of a weight where a face is visible but the body faces away: chosen on half of experiments/stereo
_GOES_ON, _MOST, _FRONT = 0.7, 0.7, 3.0


def start(key: Array, body: FlexibleBody, x: Float[Array, "16 3"], shape: Shape) -> State:
    """The state before the first frame, with particles spread around a pose."""
    noise = 0.03 * jax.random.normal(key, (4, shape.particles, 3, 3))
    p = x[LIMBS][:, None] + noise
    # with the types of a frame's state: otherwise the second chunk would compile another program
    full = lambda shape, value: jnp.full(shape, value, x.dtype)  # noqa: E731
    return State(x, x, p, p, full((4, 3), 0.05), full((4, 2, 10, 3), 0.5), full((4, 2, 10), 0.0), full((), 0.0))


@program
def track_chunk(
    body: FlexibleBody, state: State, inputs: Inputs, key: Array, numbers: Numbers, shape: Shape
) -> tuple[State, Seen]:
    """Runs the filters over frames in order; leading axis of `inputs` and of the results: frame."""

    def one(state, given):
        run = lambda: hypotheses(body, state, given, jax.random.fold_in(key, given.index), numbers, shape)  # noqa: E731
        return lax.cond(given.valid, run, lambda: (state, _blank_results(len(state.x), state.x.dtype)))

    return lax.scan(one, state, inputs)


def _blank_results(count: int, dtype: Any) -> Seen:
    """The result of a padding frame; written out, since jax.eval_shape of `frame` would trace it twice."""
    none = lambda *shape: jnp.zeros((count, *shape), dtype)  # noqa: E731
    score = Score(*[none(4)] * len(Score._fields))
    return Seen(
        none(16, 3), none(4, 3), none(16), score, none(), none(), none(PARTS), none(PARTS), none(), none(16),
        jnp.zeros(count, jnp.int32), none(),
    )  # fmt: skip


def hypotheses(
    body: FlexibleBody, states: State, given: Inputs, key: Array, n: Numbers, shape: Shape
) -> tuple[State, Seen]:
    """One frame of several hypotheses of the body, each turned differently and resampled by its fit, like particles
    that each have their own limb filters. Leading axis of `states` and of the results: hypothesis.

    In the paper only limbs have filters, so it loses a trunk that turns by 30 degrees between frames. The last
    hypothesis restarts from a guess of this frame alone, if there is one, and so recovers a body that all have lost.
    """
    count, keys = shape.hypotheses, jax.random.split(key, 4)
    apart = jax.random.permutation(keys[0], jnp.asarray(ndtri((np.arange(count) + 0.5) / count), jnp.float32))
    angle = _GOES_ON * states.rate + n.turning[0] * apart
    lean = n.turning[1] * jax.random.normal(keys[1], (count, 3))
    ahead, anew = states, jnp.zeros(count, states.x.dtype)
    begin = lambda old, new: jnp.where(anew.reshape(-1, *[1] * (old.ndim - 1)) > 0, new, old)  # noqa: E731
    if count > 1:  # a single one, as in the paper, neither turns nor restarts
        ahead = jax.vmap(turned_body)(states, given.dt * (angle[:, None] * given.up + lean))
        last = np.arange(count) == count - 1
        anew = jnp.where(last & (given.guess.error[HEAD] < jnp.inf), jnp.ones((), states.x.dtype), 0)
        fresh = start(jax.random.fold_in(keys[1], count), body, given.guess.x, shape)
        ahead = jax.tree.map(begin, ahead, fresh._replace(colours=states.colours, learnt=states.learnt))
    run = lambda state, key: frame(body, state, given, key, n, shape)  # noqa: E731
    after, seen = jax.vmap(run)(ahead, jax.random.split(keys[2], count))
    step = jax.vmap(lambda x, before: heading(x, given.up) - heading(before, given.up))(
        after.x, begin(states.x, after.x)
    )
    rate = jnp.clip((step + jnp.pi) % (2 * jnp.pi) - jnp.pi, -_MOST, _MOST) / given.dt
    weight = jax.nn.softmax(n.sharpness * seen.fit)
    mean = jnp.einsum("h,hpa->pa", weight, after.x)
    wide = jnp.sqrt(jnp.einsum("h,hp->p", weight, jnp.sum((after.x - mean) ** 2, -1)))
    pick = systematic(jax.random.uniform(keys[3]), weight)
    goes_on = jax.tree.map(lambda a: a[pick], after._replace(rate=rate))
    return goes_on, seen._replace(wide=jnp.broadcast_to(wide, seen.wide.shape), follows=pick, anew=anew)


def heading(x: Float[Array, "16 3"], up: Float[Array, "3"]) -> Float[Array, ""]:
    """Heading of the line from the right shoulder and hip to the left ones, about the vertical, radians."""
    left = x[2] - x[5] + x[10] - x[13]
    east = jnp.eye(3)[jnp.argmin(jnp.abs(up))]
    east = unit(east - jnp.sum(east * up) * up)
    return jnp.arctan2(jnp.sum(left * jnp.cross(up, east)), jnp.sum(left * east))


def turned_body(state: State, by: Float[Array, "3"]) -> State:
    """The state turned about the middle of the trunk by a rotation vector, radians."""
    size = jnp.sqrt(jnp.sum(by**2) + 1e-12)
    cross = jnp.cross(by / size, jnp.eye(3), axisb=0, axisc=0)
    turn = jnp.eye(3) + jnp.sin(size) * cross + (1 - jnp.cos(size)) * (cross @ cross)
    middle = state.x[LIMBS[:, 0]].mean(0)
    x, before, p, previous = (
        middle + (p - middle) @ turn.T for p in (state.x, state.before, state.particles, state.previous)
    )
    return state._replace(x=x, before=before, particles=p, previous=previous)


def frame(body: FlexibleBody, state: State, given: Inputs, key: Array, n: Numbers, shape: Shape) -> tuple[State, Seen]:
    """One frame: prediction, filters, springs, refinement."""
    view, args = given.view, (body, state, given, key, n)
    filters = jax.jit(_run_filters, static_argnums=6)  # traced once, for its shapes and for its use
    x, blank = head_moved(body, state, given, n), jax.eval_shape(filters, *args, state.x, shape)
    none = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), blank)

    def settle(phase, carry):
        """Torso and head first: otherwise points that a bow leaves unexplained attract limbs."""
        x, found = carry
        found = lax.cond(phase > 0, lambda: filters(*args, x, shape), lambda: found._replace(x=x, masses=body.masses))
        rounds = jnp.where(phase > 0, shape.refine, shape.refine // 2)
        return settled(body, found.x, found.masses, rounds, given, n, shape), found

    x, found = lax.fori_loop(0, 2, settle, (x, none))  # a loop, so that both phases are compiled once
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
    after = State(x, state.x, p + shift, origin + shift, spread, colours, learnt, state.rate)
    return after, _summarise(body, x, spread, masses, given, near, n)


class Filtered(NamedTuple):
    """Results of the limb filters in a frame."""

    x: Float[Array, "16 3"]  # the body with the particles' means, metres
    masses: Float[Array, " 16"]
    particles: Float[Array, "4 particle 3 3"]
    origin: Float[Array, "4 particle 3 3"]  # previous position of each particle
    mean: Float[Array, "4 3 3"]
    spread: Float[Array, "4 3"]  # standard deviation, metres
    near: LimbContext  # with the points that weigh the limbs
    hidden: Float[Array, "4 row column"]  # see scores.occlusion
    more: tuple[Float[Array, "4 row column"], ...]  # the same for further cameras


# 7 parameters: model, state and measurements, traced each
def _run_filters(
    body: FlexibleBody, state: State, given: Inputs, key: Array, n: Numbers, x: Float[Array, "16 3"], shape: Shape
) -> Filtered:
    """Runs the filters of all limbs with the trunk fixed."""
    view = given.view
    space, context = limb_spaces(body, vectors(x), n.legs_apart, n.floor), _build_context(body, state, x, given, shape)
    ahead = carried_on(state, n)
    near = jax.vmap(lambda one: worthwhile(one, round(_WORTHWHILE * len(given.points)), n.weighing))(context)
    p, origin, mean, spread = spread_and_drawn(key, ahead, state.particles, state.spread, space, near, view, n, shape)
    masses = body.masses.at[LIMBS.ravel()].set((n.masses[0] + n.masses[1] * jnp.exp(-n.masses[2] * spread)).ravel())
    x = x.at[LIMBS.ravel()].set(mean.reshape(12, 3))
    return Filtered(x, masses, p, origin, mean, spread, near, context.hidden, context.more)


def head_moved(body: FlexibleBody, state: State, given: Inputs, n: Numbers) -> Float[Array, "16 3"]:
    """The body one Verlet step later, its head at the measured position and the rest following; not yet relaxed."""
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
    """Relaxes springs and limits, then refines `rounds` times; one loop, so that both are compiled once."""

    def one(number, x):
        pulls = number > 0
        move = lambda: pulled(body, x, given.points, given.share, given.bare)  # noqa: E731
        x = lax.cond(pulls, move, lambda: x) if shape.refine else x
        sweeps = jnp.where(pulls, _SWEEPS, shape.relaxations)
        return relax(body, x, jnp.where(pulls, _REFINED_MASSES, masses), sweeps, n.legs_apart, True, n.floor)

    return lax.fori_loop(0, 1 + rounds, one, x)


def _build_context(
    body: FlexibleBody, state: State, x: Float[Array, "16 3"], given: Inputs, shape: Shape
) -> LimbContext:
    hidden, (guess, error, _) = occlusion(body, x, given.view), sided(given.guess, x)
    used = len(given.points) if shape.points else 0
    if shape.points:
        d = jnp.abs(surface_distance(body, x, vectors(given.points))) + clothed(body, given.bare)
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
        guess[LIMBS], error[LIMBS], tuple(occlusion(body, x, view) for view in given.view.more),
    )  # fmt: skip


def clothed(body: FlexibleBody, bare: Float[Array, " point"]) -> Float[Array, "part point"]:
    """Distance added between skin points and clothed parts, metres."""
    return _NOT_CLOTHES * body.covered[:, None] * bare


def carried_on(state: State, n: Numbers) -> Float[Array, "4 particle 3 3"]:
    """Predicted particles: damped constant velocity."""
    return state.particles + n.velocity * (state.particles - state.previous)


# 9 parameters: model, state and measurements of a limb, traced each
def spread_and_drawn(
    key: Array, p: Array, origin: Array, spread: Array, space: LimbSpace, context: LimbContext, view: View, n: Numbers,
    shape: Shape,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Spreads, weighs and resamples the particles, in each layer finer; returns particles, their previous positions,
    weighted mean and standard deviation [limb, point]."""
    count, particles = shape.layers, shape.particles
    keys = jax.random.split(key, 3)
    # all random numbers at once: a draw takes as long for few numbers as for many
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
        moved = project_limb((points[0], points[1], points[2]), jnp.ones((3, 1)), space, _SWEEPS)

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
    """Repeats: points pull the nearest axes and patches until they lie on the surface, then springs and limits are
    relaxed. Differentiable, with the nearest part of each point held fixed."""

    def one(_, x):
        moved = pulled(body, x, points, share, bare)
        return relax(body, moved, jnp.asarray(_REFINED_MASSES), _SWEEPS, legs_apart, True, floor)

    return lax.fori_loop(0, rounds, one, x) if rounds else x


def pulled(
    body: FlexibleBody, x: Float[Array, "16 3"], points: Float[Array, "point 3"], share: Float[Array, "point"],
    bare: Float[Array, "point"] | None = None,
) -> Float[Array, "16 3"]:  # fmt: skip
    """The body's points after measured points have pulled the nearest axes and patches."""
    q = vectors(points)
    distance = jnp.abs(surface_distance(body, x, q)) + (0.0 if bare is None else clothed(body, bare))
    best = least(lax.stop_gradient(distance))
    near = nearest_places(body, x, q, best)
    d = near.distance
    use = share * (jnp.abs(d) < _REACH) / (1 + (d / 0.08) ** 2)
    held = near.carriers[:, None] == np.arange(16)[:, None]  # [carrier, body point, point]
    full = sum(jnp.where(at, w, 0.0) for at, w in zip(held, near.weights * use))
    pull = full @ (near.away * d).stacked()
    norm = jnp.abs(full).sum(1)
    return x + _PULL * pull / (norm + _HOLD)[:, None]


# 7 parameters: model, state and measurements, traced each
def _summarise(
    body: FlexibleBody, x: Float[Array, "16 3"], spread: Array, masses: Array, given: Inputs, context: LimbContext,
    n: Numbers,
) -> Seen:  # fmt: skip
    one, two, three = (vectors(x[LIMBS[:, k], None]) for k in range(3))
    limb = jax.vmap(limb_score, (1, 0, None, None))
    score = jax.tree.map(lambda a: a[:, 0], limb((one, two, three), context, given.view, n.weighing))
    d = jnp.abs(surface_distance(body, x, vectors(given.points)))
    best, nearest = least(d), jnp.min(d, 0)
    near = given.share * (nearest < EXPLAINED)
    total = jnp.maximum(jnp.sum(given.share), 1e-6)
    residual = jnp.sqrt(jnp.sum(near * nearest**2) / jnp.maximum(jnp.sum(near), 1e-6))
    mine = jnp.where(best == np.arange(PARTS)[:, None], given.share, 0.0)
    support = mine.sum(1)
    off = jnp.sqrt((mine * nearest**2).sum(1) / jnp.maximum(support, 1e-6))
    cap, bare = n.weighing.cap, jnp.min(d + clothed(body, given.bare), 0)
    far = jnp.sum(given.share * (jnp.minimum(bare, cap) / cap) ** 2) / total
    image = jnp.sum(log_weight(score._replace(points=jnp.zeros(4)), n.weighing))
    level = lambda v: unit(v - jnp.sum(v * given.up) * given.up)  # noqa: E731
    toward = level(-given.view.shift @ given.view.turn - x[NECK])
    facing = jnp.sum(level(frames(x).upper[0]) * toward)
    fit = image - len(LIMBS) * n.weighing.points * far + _FRONT * given.head_seen * jnp.minimum(facing, 0.0)
    fit, explained = fit + sided(given.guess, x)[2], jnp.sum(near) / total
    return Seen(
        x, spread, masses, score, explained, residual, support, off, fit, jnp.zeros(16), jnp.int32(0), jnp.zeros(())
    )
