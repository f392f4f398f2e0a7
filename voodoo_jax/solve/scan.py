"""From frame to frame: prediction, one solve per frame, status; a recording is one scan over its frames."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.compile.executable import program
from voodoo_jax.config.options import FeatureSettings, SolveSettings, TrackSettings
from voodoo_jax.geometry.rigid import (
    AnyArray,
    Poses,
    compose,
    inverse,
    quat_conjugate,
    quat_exp,
    quat_log,
    quat_multiply,
    quat_normalize,
)
from voodoo_jax.kernels.correspondences import MatchOptions, Points, Sampling
from voodoo_jax.kernels.gauss_newton import tree_covariance, twist_covariance
from voodoo_jax.kernels.joint_limits import PlausibleOptions
from voodoo_jax.kernels.landmarks import FeatureOptions, Features, feature_sums
from voodoo_jax.model.body import Body, tree_levels
from voodoo_jax.solve.frame import solve_and_measure
from voodoo_jax.solve.pulls import IcpOptions, Problem

T = TypeVar("T", bound=eqx.Module)
FAR = 1.5  # times prior_interval: after longer intervals a prediction may be far off
FEW = 60  # points of which the mean tells where the body is
SWING = 0.05  # seconds beyond prior_interval in which limbs' own motion comes to rest: they swing to and fro
FEATURE_SHARE = 0.005  # of the features' squared distance in cost_of


class TrackOptions(eqx.Module):
    """Parameters of tracking over time; numbers are traced."""

    icp: IcpOptions
    damping: Float[Array, ""]  # share of the velocity that goes on
    prior_interval: Float[Array, ""]  # seconds; over longer intervals the pull to the prediction weakens
    still_speed: Float[Array, ""]  # metres per second; limbs that are slower are held where they are
    hidden_rest: Float[Array, ""]  # seconds in which a hidden limb goes most of the way back to its rest pose
    hidden_weight: Float[Array, ""]  # measured weight at which a limb counts as half hidden
    # whether the recording has features alone: then they tell which limbs are seen. Static: with depth there is nothing
    # to compile for it
    by_features: bool = eqx.field(static=True, default=False)


class State(NamedTuple):
    """What one frame passes to the next."""

    poses: Poses
    spin: Float[AnyArray, "limb 3"]  # radians per second, in the limb's frame
    velocity: Float[AnyArray, "limb 3"]  # metres per second, world frame
    seen: Float[AnyArray, " limb"]  # share of each limb that was not hidden, 0..1
    cloud: Float[AnyArray, "4"]  # mean of the points, metres, and how many there were


class Step(NamedTuple):
    """Results of one frame."""

    poses: Poses
    residual: Float[Array, ""]  # root of the weighted mean squared distance, metres
    explained: Float[Array, ""]  # share of the points with a pair close by, 0..1
    feature_residual: Float[Array, ""]  # root of the weighted mean squared distance of the features, metres; 0: none
    limb_weight: Float[Array, " limb"]
    steps: Int[Array, ""]
    points: Int[Array, ""]
    # of each limb's twist, for unit variance per unit of weight (kernels.gauss_newton): track_chunk fills it in
    covariance: Float[Array, "limb 6 6"] | None = None


Visit = Callable[..., tuple[State, Step]]  # as track_visits


def cost_of(step: Step) -> Float[AnyArray, "*frame"]:
    """Cost of each frame, square metres: how badly its measurements are explained. Trials and passes are compared by
    it. Features count little: a wrong detection weighs more than the difference of front and back. They break ties."""
    return step.residual**2 + 0.02 * (1 - step.explained) + FEATURE_SHARE * step.feature_residual**2


def options_from(solve: SolveSettings, track: TrackSettings, features: FeatureSettings | None = None) -> TrackOptions:
    """Traced options from settings."""
    whole = lambda v: jax.device_put(np.asarray(v, np.int32))  # noqa: E731
    every = solve.sampling == 1 and solve.sampling_max >= 8192
    sampling = Sampling(_number(solve.sampling), whole(solve.sampling_min), whole(solve.sampling_max))
    plausible = PlausibleOptions(
        _number(solve.limits) if solve.limits > 0 else None,
        _number(solve.collisions) if solve.collisions > 0 else None,
        _number(solve.collision_margin),
    )
    matching = _of(MatchOptions, solve, sampling=None if every else sampling)
    by_features = _of(FeatureOptions, features or FeatureSettings())
    steps = whole(solve.max_steps)
    icp = _of(IcpOptions, solve, match=matching, features=by_features, max_steps=steps, plausible=plausible)
    rest = _number(track.hidden_rest if track.hidden_rest > 0 else np.inf)
    return _of(TrackOptions, track, icp=icp, hidden_rest=rest)


def _number(value: float) -> Array:
    return jax.device_put(np.asarray(value, np.float32))


def _of(kind: type[T], settings: SolveSettings | TrackSettings | FeatureSettings, **own: Any) -> T:
    """Options with the values of settings of the same names, numbers traced, beside their own."""
    for field in fields(kind):
        if field.name not in own and hasattr(settings, field.name):
            value = getattr(settings, field.name)
            own[field.name] = value if field.metadata.get("static") else _number(value)
    return kind(**own)


def at_rest(poses: Poses) -> State:
    """A state without motion."""
    # of NumPy's arrays where the poses are: see geometry.rigid.AnyArray
    array = np if isinstance(poses.translation, np.ndarray) else jnp
    zero = array.zeros_like(poses.translation)
    nowhere = array.zeros((*poses.translation.shape[:-2], 4), poses.translation.dtype)
    return State(poses, zero, zero, array.ones_like(poses.translation[..., 0]), nowhere)


def predict(
    body: Body, options: TrackOptions, state: State, seconds: Float[Array, ""], cloud: Float[Array, "4"] | None = None
) -> Poses:
    """Poses after `seconds`: a share of the velocity continues; hidden limbs move with their parents, and back to rest.
    Over long intervals limbs do not swing on, and the body moves with the mean of its points (`cloud`: metres, and
    their number)."""
    on = options.damping * seconds
    over = jnp.maximum(jnp.abs(seconds) - options.prior_interval, 0.0)
    swing = on - options.damping * jnp.sign(seconds) * (over - SWING * (1.0 - jnp.exp(-over / SWING)))
    rotation = quat_normalize(quat_multiply(state.poses.rotation, quat_exp(swing * state.spin)))
    whole = state.velocity[:1]
    gone = on * whole
    if cloud is not None:
        known = (cloud[3] >= FEW) & (state.cloud[3] >= FEW)
        trusted = jnp.where(known, jnp.clip(over / options.prior_interval - 1.0, 0.0, 1.0), 0.0)
        gone = gone + trusted * ((cloud - state.cloud)[:3] - gone)
    translation = state.poses.translation + gone + swing * (state.velocity - whole)
    return _with_hidden(body, options, state, Poses(rotation, translation), seconds)


def _with_hidden(body: Body, options: TrackOptions, state: State, moved: Poses, seconds: Float[Array, ""]) -> Poses:
    """The poses with hidden limbs moved by their parents, from the trunk outwards."""
    t = body.topology
    kept = jnp.exp(-jnp.abs(seconds) / options.hidden_rest)
    joint = np.argsort(t.children)  # of each limb but the root
    parents, children = np.array(t.parents, int)[joint], np.array(t.children, int)[joint]
    first, second = body.parent_anchor[joint], body.child_anchor[joint]
    # of each joint: the child's turn against the parent, none in the rest pose
    held = compose(state.poses[parents], first), compose(state.poses[children], second)
    turn = quat_exp(kept * quat_log(compose(inverse(held[0]), held[1]).rotation))
    hung = compose(compose(first, Poses(turn, jnp.zeros_like(first.translation))), inverse(second))
    hidden, own = (1.0 - state.seen[1:])[:, None], moved[1:]

    def outwards(_, poses):
        taken = compose(poses[parents], hung)
        bent = quat_exp(hidden * quat_log(quat_multiply(quat_conjugate(own.rotation), taken.rotation)))
        rotation = quat_normalize(quat_multiply(own.rotation, bent))
        translation = own.translation + hidden * (taken.translation - own.translation)
        return jax.tree.map(lambda root, rest: jnp.concatenate([root[:1], rest]), moved, Poses(rotation, translation))

    # all limbs at once: those farther out come right one turn later
    return jax.lax.fori_loop(0, len(tree_levels(t)), outwards, moved)


def _still(body: Body, state: State, speed: Float[Array, ""]) -> Float[Array, " limb"]:
    """How still each limb stands: 1 at rest, 1/4 at `speed`, metres per second."""
    x, y, z = state.spin.T
    a, b, *_, length = body.sizes.T
    square = jnp.sum(state.velocity**2, -1) + length**2 * (x * x + y * y) + (a * a + b * b) * z * z
    return 1.0 / (1.0 + square / speed**2) ** 2


def _cloud(points: Points) -> Float[Array, "4"]:
    """Mean of a frame's points, metres, and their number."""
    there = (points.weight > 0).astype(points.xyz.dtype)
    number = jnp.sum(there)
    return jnp.append(there @ points.xyz / jnp.maximum(number, 1), number)


