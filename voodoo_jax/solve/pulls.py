"""The measurements of a frame at some poses, and the pulls on the limbs: correspondences, bands, prediction (Knoop 2006
sec. III-B, 2007 secs. 3.2 and 4.3)."""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.geometry.rigid import Poses, apply
from voodoo_jax.geometry.robust import geman_mcclure
from voodoo_jax.kernels.bands import prior_moments
from voodoo_jax.kernels.correspondences import Match, MatchOptions, Points, Settled, match, settled, sums
from voodoo_jax.kernels.gauss_newton import coupled_normals, link_tables, pair_normals
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

STEADY_RADIUS = 0.1  # metres: about what a limb's own points hold its rotation with


class IcpOptions(eqx.Module):
    """Parameters of a frame's solve. Numbers are traced arrays, so new values compile nothing
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
    """All inputs of one frame's solve, prepared once per frame."""

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
    """Measurements on entry of a step."""

    quality: Float[Array, ""]  # weighted mean of squared pair distances, square metres
    limb_weight: Float[Array, " limb"]  # measured weight


def adjacency(topology: Topology) -> Bool[Array, "limb limb"]:
    """Whether limbs share a joint; every limb is adjacent to itself."""
    near = jnp.eye(len(topology.limbs), dtype=bool)
    parents, children = jnp.array(topology.parents, int), jnp.array(topology.children, int)
    return near.at[parents, children].set(True).at[children, parents].set(True)


class Seen(NamedTuple):
    """Measurements as seen from a pose; sums in each limb's own frame."""

    info: StepInfo
    found: Match
    squares: Float[Array, ""]  # weighted sum of squared distances of the points, square metres
    measured: Float[Array, "limb 4 4"]  # sums over points of kernels.eigen
    second: Float[Array, "limb 3 3"] | None  # None: not asked for
    named: FeatureSums | None


class Chosen(NamedTuple):
    """All discrete choices in a frame: pairs of points, and of features (None: there are none)."""

    points: Settled
    features: SettledFeatures | None

    def differs(self, other: "Chosen") -> Int[Array, ""]:
        """Number of points and features of a frame with another match."""
        count = jnp.sum(self.points.differs(other.points))
        if self.features is not None and other.features is not None:
            moved = (self.features.point != other.features.point) & self.features.kept
            count = count + jnp.sum(moved | (self.features.kept != other.features.kept))
        return count


class Pulls(NamedTuple):
    """All pulls on the limbs in a pose, each in the limb's own frame."""

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
    """Moments of the pairs that pull every limb to its predicted pose (see prior_moments): weakly anywhere, and
    strongly near it, because there the limb stands still and the difference is noise."""
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
    """Matches of points and features at these poses."""
    body, options = problem.body, problem.options
    near, features = adjacency(body.topology), problem.features
    points = settled(body.sizes, poses, problem.points, near, options.match, body.present)
    named = None if features is None else settled_features(body, poses, features, options.features)
    return Chosen(points, named)


def matched(poses: Poses, problem: Problem, chosen: Chosen | None = None) -> Match:
    """The points' pairs at these poses; `chosen` are fixed choices."""
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
    """Measurements as seen from these poses, with bands and prediction."""
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
