"""The implicit derivative of a frame's solution: optimistix' with its ImplicitAdjoint, this package's
and central differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.fixed_point import solve_fixed_point
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
from voodoo_jax.kernels.correspondences import Points
from voodoo_jax.solve.implicit import solution
from voodoo_jax.solve.pulls import Problem

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

SENSOR = (2.0, 0.4, 0.5)


@pytest.fixture
def scene(x64):
    rng = np.random.default_rng(5)
    body = cast(two_limbs((0.03, 0.0)), jnp.float64)
    xyz = seen_points(rng, body, body.rest, SENSOR, 120)
    start = turned(rng, body.rest, 0.01, 2)
    # a prior that determines every direction (docs/numerics.md#null-directions)
    options = icp_options(jnp.float64, solver="coupled", epsilon=0.0, max_steps=100, prior=2.0, max_distance=1.0)
    return body, frame_points(xyz, [SENSOR], jnp.float64), start, options, random_like(rng, start)


def problem(scene, parts):
    body, points, start, options, _ = scene
    sizes, weights, xyz = parts
    changed = eqx.tree_at(lambda b: (b.sizes, b.weights), body, (sizes, weights))
    return Problem.build(changed, Points(xyz, points.weight, points.sensor, points.origins), start, options)


def test_gradient_triple(scene):
    body, points, start, _, target = scene
    parts = body.sizes, body.weights, points.xyz

    def implicit(parts):
        found = solve_fixed_point(start, problem(scene, parts), tolerance=1e-12, max_steps=400)
        return dot(found.poses, target), found.converged

    def own(parts):
        found = solution(start, problem(scene, parts), tolerance=1e-12)
        return dot(found.poses, target), found.converged

    # one program for values and derivative: each takes ten times as long to compile as to run
    both = jax.jit(jax.value_and_grad(implicit, has_aux=True))
    (value, converged), gradient = both(parts)
    (other, rests), second = jax.jit(jax.value_and_grad(own, has_aux=True))(parts)
    np.testing.assert_allclose(value, other, atol=1e-10)
    for a, b in zip(gradient, second):
        np.testing.assert_allclose(a, b, atol=1e-10 * float(jnp.abs(a).max()))
    assert bool(converged) and bool(rests)
    assert all_finite(gradient)
    rng = np.random.default_rng(6)
    for part, (a, b) in enumerate(zip(gradient, second)):
        direction = random_like(rng, a)
        direction = direction / jnp.linalg.norm(direction)
        along = tuple(direction if i == part else jnp.zeros_like(x) for i, x in enumerate(parts))
        numeric = central_difference(lambda at: both(at)[0][0], parts, along, 1e-6)
        assert abs(numeric) > 1e-6
        np.testing.assert_allclose(dot(a, direction), numeric, rtol=1e-4, atol=1e-8)
        np.testing.assert_allclose(dot(b, direction), numeric, rtol=1e-4, atol=1e-8)


def test_says_when_it_did_not_converge(scene):
    body, points, start, _, _ = scene
    here = problem(scene, (body.sizes, body.weights, points.xyz))
    few = solve_fixed_point(start, here, tolerance=1e-13, max_steps=2)
    many = solve_fixed_point(start, here, tolerance=1e-10)
    assert not bool(few.converged) and bool(many.converged) and int(many.steps) > 2
