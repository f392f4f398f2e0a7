"""A frame's solution with exact derivatives: the implicit function theorem on the balance of forces.

Where the ICP step rests, the forces and torques that all pairs exert on every limb add up to zero, with either solver.
That balance is differentiated instead of the step: the measured part of a limb depends on that limb's own motion alone,
so six directions for all limbs at once give its whole derivative, and bands are few. Matches between points and limbs
are held fixed (docs/numerics.md#matches).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.geometry.rigid import Poses, compose, quat_exp, quat_normalize
from voodoo_jax.kernels.assignment import once
from voodoo_jax.kernels.bands import link_moments
from voodoo_jax.kernels.correspondences import Match, closest_limbs, match, match_assigned, moments
from voodoo_jax.kernels.gauss_newton import add_links, pair_normals
from voodoo_jax.kernels.joint_limits import corrections
from voodoo_jax.kernels.landmarks import feature_sums
from voodoo_jax.model.body import Links
from voodoo_jax.solve.frame import Problem, adjacency, pull_to_prediction, solve_frame, total_weight

MOST_TURN, MOST_SHIFT = 0.2, 0.05  # radians, metres: a Newton step is cut to this
RIDGE = 1e-12  # of the mean diagonal: keeps the linear system solvable where the prior is switched off


Settled = Int[Array, " point"] | None  # limb of each point, the number of limbs for none; None: found anew


class Solution(NamedTuple):
    """Solution of one frame; `poses` carry derivatives."""

    poses: Poses
    limbs: Settled  # which limb each point was matched to
    steps: Int[Array, ""]  # ICP steps
    off: Float[Array, ""]  # how far a Newton step would still move the measured points, root mean square, metres
    converged: Bool[Array, ""]


class Rest(NamedTuple):
    """Where one frame's poses come to rest."""

    poses: Poses
    slope: Float[Array, "all all"]  # of the balance there (see balance_slope)
    limbs: Settled
    steps: Int[Array, ""]  # ICP steps
    off: Float[Array, ""]  # see Solution


def moved(poses: Poses, twists: Float[Array, "limb 6"]) -> Poses:
    """Poses after a turn (radians) and a shift (metres) of every limb in its own frame."""
    return compose(poses, Poses(quat_exp(twists[:, :3]), twists[:, 3:]))


def settled(poses: Poses, problem: Problem) -> Settled:
    """The limb of each point at these poses; None under rules that give a point to several limbs."""
    options = problem.options.match
    if options.overlap != "exclusive":
        return None
    return closest_limbs(problem.body.sizes, poses, problem.points, options, problem.body.present)


def _forces_of_points(
    found: Match, limbs: Int[Array, " point"], count: int
) -> tuple[Float[Array, "limb 6"], Float[Array, " limb"]]:
    """Torque, force and weight of settled pairs, by limb: the same as from their moments, in fewer sums."""
    w, (cx, cy, cz), (px, py, pz) = found.weight[0], found.model, found.data
    torque = cy * pz - cz * py, cz * px - cx * pz, cx * py - cy * px
    of_limb = (jnp.arange(count)[:, None] == limbs).astype(w.dtype)
    # column by column: stacked first, the compiler repeats the whole match for every entry of the table
    columns = (*torque, px - cx, py - cy, pz - cz)
    sums = [jnp.matmul(of_limb, w * column, precision="highest") for column in columns]
    return jnp.stack(sums, -1), jnp.matmul(of_limb, w, precision="highest")


def _own(poses: Poses, problem: Problem, limbs: Settled) -> tuple[Float[Array, "limb 6"], Float[Array, " limb"]]:
    """Torque and force on every limb from what depends on its own pose only, and its measured weight."""
    body, options = problem.body, problem.options
    if limbs is None:
        found = match(body.sizes, poses, problem.points, adjacency(body.topology), options.match, body.present)
        measured, second = moments(found)
        force, weight = jax.vmap(pair_normals)(measured, second)[1], measured[:, 0, 0]
    else:
        pairs = lambda: match_assigned(body.sizes, poses, problem.points, limbs, options.match)  # noqa: E731
        force, weight = _forces_of_points(once(options.match.robust_scale > 0, pairs), limbs, body.limb_count)
    if problem.features is not None:
        named = feature_sums(body, poses, problem.features, options.features)
        force, weight = force + named.rhs, weight + named.weight
    pull, _ = pull_to_prediction(poses, problem, weight)
    force = force + jax.vmap(pair_normals)(pull, jnp.zeros((body.limb_count, 3, 3), weight.dtype))[1]
    return force, weight


