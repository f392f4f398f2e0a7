"""What the derivative of a step uses in place of what the step itself does: the same numbers in another form."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers import cast, frame_points, icp_options, random_like, seen_points, turned, two_limbs

from voodoo_jax.body import bands
from voodoo_jax.icp import Problem, adjacency, icp_step
from voodoo_jax.kernels.correspond import match, match_assigned, moments, settled_sums, sums
from voodoo_jax.kernels.coupled import coupled_normals, coupled_product, pair_normals

SENSOR = (2.0, 0.4, 0.5)


def scene(**changes):
    """A body somewhere, points on it, and options."""
    rng = np.random.default_rng(8)
    body = cast(two_limbs((0.03, 0.02)), jnp.float64)
    # some of the points belong to no limb
    seen = np.concatenate([seen_points(rng, body, body.rest, SENSOR, 80), rng.uniform(2, 3, (5, 3))])
    points = frame_points(seen, [SENSOR], jnp.float64, capacity=90)
    return rng, body, points, turned(rng, body.rest, 0.01, 5), icp_options(jnp.float64, **changes)


def test_product_is_that_of_the_matrix(x64):
    rng, body, points, poses, options = scene()

    @jax.jit
    def both(strength, damping, twist):
        sums = moments(match(body.sizes, poses, points, adjacency(body.topology), options.match, body.present))
        normals, rhs = jax.vmap(pair_normals)(*sums)
        links = (bands(body), bands(body))
        full, _ = coupled_normals(links, poses, normals, rhs, strength, damping)
        found = coupled_product(links, poses, normals, strength, damping, twist)
        return found, jnp.matmul(full, twist.reshape(-1)).reshape(twist.shape)

    found, expected = both(jnp.array([30.0, 50.0]), jnp.array(0.1), random_like(rng, jnp.zeros((2, 6))))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_sums_of_settled_pairs_are_those_of_the_match(x64):
    _, body, points, poses, options = scene()

    @jax.jit
    def both():
        found = match(body.sizes, poses, points, adjacency(body.topology), options.match, body.present)
        again = match_assigned(body.sizes, poses, points, found.limb, options.match)
        return found.limb, sums(found), settled_sums(again, found.limb, 2, options.match)

    limb, expected, found = both()
    assert set(np.asarray(limb)) == {0, 1, 2}
    for a, b in zip(found, expected):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-15)


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
