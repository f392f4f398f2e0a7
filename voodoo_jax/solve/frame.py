"""One frame: the ICP step and its loop (Knoop 2006 sec. III-B, 2007 secs. 3.2 and 5.2).

A step is a pure function `(poses, problem) -> poses`: correspondences for all limbs, bands, prediction, one weighted
absolute orientation per limb, all limbs in one vmapped solve.
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.geometry.rigid import Poses, apply, compose, quat_normalize
from voodoo_jax.geometry.robust import geman_mcclure
from voodoo_jax.kernels.absolute_orientation import align
from voodoo_jax.kernels.bands import link_moments, prior_moments
from voodoo_jax.kernels.correspondences import Match, MatchOptions, Points, Settled, match, settled, sums
from voodoo_jax.kernels.gauss_newton import (
    as_motions,
    coupled_normals,
    coupled_twists,
    link_tables,
    pair_normals,
    stretched,
)
from voodoo_jax.kernels.joint_limits import PlausibleOptions, corrections, joint_links
from voodoo_jax.kernels.landmarks import (
    FeatureOptions,
    Features,
    FeatureSums,
    SettledFeatures,
    feature_sums,
    settled_features,
)
from voodoo_jax.model.body import Body, Links, Topology

MOVED = 0.003  # metres: a step that moves no limb farther may be the last where it gains nothing
NEAR = 10.0  # times epsilon by which the quality measure may still change where the start was near
CLOSE = 0.1  # metres: a point nearer to its limb is explained
STEADY_RADIUS = 0.1  # metres: about what a limb's own points hold its rotation with


class IcpOptions(eqx.Module):
    """Parameters of a frame's solve. Numbers are traced arrays: changing one compiles nothing anew
    (docs/numerics.md#recompiling)."""

    match: MatchOptions
    features: FeatureOptions
    ratio: Float[Array, ""]  # r: weight of a joint's bands over the limb's measured weight (2007, sec. 4.3)
    floor: Float[Array, ""]  # least measured weight that bands refer to, as a share of the frame's total
    prior: Float[Array, ""]  # weight of the pull to the predicted pose, as a share of the frame's total
    prior_radius: Float[Array, ""]  # metres, see prior_moments
    steady: Float[Array, "*limb"]  # weight of a limb's pull to where it stands still, over its measured weight
    steady_distance: Float[Array, ""]  # metres at which that pull is down to a quarter
    epsilon: Float[Array, ""]  # stop when the quality measure changes by less, square metres; 0: never
    max_steps: Int[Array, ""]
    damping: Float[Array, ""]  # Levenberg-Marquardt damping of the coupled solver
    stretch: Float[Array, ""]  # times as far as a step asks for a limb goes at most, see kernels.gauss_newton.stretched
    plausible: PlausibleOptions
    solver: Literal["per_limb", "coupled"] = eqx.field(static=True)


class Problem(eqx.Module):
    """All that one frame's solve depends on, prepared once per frame."""

    body: Body
    bands: Links
    points: Points
    features: Features | None  # None: the recording has none
    predicted: Poses
    options: IcpOptions

    @classmethod
    def build(
        cls, body: Body, points: Points, predicted: Poses, options: IcpOptions, features: Features | None = None
    ) -> "Problem":
        # of the predicted pose: a joint beyond its limits is turned back from one frame to the next
        links = joint_links(body, predicted, options.plausible)
        if options.solver == "coupled":  # before the loop, out of which no compiler takes what gradients repeat
            links = links._replace(tables=link_tables(links))
        return cls(body, links, points, features, predicted, options)


# normal matrix and right-hand side of all limbs' twists, see kernels.gauss_newton
System = tuple[Float[Array, "limb6 limb6"], Float[Array, "limb 6"]]


class StepInfo(NamedTuple):
    """What a step saw on entry."""

    quality: Float[Array, ""]  # weighted mean of squared pair distances, square metres
    limb_weight: Float[Array, " limb"]  # measured weight


class FrameResult(NamedTuple):
    """Solution of one frame."""

    poses: Poses
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


def adjacency(topology: Topology) -> Bool[Array, "limb limb"]:
    """Which limbs share a joint; every limb is adjacent to itself."""
    near = jnp.eye(len(topology.limbs), dtype=bool)
    parents, children = jnp.array(topology.parents, int), jnp.array(topology.children, int)
    return near.at[parents, children].set(True).at[children, parents].set(True)


class Seen(NamedTuple):
    """What was measured, as seen from a pose; sums in each limb's own frame."""

    info: StepInfo
    found: Match
    squares: Float[Array, ""]  # weighted sum of squared distances of the points, square metres
    measured: Float[Array, "limb 4 4"]  # sums over points of kernels.absolute_orientation
    second: Float[Array, "limb 3 3"] | None  # None: not asked for
    named: FeatureSums | None


class Chosen(NamedTuple):
    """All that is decided rather than measured in a frame: pairs of points, and of features (None: there are none)."""

    points: Settled
    features: SettledFeatures | None

    def differs(self, other: "Chosen") -> Int[Array, ""]:
        """How many points and features of a frame are matched in another way."""
        count = jnp.sum(self.points.differs(other.points))
        if self.features is not None and other.features is not None:
            moved = (self.features.point != other.features.point) & self.features.kept
            count = count + jnp.sum(moved | (self.features.kept != other.features.kept))
        return count


class Pulls(NamedTuple):
    """All that pulls at the limbs in a pose, each limb's in its own frame."""

    seen: Seen
    prior: Float[Array, "limb 4 4"]
    prior_second: Float[Array, "limb 3 3"]
    links: tuple[Links, ...]
    strength: Float[Array, " limb"]


def _near(body: Body, poses: Poses, predicted: Poses, distance: Float[Array, ""]) -> Float[Array, " limb"]:
    """How near each limb is to its prediction: 1 there, 1/4 where one of its ends or its side is `distance` away
    (Geman-McClure)."""
    zero, (a, b, *_, length) = jnp.zeros_like(body.sizes[:, 4]), body.sizes.T
    # the side: somebody who turns on the spot does not stand still
    seen = jnp.stack([jnp.stack(p, -1) for p in ((zero, zero, zero), (zero, zero, length), (a, b, length / 2))], 1)
    moved = apply(poses[:, None], seen) - apply(predicted[:, None], seen)
    return geman_mcclure(jnp.max(jnp.sum(moved * moved, -1), -1), distance)


def pull_to_prediction(
    poses: Poses, problem: Problem, limb_weight: Float[Array, " limb"]
) -> tuple[Float[Array, "limb 4 4"], Float[Array, "limb 3 3"]]:
    """Moments of the pairs that pull every limb to its predicted pose (see prior_moments): weakly wherever it is, and
    strongly where it hardly differs, for then it stands still and what differs is noise."""
    body, options = problem.body, problem.options
    middle = jnp.zeros_like(body.sizes[:, :3]).at[:, 2].set(body.sizes[:, 4] / 2)
    still = options.steady * limb_weight * _near(body, poses, problem.predicted, options.steady_distance)
    # what noise takes from the measurements' weights does not weaken the prediction
    doubt = problem.points.doubt
    weight = options.prior * total_weight(problem, 1.0 if doubt is None else doubt)
    square = weight * options.prior_radius**2 + still * STEADY_RADIUS**2
    return jax.vmap(prior_moments)(middle, poses, problem.predicted, weight + still, square)


def total_weight(problem: Problem, doubt: Float[Array, ""] | float = 1.0) -> Float[Array, ""]:
    """Weight of all measurements of the frame, that of the points times `doubt`."""
    total = jnp.sum(problem.points.weight) * doubt
    if problem.features is not None:
        total = total + jnp.sum(problem.features.weight)
    return jnp.maximum(total, 1e-6)


def anything_measured(problem: Problem) -> Bool[Array, ""]:
    """Whether the frame has points or features."""
    there = jnp.any(problem.points.weight > 0)
    return there if problem.features is None else there | jnp.any(problem.features.weight > 0)


def choices(poses: Poses, problem: Problem) -> Chosen:
    """How points and features are matched at these poses."""
    body, options = problem.body, problem.options
    near, features = adjacency(body.topology), problem.features
    points = settled(body.sizes, poses, problem.points, near, options.match, body.present)
    named = None if features is None else settled_features(body, poses, features, options.features)
    return Chosen(points, named)


def matched(poses: Poses, problem: Problem, chosen: Chosen | None = None) -> Match:
    """The points' pairs at these poses; `chosen` choices that are settled."""
    body, fixed = problem.body, None if chosen is None else chosen.points
    near = adjacency(body.topology)
    return match(body.sizes, poses, problem.points, near, problem.options.match, body.present, fixed)


def seen_at(poses: Poses, problem: Problem, with_second: bool = True, chosen: Chosen | None = None) -> Seen:
    """Measurements as sums, set up in each limb's frame: a solve is for a small motion near the origin, and float32
    keeps its digits wherever the person stands (docs/numerics.md#float32).

    `with_second`: second moments too, which only the coupled solver needs; `chosen`: choices that are settled."""
    body, options = problem.body, problem.options
    found = matched(poses, problem, chosen)
    measured, second, squares = sums(found, with_second)
    limb_weight = measured[:, 0, 0]
    named, of_points = None, squares
    if problem.features is not None:
        fixed = None if chosen is None else chosen.features
        named = feature_sums(body, poses, problem.features, options.features, fixed)
        limb_weight, squares = limb_weight + named.weight, squares + named.squares
    quality = squares / jnp.maximum(jnp.sum(limb_weight), 1e-6)
    return Seen(StepInfo(quality, limb_weight), found, of_points, measured, second, named)


def pulls_of(seen: Seen, poses: Poses, problem: Problem) -> Pulls:
    """Measurements that were seen from these poses, with bands and prediction."""
    body, options, limb_weight = problem.body, problem.options, seen.info.limb_weight
    strength = options.ratio * jnp.maximum(limb_weight, options.floor * total_weight(problem))
    pull, pull_second = pull_to_prediction(poses, problem, limb_weight)
    links = (problem.bands, *corrections(body, poses, options.plausible))
    return Pulls(seen, pull, pull_second, links, strength)


def frame_normals(poses: Poses, pulls: Pulls, damping: Float[Array, ""]) -> System:
    """The normal equations of all limbs' twists in a frame (see kernels.gauss_newton)."""
    seen = pulls.seen
    assert seen.second is not None  # see seen_at
    normals, rhs = jax.vmap(pair_normals)(seen.measured + pulls.prior, seen.second + pulls.prior_second)
    if seen.named is not None:
        # the features' own normals: their moments hold motion along a line of sight too
        normals, rhs = normals + seen.named.normals, rhs + seen.named.rhs
    return coupled_normals(pulls.links, poses, normals, rhs, pulls.strength, damping)


def icp_step(poses: Poses, problem: Problem) -> tuple[Poses, StepInfo]:
    """One ICP step: new poses of all limbs, and what was seen on entry."""
    after, _, info = _step(Loop.begun(poses), problem)
    return after, info


def _step(state: "Loop", problem: Problem) -> tuple[Poses, Float[Array, "limb 6"], StepInfo]:
    """Where the next step of a loop leads, what it asked for, and what was seen on entry."""
    poses = Poses(quat_normalize(state.poses.rotation), state.poses.translation)
    coupled = problem.options.solver == "coupled"
    pulls = pulls_of(seen_at(poses, problem, with_second=coupled), poses, problem)
    system = frame_normals(poses, pulls, problem.options.damping) if coupled else None
    return *_stepped(state, poses, pulls, system, problem.options), pulls.seen.info


def _stepped(
    state: "Loop", poses: Poses, pulls: Pulls, system: System | None, options: IcpOptions
) -> tuple[Poses, Float[Array, "limb 6"]]:
    """Where pulls lead from some poses, and what the step asked for: further than that where the last one led the same
    way, and to what is no worse. `system` None: limb by limb."""
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
    """How far the loop of a frame has come."""

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
        """One step further, to `poses`, or where it is, if that is to stay in."""
        moved = jnp.max(jnp.sum((poses.translation - self.poses.translation) ** 2, -1))
        poses = jax.tree.map(lambda old, new: jnp.where(rest, old, new), self.poses, poses)
        return Loop(poses, quality, asked, moved, self.steps + ~rest, rest)

    def at_rest(
        self, quality: Float[Array, ""], options: IcpOptions, patient: Bool[Array, ""] | bool
    ) -> Bool[Array, ""]:
        """Whether the poses, of this `quality`, are those to stay in: see solve_frame."""
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

    The coupled solver goes further than a step asks where steps go the same way (see kernels.gauss_newton.stretched).
    From a near start it stops where the measure rises and no limb moves much any more, too: points then change
    limbs to and fro, and going on takes more than twice the steps and finds nothing better. Not where pairs that nobody
    measured may make it rise; with epsilon 0 all max_steps are taken.

    `kind`: "lax" runs fastest, in forward mode of differentiation only; "checkpointed" can be reversed too: every step
    keeps little more than the poses that it began with, and is done once more on the way back (docs/numerics.md#loops).
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
    """How well a frame's poses explain what was measured."""

    good: Bool[Array, ""]  # False: nothing was measured, or nothing finite found, and the poses are the predicted ones
    residual: Float[Array, ""]  # root of the weighted mean squared distance of the points, metres
    close: Int[Array, ""]  # number of points with a pair shorter than CLOSE
    feature_residual: Float[Array, ""]  # root of the weighted mean squared distance of the features, metres; 0: none
    limb_weight: Float[Array, " limb"]  # of the points
    steps: Int[Array, ""]


def solve_and_measure(
    problem: Problem, patient: Bool[Array, ""] | bool = True
) -> tuple[Poses, Measured, Float[Array, "limb6 limb6"]]:
    """As solve_frame from the predicted poses; and what the poses found explain, with the normal matrix of the limbs'
    twists there (kernels.gauss_newton), both without the pull that holds who stands still: it would make a frame surer
    of itself than its measurements are.

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