def track_frame(
    body: Body,
    options: TrackOptions,
    state: State,
    points: Points,
    seconds: Float[Array, ""],
    features: Features | None = None,
) -> tuple[State, Step, Float[Array, "limb6 limb6"]]:
    """Tracks one frame: predicts, solves, measures the fit. Also returns the normal matrix of the limbs' twists
    (kernels.gauss_newton): inverting those of many frames together is faster."""
    problem, patient = frame_problem(body, options, state, points, seconds, features)
    poses, seen, normals = solve_and_measure(problem, patient=patient)
    count = jnp.sum(points.weight > 0)
    explained = seen.close / jnp.maximum(count, 1)
    step = Step(poses, seen.residual, explained, seen.feature_residual, seen.limb_weight, seen.steps, count)
    return state_after(problem, options, state, poses, seen.limb_weight, seconds, seen.good), step, normals


# 6 parameters: the frame's measurements, and what was before
def frame_problem(
    body: Body,
    options: TrackOptions,
    state: State,
    points: Points,
    seconds: Float[Array, ""],
    features: Features | None = None,
) -> tuple[Problem, Bool[Array, ""]]:
    """The problem of a frame, predicted from the state before it; and whether the prediction may be far off."""
    predicted = predict(body, options, state, seconds, _cloud(points))
    # a prediction over a longer interval is worth less: its error grows with the square of the time
    late = jnp.maximum(seconds / options.prior_interval, 1.0)
    weaker = jnp.minimum(late**2, 16.0)
    steady = options.icp.steady * _still(body, state, options.still_speed)
    icp = eqx.tree_at(lambda o: (o.prior, o.steady), options.icp, (options.icp.prior / weaker, steady / weaker))
    return Problem.build(body, points, predicted, icp, features), late > FAR


