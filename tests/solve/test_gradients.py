"""Derivatives of a frame's solution: implicit, unrolled and by central differences, for every kind of parameter."""

import os

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.kernels.test_procrustes import CLOUDS
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
)
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.kernels.landmarks import Features
from voodoo_jax.model.body_file import parse_body
from voodoo_jax.solve.frame import icp_step, solve_frame
from voodoo_jax.solve.implicit import balance, balance_slope, moved, solution
from voodoo_jax.solve.pulls import Problem, choices, total_weight

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

SENSOR = (2.0, 0.4, 0.5)
slow = pytest.mark.skipif(not os.environ.get("SLOW"), reason="a minute of compilation; SLOW=1 runs it")
BODY = """
name = "two"
scale = 1.0
limb = [
  {name = "a", bottom = [0, 0, 0], top = [0, 0, 0.4], bottom_axes = [0.05, 0.05], top_axes = [0.05, 0.05]},
  {name = "b", bottom = [0, 0, 0.4], top = [0, 0, 0.8], bottom_axes = [0.05, 0.05], top_axes = [0.04, 0.04]},
]
joint = [{name = "j", parent = "a", child = "b", at = [0, 0, 0.4], axes = [0.03, 0.0], weight = 1.0}]
centre = [{name = "c", limb = "a", at = [0, 0, 0.1]}]
site = [{name = "s", limb = "b", at = [0.04, 0, 0.7]}]
"""


def scene(dtype, **changes):
    """Body, points, features, start and options: a smooth frame, with a prior that determines every direction (P11)."""
    rng = np.random.default_rng(5)
    body = cast(parse_body(BODY), dtype)
    points = frame_points(seen_points(rng, body, body.rest, SENSOR, 120), [SENSOR], dtype)
    array = lambda x: jnp.asarray(x, dtype)  # noqa: E731
    aim = np.array([0.06, 0.01, 0.7]) - SENSOR
    features = Features(
        jnp.array([[0], [1]]), array([SENSOR, [0.02, 0.01, 0.1]]), array([aim / np.linalg.norm(aim), [0, 0, 0]]),
        array([6.0, 5.0]),
    )  # fmt: skip
    asked = dict(solver="coupled", epsilon=0.0, max_steps=100, prior=2.0, max_distance=1.0) | changes
    return body, points, features, turned(rng, body.rest, 0.01, 2), icp_options(dtype, **asked)


def parts_of(body, points, features, start, options):
    """Everything that a solution depends on, by name."""
    return {
        "sizes": body.sizes, "band weights": body.weights, "axes": body.axes[:, 0], "sites": body.sites,
        "centres": body.centres, "parent anchors": body.parent_anchor.translation,
        "child anchors": body.child_anchor.translation, "points": points.xyz, "measurement weights": points.weight,
        "feature weights": features.weight, "ray origins": features.origin, "ratio": options.ratio,
        "prior": options.prior, "robust scale": options.match.robust_scale, "prediction": start.translation,
    }  # fmt: skip


def built(parts, body, points, features, start, options):
    """The frame's problem with other numbers."""
    leaves = lambda b: (  # noqa: E731
        b.sizes, b.weights, b.axes, b.sites, b.centres, b.parent_anchor.translation, b.child_anchor.translation,
    )  # fmt: skip
    axes = body.axes.at[:, 0].set(parts["axes"])
    names = ("sizes", "band weights", None, "sites", "centres", "parent anchors", "child anchors")
    body = eqx.tree_at(leaves, body, tuple(axes if n is None else parts[n] for n in names))
    points = eqx.tree_at(lambda p: (p.xyz, p.weight), points, (parts["points"], parts["measurement weights"]))
    features = eqx.tree_at(lambda f: (f.weight, f.origin), features, (parts["feature weights"], parts["ray origins"]))
    numbers = parts["ratio"], parts["prior"], parts["robust scale"]
    options = eqx.tree_at(lambda o: (o.ratio, o.prior, o.match.robust_scale), options, numbers)
    return Problem.build(body, points, Poses(start.rotation, parts["prediction"]), options, features)


@pytest.mark.parametrize("solver", ["coupled", pytest.param("per_limb", marks=slow)])
def test_gradient_triple(x64, solver):
    """Reverse, forward, unrolled and central differences agree to 1e-4 for every group of parameters."""
    world = scene(jnp.float64, solver=solver)
    start, parts = world[3], parts_of(*world)
    target = random_like(np.random.default_rng(6), start)

    def implicit(parts):
        found = solution(start, built(parts, *world), tolerance=1e-9)
        return dot(found.poses, target), found

    def unrolled(parts):
        return dot(solve_frame(start, built(parts, *world), kind="checkpointed", capacity=100).poses, target)

    reverse, found = jax.jit(jax.grad(implicit, has_aux=True))(parts)
    assert found.converged and found.off < 1e-9
    other = jax.jit(jax.grad(unrolled))(parts)
    assert all_finite(reverse)
    rng = np.random.default_rng(7)
    # value and derivative by one program: to compile another one for the value alone takes ten times as long as to run
    forward = jax.jit(lambda parts, d: jax.jvp(implicit, (parts,), (d,), has_aux=True)[:2])
    for name in parts:
        along = random_like(rng, parts[name])
        along = along / jnp.linalg.norm(along)
        direction = {n: along if n == name else jnp.zeros_like(v) for n, v in parts.items()}
        numeric = central_difference(lambda at, d=direction: forward(at, d)[0], parts, direction, 1e-6)
        assert abs(numeric) > 1e-7, name
        for value in (dot(reverse[name], along), forward(parts, direction)[1], dot(other[name], along)):
            np.testing.assert_allclose(value, numeric, rtol=1e-4, atol=1e-8, err_msg=name)


