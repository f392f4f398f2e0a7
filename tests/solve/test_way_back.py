"""What the derivative of a step uses in place of what the step itself does: the same numbers in another form."""

import jax
import jax.numpy as jnp
import numpy as np

from tests.support.helpers import cast, frame_points, icp_options, random_like, seen_points, turned, two_limbs
from voodoo_jax.solve.frame import icp_step
from voodoo_jax.solve.pulls import Problem

SENSOR = (2.0, 0.4, 0.5)


def scene(**changes):
    """A body somewhere, points on it, and options."""
    rng = np.random.default_rng(8)
    body = cast(two_limbs((0.03, 0.02)), jnp.float64)
    # some of the points belong to no limb
    seen = np.concatenate([seen_points(rng, body, body.rest, SENSOR, 80), rng.uniform(2, 3, (5, 3))])
    points = frame_points(seen, [SENSOR], jnp.float64, capacity=90)
    return rng, body, points, turned(rng, body.rest, 0.01, 5), icp_options(jnp.float64, **changes)


def test_step_has_the_derivative_of_its_value(x64):
    """Forward mode of a single step against central differences: cuts and the solve's own derivative are exact."""
    rng, body, points, start, options = scene(max_distance=1.0)
    problem = Problem.build(body, points, start, options)
    step = jax.jit(lambda poses: icp_step(poses, problem)[0].translation)
    along = random_like(rng, start)
    move = lambda by: jax.tree.map(lambda x, d: x + by * d, start, along)  # noqa: E731
    numeric = (step(move(1e-6)) - step(move(-1e-6))) / 2e-6
    found = jax.jit(lambda: jax.jvp(lambda poses: icp_step(poses, problem)[0].translation, (start,), (along,))[1])()
    np.testing.assert_allclose(found, numeric, rtol=1e-5, atol=1e-7)