def _force(link: Links, pair: Poses, strength: Float[Array, "2"], solver: str) -> Float[Array, "2 6"]:
    """Torque and force of one link on its two limbs."""
    one = jax.tree.map(lambda x: x[None], link._replace(first=jnp.array(0), second=jnp.array(1)))
    if solver == "coupled":
        # the normal matrix is not used: the compiler drops it
        unused = jnp.zeros((2, 6, 2, 6), strength.dtype)
        return add_links(one, pair, strength, unused, jnp.zeros((2, 6), strength.dtype))[1]
    return jax.vmap(pair_normals)(link_moments(one, pair, strength), jnp.zeros((2, 3, 3), strength.dtype))[1]


def _force_slope(
    link: Links, pair: Poses, strength: Float[Array, "2"], strength_by_own: Float[Array, "2 6"], solver: str
) -> tuple[Float[Array, "2 6"], Float[Array, "2 6 2 6"]]:
    """Torque and force of one link, and their derivative by the twists of its two limbs."""

    def force(twists):
        there = strength + jnp.sum(strength_by_own * twists, -1)
        return _force(link, moved(pair, twists), there, solver)

    still = jnp.zeros((2, 6), strength.dtype)
    return force(still), jax.jacfwd(force)(still)


def _strength(weight: Float[Array, " limb"], problem: Problem) -> Float[Array, " limb"]:
    return problem.options.ratio * jnp.maximum(weight, problem.options.floor * total_weight(problem))


def _links(poses: Poses, problem: Problem) -> tuple[Links, ...]:
    return (problem.bands, *corrections(problem.body, poses, problem.options.plausible))


def balance(poses: Poses, problem: Problem, limbs: Settled) -> Float[Array, "limb 6"]:
    """Torque and force of all pairs on every limb, in its frame: zero where a step leaves the poses as they are."""
    force, weight = _own(poses, problem, limbs)
    strength = _strength(weight, problem)
    for links in _links(poses, problem):
        ends = jnp.stack([links.first, links.second], 1)
        force = force.at[ends].add(
            jax.vmap(_force, (0, 0, 0, None))(links, poses[ends], strength[ends], problem.options.solver)
        )
    return force


def balance_slope(
    poses: Poses, problem: Problem, limbs: Settled
) -> tuple[Float[Array, "all all"], Float[Array, "limb 6"]]:
    """Derivative of the balance by all limbs' twists (rows: limb by limb), and the balance."""
    count, dtype = problem.body.limb_count, problem.body.sizes.dtype
    still = jnp.zeros((count, 6), dtype)
    own = lambda twists: _own(moved(poses, twists), problem, limbs)  # noqa: E731
    force, weight = own(still)

    def along(k):
        return jax.jvp(own, (still,), (still.at[:, k].set(1.0),))[1]

    by_own, weight_by_own = jax.vmap(along, out_axes=(2, 1))(jnp.arange(6))  # [limb, 6 out, 6], [limb, 6]
    slope = jnp.zeros((count, count, 6, 6), dtype).at[jnp.arange(count), jnp.arange(count)].add(by_own)
    strength, by_weight = jax.jvp(lambda w: _strength(w, problem), (weight,), (jnp.ones_like(weight),))
    strength_by_own = by_weight[:, None] * weight_by_own
    for links in _links(poses, problem):
        ends = jnp.stack([links.first, links.second], 1)
        one = jax.vmap(_force_slope, (0, 0, 0, 0, None))
        here, by_ends = one(links, poses[ends], strength[ends], strength_by_own[ends], problem.options.solver)
        force = force.at[ends].add(here)
        slope = slope.at[ends[:, :, None], ends[:, None, :]].add(by_ends.transpose(0, 1, 3, 2, 4))
    slope = slope.transpose(0, 2, 1, 3).reshape(6 * count, 6 * count)
    slope = slope - RIDGE * jnp.mean(jnp.abs(jnp.diagonal(slope))) * jnp.eye(6 * count, dtype=dtype)
    return slope, force


