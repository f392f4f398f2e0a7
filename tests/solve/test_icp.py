"""One frame: how close it gets, what must not matter, when it stops, and its gradients."""

import os
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.helpers import (
    all_finite,
    cast,
    central_difference,
    dot,
    frame_points,
    icp_options,
    random_like,
    seen_points,
    turned,
    two_limbs,
)
from voodoo_jax.geometry.rigid import Poses, apply
from voodoo_jax.kernels.correspondences import Points, match
from voodoo_jax.kernels.gauss_newton import stretched
from voodoo_jax.model.body_file import load_body
from voodoo_jax.solve.frame import icp_step, solve_and_measure, solve_frame
from voodoo_jax.solve.pulls import Problem, adjacency, frame_normals, pulls_of, seen_at

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

SENSORS = {"human": (3.0, 0.3, 1.2), "human10": (3.0, 0.3, 1.2), "arm": (1.5, 1.5, 0.9), "dog": (1.0, 2.5, 0.8)}
SOLVERS = ("coupled", "per_limb")


@cache
def scene(name: str, count: int):
    """Body in its rest pose, what one sensor sees of it, and a start 3 cm and 5 degrees off."""
    rng = np.random.default_rng(len(name))
    body = load_body(name)
    xyz = seen_points(rng, body, body.rest, SENSORS[name], count)
    return body, xyz, turned(rng, body.rest, 0.03, 5)


@eqx.filter_jit
def solve(body, points, start, options):
    return solve_frame(start, Problem.build(body, points, start, options))


@eqx.filter_jit
def measure(body, points, start, options):
    return solve_and_measure(Problem.build(body, points, start, options))


def middles(body, poses: Poses) -> np.ndarray:
    return np.asarray(apply(poses, jnp.zeros_like(body.sizes[:, :3]).at[:, 2].set(body.sizes[:, 4] / 2)))


def points_of(body, xyz, dtype=jnp.float32, capacity=0):
    return frame_points(xyz, [SENSORS[body.name]], dtype, capacity)


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_is_measured_is_what_a_look_from_the_end_sees(solver):
    """In the last turn of the loop; some points are left over, and the pull that holds who stands still is not."""
    body, xyz, start = scene("arm", 500)
    points = points_of(body, np.concatenate([xyz, xyz[:50] + [0.0, 0.0, 1.5]]))
    options = icp_options(solver=solver, steady=0.5, steady_distance=10.0)
    found = solve(body, points, start, options)
    poses, seen, normals = measure(body, points, start, options)
    for mine, theirs in zip(jax.tree.leaves(poses), jax.tree.leaves(found.poses)):
        np.testing.assert_allclose(mine, theirs, atol=1e-5)
    assert seen.good and int(seen.steps) == int(found.steps) > 2
    here = Problem.build(body, points, start, icp_options(solver=solver, steady=0.0))
    sight = seen_at(poses, here)
    pulls = pulls_of(sight, poses, here)
    weight = sight.measured[:, 0, 0]
    np.testing.assert_allclose(seen.limb_weight, weight, rtol=1e-4)
    np.testing.assert_allclose(seen.residual, np.sqrt(sight.squares / np.sum(weight)), rtol=1e-3)
    near = np.any(np.asarray((sight.found.weight > 0) & (sight.found.distance < 0.1)), 0)
    assert 400 < int(seen.close) == near.sum() < 520
    wanted = frame_normals(poses, pulls, here.options.damping)[0]
    np.testing.assert_allclose(normals, wanted, atol=1e-3 * float(jnp.max(jnp.abs(wanted))))
    held = pulls_of(sight, poses, Problem.build(body, points, start, options))
    assert float(jnp.max(jnp.abs(frame_normals(poses, held, options.damping)[0] - wanted))) > 1.0


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("what", ["nothing", "not a number"])
def test_where_nothing_can_be_measured_the_prediction_stays(solver, what):
    body, xyz, start = scene("arm", 500)
    points = points_of(body, xyz if what == "not a number" else np.zeros((0, 3)), capacity=512)
    if what == "not a number":
        points = eqx.tree_at(lambda p: p.xyz, points, points.xyz.at[7].set(jnp.nan))
    poses, seen, _ = measure(body, points, start, icp_options(solver=solver))
    assert not seen.good
    np.testing.assert_allclose(poses.translation, start.translation, atol=1e-6)
    np.testing.assert_allclose(poses.rotation, start.rotation, atol=1e-6)