# 7 parameters: all that a state follows from
def state_after(
    problem: Problem,
    options: TrackOptions,
    before: State,
    poses: Poses,
    limb_weight: Float[Array, " limb"],
    seconds: Float[Array, ""],
    good: Bool[Array, ""],
) -> State:
    """The state for the next frame. `good`: the poses were measured, not predicted."""
    points, features = problem.points, problem.features
    cloud = _cloud(points)
    safe = jnp.where(seconds > 0, seconds, 1.0)
    turn = compose(inverse(before.poses), poses).rotation
    moving = (seconds > 0) & good
    spin = jnp.where(moving, quat_log(turn) / safe, 0.0)
    velocity = jnp.where(moving, (poses.translation - before.poses.translation) / safe, 0.0)
    # by how many points there are, however noisy
    measured, weight = cloud[3] > 0, limb_weight * (1.0 if points.doubt is None else points.doubt)
    if options.by_features and features is not None:
        weight = weight + feature_sums(problem.body, poses, features, options.icp.features).weight
        measured = measured | jnp.any(features.weight > 0)
    share = weight**2
    shown = share / jnp.maximum(share + options.hidden_weight**2, 1e-6)
    return State(poses, spin, velocity, jnp.where(measured, shown, before.seen), cloud)


def _nothing(state: State) -> tuple[State, Step, Float[Array, "limb6 limb6"]]:
    """What track_frame returns for no frame."""
    zero, weight = jnp.zeros_like(state.seen[0]), jnp.zeros_like(state.seen)
    poses = jax.tree.map(jnp.zeros_like, state.poses)
    step = Step(poses, zero, zero, zero, weight, jnp.array(0, jnp.int32), jnp.array(0))
    return state, step, jnp.eye(6 * len(weight), dtype=weight.dtype)