def _far(twists: Float[Array, "limb 6"], force: Float[Array, "limb 6"], problem: Problem) -> Float[Array, ""]:
    """How far from rest: what a Newton step gains, as a root mean square over the frame's weight, metres
    (docs/numerics.md#stopping).

    Not the step's size: a round limb rolls a long way for nothing, and the near side's choice may keep it rolling.
    """
    return jnp.sqrt(jnp.sum(jnp.abs(jnp.sum(twists * force, -1))) / total_weight(problem) + 1e-30)


def _polished(
    poses: Poses, problem: Problem, limbs: Settled, steps: int
) -> tuple[Poses, Float[Array, "all all"], Float[Array, ""]]:
    """Newton steps that are kept if they come nearer to rest; poses, slope there, and how far from rest (_far)."""

    def step(number, state):
        poses, slope, far, twists, share = state
        turn, shift = jnp.split(twists, 2, -1)
        cut = jnp.concatenate([jnp.clip(turn, -MOST_TURN, MOST_TURN), jnp.clip(shift, -MOST_SHIFT, MOST_SHIFT)], -1)
        there = moved(poses, share * cut)
        there = Poses(quat_normalize(there.rotation), there.translation)
        slope_there, force = balance_slope(there, problem, limbs)
        twists_there = -jnp.linalg.solve(slope_there, force.reshape(-1)).reshape(force.shape)
        far_there = _far(twists_there, force, problem)
        # the first time round nothing has moved yet
        better = (far_there < far) | (number == 0)
        state = jax.tree.map(
            lambda x, y: jnp.where(better, x, y),
            (there, slope_there, far_there, twists_there),
            (poses, slope, far, twists),
        )
        return (*state, jnp.where(better, jnp.minimum(1.0, 2 * share), 0.3 * share))

    count, dtype = problem.body.limb_count, problem.body.sizes.dtype
    nothing = jnp.zeros((6 * count, 6 * count), dtype), jnp.zeros((), dtype), jnp.zeros((count, 6), dtype)
    return jax.lax.fori_loop(0, steps + 1, step, (poses, *nothing, jnp.ones((), dtype)))[:3]


def resting(start: Poses, problem: Problem, newton: int = 3) -> Rest:
    """Where the poses of a frame come to rest: ICP steps and `newton` Newton steps. Nothing of it has a derivative."""
    start, problem = jax.lax.stop_gradient((start, problem))
    first = solve_frame(start, problem)
    limbs = settled(first.poses, problem)
    poses, slope, off = jax.lax.stop_gradient(_polished(first.poses, problem, limbs, newton))
    return Rest(poses, slope, limbs, first.steps, off)


def carried(found: Rest, problem: Problem) -> Poses:
    """The poses at rest with their derivatives by all that the problem depends on: those of the implicit function."""
    # zero in value
    force = balance(found.poses, problem, found.limbs)
    change = -jnp.linalg.solve(found.slope, (force - jax.lax.stop_gradient(force)).reshape(-1)).reshape(force.shape)
    return moved(found.poses, change)


def solution(start: Poses, problem: Problem, newton: int = 3, tolerance: float = 1e-3) -> Solution:
    """The poses that a step leaves as they are, with exact derivatives in forward and reverse mode.

    **Arguments:** `start` where to begin; has no derivative (docs/numerics.md#start); `problem` the frame, its options
    say how many ICP steps come first; `newton` Newton steps after them, with the points' limbs settled; `tolerance`
    metres: `converged` is true where a further Newton step would move the measured points by less (see Solution.off).

    **Returns:** see Solution. Derivatives are right only where `converged` is true (docs/numerics.md#convergence), and
    to the first order: second derivatives leave out how the slope of the balance changes.
    """
    found = resting(start, problem, newton)
    return Solution(carried(found, problem), found.limbs, found.steps, found.off, found.off < tolerance)


def weakest(poses: Poses, problem: Problem) -> Float[Array, ""]:
    """Least singular value of the balance's slope over the frame's weight: how well the worst direction is determined.

    Round limbs roll about their axes with nothing but the prior to hold them: expect about the prior's weight times the
    square of its radius (docs/numerics.md#null-directions); zero means that derivatives are not to be believed.
    """
    slope, _ = balance_slope(poses, problem, settled(poses, problem))
    return jnp.linalg.svd(slope, compute_uv=False)[-1] / total_weight(problem)
