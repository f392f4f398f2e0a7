"""A frame's solution with exact derivatives: the implicit function theorem on the balance of forces.

Where the ICP step rests, the forces and torques that all pairs exert on every limb add up to zero, with either solver.
That balance is differentiated instead of the step: the measured part of a limb depends on that limb's own motion alone,
so six directions for all limbs at once give its whole derivative, and bands are few; optimistix' ImplicitAdjoint takes
96, for the same gradient (tests/solve/test_fixed_point.py) in 1.3 times the time. Matches between points and limbs are
held fixed (docs/numerics.md#matches).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.geometry.rigid import Poses, compose, quat_exp, quat_normalize
from voodoo_jax.kernels.assignment import once
from voodoo_jax.kernels.bands import link_moments
from voodoo_jax.kernels.correspondences import Match, match_assigned, moments
from voodoo_jax.kernels.gauss_newton import add_links, pair_normals
from voodoo_jax.kernels.joint_limits import corrections
from voodoo_jax.kernels.landmarks import feature_sums
from voodoo_jax.model.body import Links
from voodoo_jax.solve.frame import solve_frame
from voodoo_jax.solve.pulls import (
    Chosen,
    Problem,
    choices,
    frame_normals,
    matched,
    pull_to_prediction,
    pulls_of,
    seen_at,
    total_weight,
)

MOST_TURN, MOST_SHIFT = 0.2, 0.05  # radians, metres: a Newton step is cut to this
RIDGE = 1e-12  # of the mean diagonal: keeps the linear system solvable where the prior is switched off
# measured: three do in most frames, 100 in all of 50 of a log in which limbs are held where they stand
NEWTON = 100  # Newton steps after the ICP steps at most
# metres, see Solution.off: ten times what float32 tells apart 10 m away; a last Newton step ends far below: its error
# is squared by the next
AT_REST = 1e-5


class Solution(NamedTuple):
    """Solution of one frame; `poses` carry derivatives."""

    poses: Poses
    weight: Float[Array, " limb"]  # measured, of the points alone; carries derivatives
    chosen: Chosen  # how points and features were matched: held fixed in the derivatives
    changing: Int[Array, ""]  # how many of these choices the poses found would make otherwise
    steps: Int[Array, ""]  # ICP steps
    off: Float[Array, ""]  # how far a Newton step would still move the measured points, root mean square, metres
    converged: Bool[Array, ""]


class Rest(NamedTuple):
    """Where one frame's poses come to rest."""

    poses: Poses
    slope: Float[Array, "all all"]  # of the balance there (see balance_slope)
    chosen: Chosen
    steps: Int[Array, ""]  # ICP steps
    off: Float[Array, ""]  # see Solution


def moved(poses: Poses, twists: Float[Array, "limb 6"]) -> Poses:
    """Poses after a turn (radians) and a shift (metres) of every limb in its own frame."""
    return compose(poses, Poses(quat_exp(twists[:, :3]), twists[:, 3:]))


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


def _own(poses: Poses, problem: Problem, chosen: Chosen) -> tuple[Float[Array, "limb 6"], Float[Array, " limb"]]:
    """Torque and force on every limb from its own pairs with measurements and its prediction, and its measured
    weight."""
    body, options = problem.body, problem.options
    if options.match.overlap == "exclusive":
        mine, limb = chosen.points, chosen.points.limb
        pairs = lambda: match_assigned(body.sizes, poses, problem.points, limb, options.match, fixed=mine)  # noqa: E731
        force, weight = _forces_of_points(once(options.match.robust_scale > 0, pairs), limb, body.limb_count)
    else:
        measured, second = moments(matched(poses, problem, chosen))
        force, weight = jax.vmap(pair_normals)(measured, second)[1], measured[:, 0, 0]
    if problem.features is not None:
        named = feature_sums(body, poses, problem.features, options.features, chosen.features)
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


def balance(poses: Poses, problem: Problem, chosen: Chosen) -> Float[Array, "limb 6"]:
    """Torque and force of all pairs on every limb, in its frame: zero where a step leaves the poses as they are."""
    force, weight = _own(poses, problem, chosen)
    strength = _strength(weight, problem)
    for links in _links(poses, problem):
        ends = jnp.stack([links.first, links.second], 1)
        force = force.at[ends].add(
            jax.vmap(_force, (0, 0, 0, None))(links, poses[ends], strength[ends], problem.options.solver)
        )
    return force