@pytest.mark.parametrize(
    "name,solver",
    [("human", "coupled"), ("human10", "coupled"), ("arm", "coupled"), ("dog", "coupled"), ("dog", "per_limb")],
)
def test_convergence(name, solver):
    body, xyz, start = scene(name, 1000)
    # a weak prior, since the start is wrong on purpose
    options = icp_options(solver=solver, prior=1e-5, max_steps=60)
    found = solve(body, points_of(body, xyz), start, options)
    assert all_finite(found)
    seen = np.asarray(match(body.sizes, body.rest, points_of(body, xyz), adjacency(body.topology),
                            options.match).weight).sum(-1) > 40  # fmt: skip
    error = np.linalg.norm(middles(body, found.poses) - middles(body, body.rest), axis=-1)
    before = np.linalg.norm(middles(body, start) - middles(body, body.rest), axis=-1)
    assert seen.sum() >= len(seen) // 2
    assert before[seen].mean() > 0.025
    # along a limb and about its axis a smooth surface says little: the bound is on the well seen part
    assert np.median(error[seen]) < 0.005, np.round(1e3 * error, 1)


@pytest.mark.parametrize("solver", SOLVERS)
def test_order_and_padding_do_not_matter(x64, solver):
    body, xyz, start = cast(scene("arm", 300)[0], jnp.float64), *scene("arm", 300)[1:]
    start, options = cast(start, jnp.float64), icp_options(jnp.float64, solver=solver)
    shuffled = xyz[np.random.default_rng(0).permutation(len(xyz))]
    a = solve(body, points_of(body, xyz, jnp.float64, 300), start, options)
    for other in (points_of(body, shuffled, jnp.float64, 300), points_of(body, shuffled, jnp.float64, 512)):
        b = solve(body, other, start, options)
        assert int(a.steps) == int(b.steps)
        np.testing.assert_allclose(a.poses.rotation, b.poses.rotation, atol=1e-6)
        np.testing.assert_allclose(a.poses.translation, b.poses.translation, atol=1e-6)


def test_a_bad_frame_does_not_touch_the_others():
    """All points masked, a NaN among the points: bit for bit the same poses for the good frames of the batch."""
    body, xyz, start = scene("arm", 300)
    good = [points_of(body, xyz + shift) for shift in ([0, 0, 0], [0.02, 0, 0], [0, 0.02, 0], [0, 0, 0.01])]
    masked = eqx.tree_at(lambda p: p.weight, good[1], jnp.zeros(300))
    broken = eqx.tree_at(lambda p: p.xyz, good[2], good[2].xyz.at[7].set(jnp.nan))
    options = icp_options()
    batch = eqx.filter_jit(jax.vmap(lambda points: solve_frame(start, Problem.build(body, points, start, options))))
    stack = lambda frames: jax.tree.map(lambda *x: jnp.stack(x), *frames)  # noqa: E731
    without = batch(stack(good))
    found = batch(stack([good[0], masked, broken, good[3]]))
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(without)):
        np.testing.assert_array_equal(a[np.array([0, 3])], b[np.array([0, 3])])
    assert all_finite(jax.tree.map(lambda x: x[1], found.poses))


def test_when_it_stops():
    body, xyz, start = scene("arm", 300)
    points = points_of(body, xyz)
    for most in (1, 3, 7):
        options = icp_options(epsilon=0.0, max_steps=most)
        found = solve(body, points, start, options)
        assert int(found.steps) == most and not bool(found.converged)
    hard = solve(body, points, start, icp_options(epsilon=1e-7))
    again = solve(body, points, hard.poses, icp_options(epsilon=1e-7))
    assert bool(hard.converged) and bool(again.converged)
    assert int(again.steps) <= int(hard.steps)
    assert int(solve(body, points, hard.poses, icp_options(epsilon=1e-5)).steps) <= 4


slow = pytest.mark.skipif(not os.environ.get("SLOW"), reason="half a minute of compilation; SLOW=1 runs it")