@pytest.mark.parametrize("solver", ["coupled", "per_limb"])
def test_rest_is_where_a_step_rests(x64, solver):
    world = scene(jnp.float64, solver=solver)
    problem = built(parts_of(*world), *world)
    poses = jax.jit(lambda: solution(world[3], problem, tolerance=1e-9).poses)()
    there, _ = jax.jit(icp_step)(poses, problem)
    np.testing.assert_allclose(there.translation, poses.translation, atol=1e-9)
    force = jax.jit(lambda poses: balance(poses, problem, choices(poses, problem)))(poses)
    np.testing.assert_allclose(force, 0.0, atol=1e-7)


def test_slope_is_that_of_the_balance(x64):
    """Six directions for all limbs at once give what one direction at a time gives."""
    world = scene(jnp.float64)
    problem = built(parts_of(*world), *world)
    poses = world[3]
    limbs = jax.jit(choices)(poses, problem)
    slope, force = jax.jit(balance_slope)(poses, problem, limbs)
    whole, here = jax.jit(
        lambda t: (jax.jacfwd(lambda t: balance(moved(poses, t), problem, limbs))(t), balance(poses, problem, limbs))
    )(jnp.zeros((2, 6)))
    np.testing.assert_allclose(slope, whole.reshape(12, 12), atol=1e-7 * np.abs(whole).max())
    np.testing.assert_allclose(force, here, atol=1e-10)


@pytest.mark.parametrize("overlap", ["shared", "soft", pytest.param("adjacent", marks=slow)])
def test_other_overlap_rules(x64, overlap):
    world = scene(jnp.float64, overlap=overlap)
    start, parts = world[3], parts_of(*world)
    target = random_like(np.random.default_rng(6), start)
    implicit = lambda sizes: dot(solution(start, built(parts | {"sizes": sizes}, *world), tolerance=1e-9).poses, target)  # noqa: E731
    both = jax.jit(jax.value_and_grad(implicit))
    along = random_like(np.random.default_rng(7), parts["sizes"]) * 0.1
    numeric = central_difference(lambda sizes: both(sizes)[0], parts["sizes"], along, 1e-6)
    np.testing.assert_allclose(dot(both(parts["sizes"])[1], along), numeric, rtol=1e-4)


@jax.jit
def cloud_gradient(xyz, weight, world):
    body, points, features, start, options = world

    def loss(sizes, xyz):
        own = eqx.tree_at(lambda b: b.sizes, body, sizes)
        there = eqx.tree_at(lambda p: (p.xyz, p.weight), points, (xyz, weight))
        found = solution(start, Problem.build(own, there, start, options))
        return jnp.sum(jnp.sin(found.poses.rotation)) + jnp.sum(found.poses.translation**2), found

    return jax.grad(loss, (0, 1), has_aux=True)(body.sizes, xyz)


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_nine_clouds_stay_finite(request, name, dtype):
    """Points that determine nothing: the weak pairs to the prediction do, and every derivative is a number."""
    if dtype == jnp.float64:
        request.getfixturevalue("x64")
    world = scene(dtype, prior=0.003, max_steps=20)
    xyz, weight = np.zeros((120, 3)), np.zeros(120)
    xyz[: len(CLOUDS[name])] = 0.1 * CLOUDS[name] + [0.05, 0, 0.2]
    weight[: len(CLOUDS[name])] = 1
    gradient, found = cloud_gradient(jnp.asarray(xyz, dtype), jnp.asarray(weight, dtype), world)
    assert all_finite((gradient, found.poses, found.off))


def test_says_when_it_is_not_at_rest(x64):
    world = scene(jnp.float64, max_steps=1)
    far = turned(np.random.default_rng(1), world[3], 0.1, 20)
    problem = built(parts_of(*world), *world)
    assert not jax.jit(lambda: solution(far, problem, newton=0, tolerance=1e-6).converged)()
    loose = eqx.tree_at(lambda p: p.options.prior, problem, jnp.zeros(()))
    at = world[0].rest

    def weakest(problem):  # how well the worst direction is determined: round limbs roll about their axes
        slope, _ = balance_slope(at, problem, choices(at, problem))
        return jnp.linalg.svd(slope, compute_uv=False)[-1] / total_weight(problem)

    assert jax.jit(weakest)(loose) < 1e-4 < 1e-2 < jax.jit(weakest)(problem)