class Visits(NamedTuple):
    """The frames to track, and the track of each: a trial start, or the only one."""

    frame: Int[AnyArray, " visit"]
    track: Int[AnyArray, " visit"]  # NOBODY: nothing is done
    sure: Bool[AnyArray, ""] = np.array(True)  # whether covariances are asked for: they take as long as ten visits


NOBODY = -1


# 7 parameters: those of the one program, traced each
@program
def track_visits(
    body: Body,
    options: TrackOptions,
    states: State,
    points: Points,
    seconds: Float[AnyArray, " frame"],
    visits: Visits,
    features: Features | None = None,
) -> tuple[State, Step]:
    """Tracks frames one after the other in one scan. Trials of starts and whole recordings are one program: compiling
    the tracker takes longer than tracking a log.

    **Arguments:** `states` with a leading track axis; `points` and `features` with a leading frame axis; `seconds`
    since the frame before.

    **Returns:** the states of all tracks, and one Step per visit (leading axis).
    """

    def one(states, visit):
        frame, track = visit
        inputs = jax.tree.map(lambda x: x[frame], (points, seconds, features))
        state = jax.tree.map(lambda x: x[track], states)
        tracked = lambda: track_frame(body, options, state, *inputs)  # noqa: E731
        state, *out = jax.lax.cond(track != NOBODY, tracked, lambda: _nothing(state))
        states = jax.tree.map(lambda x, new: x.at[track].set(new), states, state)
        return states, out

    states, (steps, normals) = jax.lax.scan(one, states, (visits.frame, visits.track))
    return states, steps._replace(covariance=covariances_of(body, options, normals, visits.sure))


def covariances_of(
    body: Body, options: TrackOptions, normals: Float[Array, "visit limb6 limb6"], sure: Bool[AnyArray, ""]
) -> Float[Array, "visit limb 6 6"]:
    """Covariance of each limb's twist from the normal matrices of many visits, see kernels.gauss_newton; zero if not
    `sure`."""
    count, limbs = normals.shape[0], normals.shape[1] // 6

    def found():
        if options.icp.plausible.collisions is None:
            return jax.vmap(lambda full: tree_covariance(body.topology, full))(normals)
        return jax.lax.map(twist_covariance, normals)  # any limb may push any other one

    return jax.lax.cond(sure, found, lambda: jnp.zeros((count, limbs, 6, 6), normals.dtype))


# 7 parameters: those of the one program, traced each
def track_chunk(
    body: Body,
    options: TrackOptions,
    state: State,
    points: Points,
    seconds: Float[AnyArray, " frame"],
    valid: Bool[AnyArray, " frame"],
    features: Features | None = None,
) -> tuple[State, Step]:
    """Tracks consecutive frames, see track_visits; padded ones (`valid` false) leave the state as it is.

    **Returns:** the state after the last valid frame, and one Step per frame (leading frame axis).
    """
    array = np if isinstance(valid, np.ndarray) else jnp
    visits = Visits(array.arange(len(valid)), array.where(valid, 0, NOBODY))
    states = jax.tree.map(lambda x: x[None], state)
    states, steps = track_visits(body, options, states, points, seconds, visits, features)
    return jax.tree.map(lambda x: x[0], states), steps