@pytest.mark.parametrize("solver", ["coupled", pytest.param("per_limb", marks=slow)])
def test_gradients(x64, solver):
    """Reverse mode through the loop against central differences, by sizes, joint weights and points
    (docs/numerics.md#matches)."""
    rng = np.random.default_rng(3)
    body = cast(two_limbs((0.03, 0.0)), jnp.float64)
    xyz = seen_points(rng, body, body.rest, (2.0, 0.4, 0.5), 120)
    points = frame_points(xyz, [(2.0, 0.4, 0.5)], jnp.float64)
    start = turned(rng, body.rest, 0.01, 2)
    # no end of the loop that depends on numbers; a prior that determines every direction
    options = icp_options(jnp.float64, solver=solver, epsilon=0.0, max_steps=4, prior=0.05, max_distance=1.0)
    target = random_like(rng, start)

    def run(parts, kind):
        sizes, weights, xyz = parts
        changed = eqx.tree_at(lambda b: (b.sizes, b.weights), body, (sizes, weights))
        frame = Points(xyz, points.weight, points.sensor, points.origins)
        return solve_frame(start, Problem.build(changed, frame, start, options), kind=kind, capacity=5), frame, changed

    def loss(parts, kind="checkpointed"):
        found, frame, changed = run(parts, kind)
        chosen = match(changed.sizes, found.poses, frame, adjacency(body.topology), options.match).weight > 0
        return dot(found.poses, target), (found, chosen)

    parts = body.sizes, body.weights, points.xyz
    (_, (found, chosen)), gradient = jax.jit(jax.value_and_grad(loss, has_aux=True))(parts)
    plain = jax.jit(lambda p: loss(p, "lax"))
    for a, b in zip(jax.tree.leaves(found.poses), jax.tree.leaves(plain(parts)[1][0].poses)):
        np.testing.assert_allclose(a, b, atol=1e-12)
    assert int(found.steps) == 4 and all_finite(gradient)
    for part, by_part in enumerate(gradient):
        direction = random_like(rng, by_part)
        direction = direction / jnp.linalg.norm(direction)
        along = tuple(direction if i == part else jnp.zeros_like(x) for i, x in enumerate(parts))
        for sign in (1, -1):  # the difference stays within one assignment
            moved = jax.tree.map(lambda x, d, sign=sign: x + sign * 1e-6 * d, parts, along)
            np.testing.assert_array_equal(plain(moved)[1][1], chosen)
        numeric = central_difference(lambda p: plain(p)[0], parts, along, 1e-6)
        assert abs(numeric) > 1e-6
        np.testing.assert_allclose(dot(by_part, direction), numeric, rtol=1e-4, atol=1e-8)


def test_a_body_that_is_a_constant_of_the_program_does_not_slow_it():
    """Branches around what is to be computed once stay, or each sum repeats the whole match: four times the time."""
    body, xyz, start = scene("human10", 200)
    given = body, points_of(body, xyz), start, icp_options()

    def branches(*constant) -> int:
        program = jax.jit(lambda *rest: icp_step(start, Problem.build(*constant, *rest))[0])
        return program.lower(*given[len(constant) :]).compile().as_text().count(" conditional(")

    assert branches() > 0 and branches(*given) == branches()


def test_steps_that_go_the_same_way_are_made_one():
    """Of limbs whose steps are 0.4, 0.9 and -0.5 of the last: the sum of all that follow, twice as far, as asked."""
    rng = np.random.default_rng(5)
    before, share = rng.normal(size=(3, 6)), np.array([[0.4], [0.9], [-0.5]])
    found = np.asarray(stretched(jnp.asarray(share * before), jnp.asarray(before), jnp.asarray(2.0)))
    np.testing.assert_allclose(found, share * before * [[1 / 0.6], [2.0], [1.0]], rtol=1e-5)
    step = jnp.asarray(0.4 * before)
    for most, last in ((1.0, before), (2.0, np.zeros((3, 6)))):
        np.testing.assert_array_equal(stretched(step, jnp.asarray(last), jnp.asarray(most)), step)


@pytest.mark.parametrize("name", ["human", "dog"])
def test_longer_steps_end_sooner_and_nearer_to_the_truth(name):
    body, xyz, start = scene(name, 1000)
    plain, longer = (
        solve(body, points_of(body, xyz), start, icp_options(stretch=s, epsilon=1e-7, max_steps=99, prior=1e-3))
        for s in (1.0, 2.0)
    )
    assert plain.converged and longer.converged
    assert int(longer.steps) < 0.85 * int(plain.steps)
    off = [
        np.median(np.linalg.norm(middles(body, f.poses) - middles(body, body.rest), axis=1)) for f in (plain, longer)
    ]
    assert off[1] < off[0] < 0.004
