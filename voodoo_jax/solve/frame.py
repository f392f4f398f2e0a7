"""One frame: the ICP step and its loop (Knoop 2006 sec. III-B, 2007 secs. 3.2 and 5.2).

A step is a pure function `(poses, problem) -> poses`: correspondences for all limbs, bands, prediction, one weighted
absolute orientation per limb, all limbs in one vmapped solve.
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.geometry.rigid import Poses, compose, quat_normalize
from voodoo_jax.kernels.bands import link_moments
from voodoo_jax.kernels.correspondences import sums
from voodoo_jax.kernels.eigen import align
from voodoo_jax.kernels.gauss_newton import as_motions, coupled_twists, stretched
from voodoo_jax.solve.pulls import (
    IcpOptions,
    Problem,
    Pulls,
    StepInfo,
    System,
    anything_measured,
    frame_normals,
    pulls_of,
    seen_at,
)

MOVED = 0.003  # metres: a step that moves no limb farther may be the last where it gains nothing
NEAR = 10.0  # times epsilon by which the quality measure may still change where the start was near
CLOSE = 0.1  # metres: a point nearer to its limb is explained


class FrameResult(NamedTuple):
    """Solution of one frame."""

    poses: Poses
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


def icp_step(poses: Poses, problem: Problem) -> tuple[Poses, StepInfo]:
    """One ICP step: new poses of all limbs, and the measurements on entry."""
    after, _, info = _step(Loop.begun(poses), problem)
    return after, info


def _step(state: "Loop", problem: Problem) -> tuple[Poses, Float[Array, "limb 6"], StepInfo]:
    """Poses after the next step of a loop, the step before extrapolation, and the measurements on entry."""
    poses = Poses(quat_normalize(state.poses.rotation), state.poses.translation)
    coupled = problem.options.solver == "coupled"
    pulls = pulls_of(seen_at(poses, problem, with_second=coupled), poses, problem)
    system = frame_normals(poses, pulls, problem.options.damping) if coupled else None
    return *_stepped(state, poses, pulls, system, problem.options), pulls.seen.info


def _stepped(
    state: "Loop", poses: Poses, pulls: Pulls, system: System | None, options: IcpOptions
) -> tuple[Poses, Float[Array, "limb 6"]]:
    """Poses after a step by these pulls, and the step before extrapolation. Extrapolates if the previous step had the
    same direction and the quality is no worse. `system` None: limb by limb."""
    if system is None:
        return _moved(poses, _limb_by_limb(poses, pulls)), state.asked
    asked = coupled_twists(*system)
    most = jnp.where(pulls.seen.info.quality <= state.quality, options.stretch, 1.0)
    return _moved(poses, as_motions(stretched(asked, state.asked, most))), asked


def _limb_by_limb(poses: Poses, pulls: Pulls) -> tuple[Float[Array, "limb 4"], Float[Array, "limb 3"]]:
    """Motions of all limbs, each in its own frame: one weighted absolute orientation per limb."""
    held = sum(link_moments(some, poses, pulls.strength) for some in pulls.links)
    features = 0.0 if pulls.seen.named is None else pulls.seen.named.moments
    solved = jax.vmap(align)(pulls.seen.measured + features + held + pulls.prior)
    return solved.rotation, solved.translation


def _moved(poses: Poses, motion: tuple[Float[Array, "limb 4"], Float[Array, "limb 3"]]) -> Poses:
    moved = compose(poses, Poses(*motion))
    return Poses(quat_normalize(moved.rotation), moved.translation)


class Loop(NamedTuple):
    """State of a frame's loop."""

    poses: Poses
    quality: Float[Array, ""]  # where the last step began, square metres
    asked: Float[Array, "limb 6"]  # by the last step: turns and shifts of limbs, see coupled_twists; zero: nothing yet
    moved: Float[Array, ""]  # by the limb that the last step moved farthest, square metres
    steps: Int[Array, ""]
    rest: Bool[Array, ""]  # another step would find nothing better: the poses are those to stay in

    @classmethod
    def begun(cls, start: Poses) -> "Loop":
        huge = jnp.array(jnp.inf, start.translation.dtype)
        asked = jnp.zeros((*start.translation.shape[:-1], 6), start.translation.dtype)
        return cls(start, huge, asked, huge, jnp.array(0, jnp.int32), jnp.array(False))

    def after(
        self, poses: Poses, asked: Float[Array, "limb 6"], quality: Float[Array, ""], rest: Bool[Array, ""]
    ) -> "Loop":
        """The state after one more step to `poses`, or the same if it is at rest."""
        moved = jnp.max(jnp.sum((poses.translation - self.poses.translation) ** 2, -1))
        poses = jax.tree.map(lambda old, new: jnp.where(rest, old, new), self.poses, poses)
        return Loop(poses, quality, asked, moved, self.steps + ~rest, rest)

    def at_rest(
        self, quality: Float[Array, ""], options: IcpOptions, patient: Bool[Array, ""] | bool
    ) -> Bool[Array, ""]:
        """Whether the loop ends at these poses, of this `quality`: see solve_frame."""
        fallen = self.quality - quality
        # pairs that nobody measured may make the measure rise
        if options.plausible.collisions is not None or options.solver != "coupled":
            return jnp.abs(fallen) < options.epsilon
        still = jnp.abs(fallen) < options.epsilon * jnp.where(patient, 1.0, NEAR)
        aimless = (fallen < 0) & (options.epsilon > 0) & (self.moved < MOVED**2) & jnp.logical_not(patient)
        return still | aimless