def balance_slope(
    poses: Poses, problem: Problem, chosen: Chosen
) -> tuple[Float[Array, "all all"], Float[Array, "limb 6"]]:
    """Derivative of the balance by all limbs' twists (rows: limb by limb), and the balance."""
    count, dtype = problem.body.limb_count, problem.body.sizes.dtype
    still = jnp.zeros((count, 6), dtype)
    if problem.options.match.overlap == "soft":  # what a limb has of a point depends on all limbs
        both = lambda twists: (balance(moved(poses, twists), problem, chosen),) * 2  # noqa: E731
        slope, force = jax.jacfwd(both, has_aux=True)(still)
        return _ridged(slope.reshape(6 * count, 6 * count)), force
    own = lambda twists: _own(moved(poses, twists), problem, chosen)  # noqa: E731
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
    return _ridged(slope.transpose(0, 2, 1, 3).reshape(6 * count, 6 * count)), force


def _ridged(slope: Float[Array, "all all"]) -> Float[Array, "all all"]:
    ridge = RIDGE * jnp.mean(jnp.abs(jnp.diagonal(slope)))
    return slope - ridge * jnp.eye(len(slope), dtype=slope.dtype)


def solved(slope: Float[Array, "all all"], rhs: Float[Array, " all"]) -> Float[Array, " all"]:
    """Solution of a linear system whose matrix has no derivative, one after the other under vmap on a CPU: two batches
    of matrices at LAPACK at once wait for each other's threads (see compile.xla_options)."""
    slope = jax.lax.stop_gradient(slope)
    one = jnp.linalg.solve
    if jax.default_backend() == "cpu":
        one = jax.custom_batching.sequential_vmap(one)
    return jax.lax.custom_linear_solve(
        lambda x: slope @ x, rhs, lambda _, b: one(slope, b), lambda _, b: one(slope.T, b)
    )


def _far(twists: Float[Array, "limb 6"], force: Float[Array, "limb 6"], problem: Problem) -> Float[Array, ""]:
    """Distance from rest: the gain of a Newton step, as a root mean square over the frame's weight, metres
    (docs/numerics.md#stopping).

    Not the step's size: a round limb rolls a long way for nothing, and the near side's choice may keep it rolling.
    """
    return jnp.sqrt(jnp.sum(jnp.abs(jnp.sum(twists * force, -1))) / total_weight(problem) + 1e-30)


class _Place(NamedTuple):
    """Poses on the way to rest."""

    poses: Poses
    slope: Float[Array, "all all"]
    force: Float[Array, "limb 6"]
    normals: Float[Array, "all all"]  # of the ICP step: what the slope would be, did no weight change
    unrest: Float[Array, ""]  # what an ICP step would gain, as _far


def _place(poses: Poses, problem: Problem, chosen: Chosen) -> _Place:
    slope, force = balance_slope(poses, problem, chosen)
    pulls = pulls_of(seen_at(poses, problem, chosen=chosen), poses, problem)
    normals = frame_normals(poses, pulls, problem.options.damping)[0]
    step = solved(normals, force.reshape(-1)).reshape(force.shape)
    return _Place(poses, slope, force, normals, _far(step, force, problem))


def _polished(
    poses: Poses, problem: Problem, chosen: Chosen, steps: int, tolerance: float
) -> tuple[Poses, Float[Array, "all all"], Float[Array, ""]]:
    """Newton steps until a further one would move the measured points by less than `tolerance` metres; poses, the slope
    there, and how far from rest (_far). One that comes no nearer to rest is taken back, and the next one is the ICP
    step, which always leads there, if slowly: then steps that are less and less like it."""

    def towards(place: _Place, like_icp, share) -> tuple[Float[Array, "limb 6"], Float[Array, ""]]:
        mixed = like_icp * place.normals - (1.0 - like_icp) * place.slope
        twists = solved(mixed, place.force.reshape(-1)).reshape(place.force.shape)
        off = jnp.where(like_icp > 0, jnp.inf, _far(twists, place.force, problem))
        turn, shift = jnp.split(jnp.where(like_icp == 1.0, share, 1.0) * twists, 2, -1)
        cut = jnp.clip(turn, -MOST_TURN, MOST_TURN), jnp.clip(shift, -MOST_SHIFT, MOST_SHIFT)
        return jnp.concatenate(cut, -1), off

    def step(state):
        number, place, like_icp, share, twists, _ = state
        there = moved(place.poses, twists)
        there = _place(Poses(quat_normalize(there.rotation), there.translation), problem, chosen)
        improved, onwards = there.unrest < place.unrest, jnp.sum(there.force * twists) > 0
        # where a weight falls faster than its distance grows the way to rest leads through more unrest: ICP steps take
        # it, each twice as long as the last one as long as all still pulls that way
        taken = improved | ((like_icp == 1.0) & (onwards | (share <= 1.0)))
        place = jax.tree.map(lambda new, old: jnp.where(taken, new, old), there, place)
        share = jnp.where(taken & onwards, jnp.where(like_icp == 1.0, 2 * share, share), 1.0)
        like_icp = jnp.where(improved, jnp.where(like_icp < 0.1, 0.0, 0.3 * like_icp), 1.0)
        return number + 1, place, like_icp, share, *towards(place, like_icp, share)

    count, dtype = problem.body.limb_count, problem.body.sizes.dtype
    table, none = jnp.zeros((6 * count, 6 * count), dtype), jnp.zeros((count, 6), dtype)
    huge, zero = jnp.array(jnp.inf, dtype), jnp.zeros((), dtype)
    begun = jnp.array(0), _Place(poses, table, none, table, huge), zero, zero + 1, none, huge
    found = jax.lax.while_loop(lambda state: (state[0] <= steps) & ~(state[-1] < tolerance), step, begun)
    _, place, *_, twists, off = found
    last = moved(place.poses, jnp.where(off < tolerance, twists, 0.0))  # so little that the slope stays
    return Poses(quat_normalize(last.rotation), last.translation), place.slope, off


