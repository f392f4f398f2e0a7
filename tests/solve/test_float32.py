"""Single precision as in the product: far from the origin the same tracks, and never NaN (docs/numerics.md#float32)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.helpers import all_finite, cast, frame_points, icp_options, seen_points, turned
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body_file import load_body
from voodoo_jax.solve.frame import solve_frame
from voodoo_jax.solve.pulls import Problem

SENSOR = (1.5, 1.5, 0.9)


@pytest.mark.parametrize("solver", ["coupled", "per_limb"])
def test_a_hundred_metres_away(solver):
    """At 100 m single precision resolves 0.008 mm; what is found agrees to 0.5 mm and 0.1 degrees."""
    rng = np.random.default_rng(0)
    body = load_body("arm")
    xyz = seen_points(rng, body, body.rest, SENSOR, 300)
    start = turned(rng, body.rest, 0.02, 3)
    options = icp_options(solver=solver, epsilon=0.0, max_steps=10)

    @jax.jit
    def solve(points, start):
        return solve_frame(start, Problem.build(body, points, start, options)).poses

    found = []
    for shift in (np.zeros(3), np.array([100.0, -100.0, 10.0])):
        moved = Poses(start.rotation, start.translation + jnp.asarray(shift, jnp.float32))
        poses = solve(frame_points(xyz + shift, [np.array(SENSOR) + shift]), cast(moved, jnp.float32))
        assert poses.translation.dtype == jnp.float32 and all_finite(poses)
        found.append((np.asarray(poses.rotation), np.asarray(poses.translation, np.float64) - shift))
    np.testing.assert_allclose(found[1][1], found[0][1], atol=5e-4)
    assert np.abs(np.sum(found[0][0] * found[1][0], -1)).min() > np.cos(np.radians(0.1) / 2) - 1e-6