def solve_frame(
    start: Poses,
    problem: Problem,
    kind: Literal["lax", "checkpointed"] = "lax",
    capacity: int = 64,
    patient: Bool[Array, ""] | bool = True,
) -> FrameResult:
    """Repeats the step until the quality measure changes by less than epsilon (from a near start, not `patient`, by ten
    times that), or max_steps is reached (sec. 3.2).

    The coupled solver extrapolates successive steps in the same direction (see kernels.gauss_newton.stretched). From a
    near start it also stops when the measure rises and no limb moves much any more: points then change limbs back and
    forth, and more than twice the steps find nothing better. This does not apply if pairs that are no measurements may
    make it rise; with epsilon 0 all max_steps are taken.

    `kind`: "lax" is fastest, with forward-mode differentiation only; "checkpointed" also has the reverse mode: every
    step stores little more than its initial poses, and is computed again on the way back (docs/numerics.md#loops).
    `capacity` bounds its steps at compile time.
    """

    options = problem.options

    def unfinished(state):
        return ~state.rest & (state.steps < options.max_steps)

    def body(state):
        poses, asked, info = _step(state, problem)
        return state.after(poses, asked, info.quality, state.at_rest(info.quality, options, patient))

    state = Loop.begun(start)
    if kind == "lax":
        state = jax.lax.while_loop(unfinished, body, state)
    else:
        # around the branch, not in it: one step keeps no more than the state that it began with and the two results
        # that take most of its time and little memory: which limb each point belongs to, and the solve's factor
        keep = jax.checkpoint_policies.save_only_these_names("limb", "factor")
        step = lambda state, _: (jax.lax.cond(unfinished(state), body, lambda state: state, state), None)  # noqa: E731
        once_more = jax.checkpoint(step, prevent_cse=False, policy=keep)
        state = jax.lax.scan(once_more, state, length=capacity)[0]
    return FrameResult(state.poses, state.steps, state.rest)


class Measured(NamedTuple):
    """How well a frame's poses explain the measurements."""

    good: Bool[Array, ""]  # False: nothing was measured, or nothing finite found, and the poses are the predicted ones
    residual: Float[Array, ""]  # root of the weighted mean squared distance of the points, metres
    close: Int[Array, ""]  # number of points with a pair shorter than CLOSE
    feature_residual: Float[Array, ""]  # root of the weighted mean squared distance of the features, metres; 0: none
    limb_weight: Float[Array, " limb"]  # of the points
    steps: Int[Array, ""]


def solve_and_measure(
    problem: Problem, patient: Bool[Array, ""] | bool = True
) -> tuple[Poses, Measured, Float[Array, "limb6 limb6"]]:
    """As solve_frame from the predicted poses; also returns how well the poses explain the measurements, and the normal
    matrix of the limbs' twists there (kernels.gauss_newton). Both are without the pull on people who stand still, which
    would make a frame more certain than its measurements are.

    One loop for both, whose last turn measures and does not move: to compile all of a step twice takes seconds.
    """
    options, start = problem.options, problem.predicted
    coupled = options.solver == "coupled"
    anything = anything_measured(problem)

    def turn(state):
        loop, *_ = state
        good = anything & jnp.all(jnp.isfinite(loop.poses.rotation)) & jnp.all(jnp.isfinite(loop.poses.translation))
        poses = jax.tree.map(lambda new, old: jnp.where(good, new, old), loop.poses, start)
        poses = Poses(quat_normalize(poses.rotation), poses.translation)
        seen = seen_at(poses, problem, with_second=coupled)
        rest = loop.at_rest(seen.info.quality, options, patient)
        last = rest | ~good | (loop.steps >= options.max_steps)
        here = eqx.tree_at(lambda p: p.options.steady, problem, jnp.where(last, 0.0, options.steady))
        pulls = pulls_of(seen, poses, here)
        system = frame_normals(poses, pulls, options.damping) if coupled else None
        normals = none if system is None else system[0]

        def move():
            after = loop.after(*_stepped(loop, poses, pulls, system, options), seen.info.quality, jnp.array(False))
            return after, unseen, normals

        def measure():
            weight, off = seen.measured[:, 0, 0], jnp.zeros_like(unseen.residual)
            if seen.named is not None:
                off = jnp.sqrt(seen.named.squares / jnp.maximum(jnp.sum(seen.named.weight), 1e-6))
            residual = jnp.sqrt(seen.squares / jnp.maximum(jnp.sum(weight), 1e-6))
            close = jnp.sum(seen.found.close(CLOSE))
            found = Measured(good, residual, close, off, weight, loop.steps)
            if system is not None:
                return loop._replace(poses=poses), found, normals
            whole = pulls._replace(seen=seen._replace(second=sums(seen.found).second))
            return loop._replace(poses=poses), found, frame_normals(poses, whole, options.damping)[0]

        return *jax.lax.cond(last, measure, move), last

    zero, weight = jnp.zeros_like(start.translation[0, 0]), jnp.zeros_like(start.translation[:, 0])
    none = jnp.zeros((6 * len(weight), 6 * len(weight)), weight.dtype)
    unseen = Measured(jnp.array(False), zero, jnp.array(0), zero, weight, jnp.array(0, jnp.int32))
    begun = Loop.begun(start), unseen, none, jnp.array(False)
    loop, found, normals, _ = jax.lax.while_loop(lambda state: ~state[3], turn, begun)
    return loop.poses, found, normals