def resting(
    start: Poses,
    problem: Problem,
    newton: int = NEWTON,
    tolerance: float = AT_REST,
    patient: Bool[Array, ""] | bool = True,
) -> Rest:
    """Where the poses of a frame come to rest: ICP steps, then Newton steps with their choices held fixed, `newton` at
    most, until a further one would move the measured points by less than `tolerance` metres (see Solution.off). Nothing
    of it has a derivative; poses that are no numbers are the start's."""
    start, problem = jax.lax.stop_gradient((start, problem))
    first = solve_frame(start, problem, patient=patient)
    fine = jnp.all(jnp.isfinite(first.poses.rotation)) & jnp.all(jnp.isfinite(first.poses.translation))
    begin = jax.tree.map(lambda new, old: jnp.where(fine, new, old), first.poses, start)
    chosen = choices(begin, problem)
    poses, slope, off = _polished(begin, problem, chosen, newton, tolerance)
    found = jax.lax.stop_gradient(Rest(poses, slope, chosen, first.steps, off))
    # by name, so that who goes back through many frames may keep it and need not solve each once more
    return jax.tree.map(lambda leaf: checkpoint_name(leaf, "rest"), found)


def carried(found: Rest, problem: Problem, tolerance: float = AT_REST) -> Poses:
    """The poses at rest with their derivatives by all that the problem depends on: those of the implicit function."""
    # zero in value
    force = balance(found.poses, problem, found.chosen)
    # what does not rest has no derivative: it is zero
    sound = found.off < tolerance
    slope = jnp.where(sound, found.slope, jnp.eye(len(found.slope), dtype=found.slope.dtype))
    force = jnp.where(sound, force - jax.lax.stop_gradient(force), 0.0)
    return moved(found.poses, -solved(slope, force.reshape(-1)).reshape(force.shape))


def solution(start: Poses, problem: Problem, newton: int = NEWTON, tolerance: float = AT_REST) -> Solution:
    """The poses that a step leaves as they are, with exact derivatives in forward and reverse mode.

    **Arguments:** `start` where to begin; has no derivative (docs/numerics.md#start); `problem` the frame, its options
    say how many ICP steps come first; `newton` Newton steps after them at most, with the choices that the ICP steps
    ended with held fixed; `tolerance` metres: `converged` is true where a further Newton step would move the measured
    points by less (see Solution.off).

    **Returns:** see Solution; always numbers. Derivatives are right only where `converged` is true
    (docs/numerics.md#convergence), and to the first order: second derivatives leave out how the slope of the balance
    changes.
    """
    return with_derivatives(resting(start, problem, newton, tolerance), problem, tolerance)


def with_derivatives(found: Rest, problem: Problem, tolerance: float = AT_REST) -> Solution:
    """The solution at rest, with derivatives."""
    poses = carried(found, problem, tolerance)
    again = choices(found.poses, jax.lax.stop_gradient(problem))
    weight = jnp.sum(matched(poses, problem, found.chosen).weight, 1)
    changing = found.chosen.differs(again)
    return Solution(poses, weight, found.chosen, changing, found.steps, found.off, found.off < tolerance)
