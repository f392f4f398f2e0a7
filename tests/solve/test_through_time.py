"""Gradients through whole tracking: no NaN, equal to differences, in both modes, mapped over bodies and recordings."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.helpers import SOLVE, TWO_LIMBS_SENSOR, all_finite, cast, central_difference, seen_points, two_limbs
from voodoo_jax.config.options import TrackSettings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.kernels.correspondences import Points
from voodoo_jax.solve.implicit import AT_REST
from voodoo_jax.solve.scan import at_rest, options_from
from voodoo_jax.solve.through_time import Measurements, track_through

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

FRAMES, POINTS = 5, 40  # the last frame is padding
BODY = two_limbs((0.03, 0.0))
NUMBERS = "thigh", "weight", "damping", "ratio", "steady", "prior"


def recording(rng, dtype=jnp.float32) -> Measurements:
    """Two limbs that go to one side, seen by one sensor; the last frame is padding."""
    xyz = seen_points(rng, BODY, BODY.rest, TWO_LIMBS_SENSOR[0], POINTS)
    moving = np.stack([xyz + [0.0, 0.01 * k, 0.0] + 0.003 * rng.normal(size=xyz.shape) for k in range(FRAMES)])
    valid = np.arange(FRAMES) < FRAMES - 1
    sensor, origins = np.zeros((FRAMES, POINTS), np.int32), np.tile(TWO_LIMBS_SENSOR, (FRAMES, 1, 1))
    weight = np.broadcast_to(valid[:, None], (FRAMES, POINTS)) * 1.0
    array = lambda x: jnp.asarray(x, dtype)  # noqa: E731
    points = Points(array(moving), array(weight), jnp.asarray(sensor), array(origins))
    return Measurements(points, array(np.where(np.arange(FRAMES) > 0, 0.033, 0.0)), jnp.asarray(valid), None)


def tracked(numbers, sizes, measured):
    """All frames by a few numbers (logarithms of factors) and all sizes of the body."""
    dtype = sizes.dtype
    thigh, weight, damping, ratio, steady, prior = jnp.exp(numbers)
    solve = replace(SOLVE, steady=2.0, prior=0.003)
    body, options = cast((BODY, options_from(solve, TrackSettings())), dtype)
    start = at_rest(Poses(body.rest.rotation, body.rest.translation))
    leaves = lambda b: (b.sizes, b.weights)  # noqa: E731
    body = eqx.tree_at(leaves, body, (sizes.at[0, 4].multiply(thigh), body.weights * weight))
    leaves = lambda o: (o.damping, o.icp.ratio, o.icp.steady, o.icp.prior)  # noqa: E731
    by = zip(leaves(options), (damping, ratio, steady, prior))
    tolerance = 1e-9 if dtype == jnp.float64 else AT_REST
    options = eqx.tree_at(leaves, options, tuple(x * f for x, f in by))
    return track_through(body, options, start, measured, tolerance)


def moves(numbers, sizes, measured):
    """A number that all joints of all frames decide, and what was tracked."""
    found = tracked(numbers, sizes, measured)
    there = jnp.where(found.converged[:, None, None], found.poses.translation, 0.0)
    return jnp.sum(jnp.sin(jnp.arange(there.size, dtype=there.dtype).reshape(there.shape)) * there), found


@jax.jit
def both(numbers, sizes, measured):
    return jax.value_and_grad(moves, (0, 1), has_aux=True)(numbers, sizes, measured)


def test_against_differences_and_forward_mode(x64, rng):
    measured = recording(rng, jnp.float64)
    sizes, zero = cast(BODY.sizes, jnp.float64), jnp.zeros(len(NUMBERS))
    (_, found), (gradient, _) = both(zero, sizes, measured)
    assert found.converged[:-1].all()
    forward = jax.jit(jax.jacfwd(lambda n: moves(n, sizes, measured)[0]))(zero)
    np.testing.assert_allclose(gradient, forward, rtol=1e-6, atol=1e-9)
    same = lambda other: not np.any(jax.vmap(lambda a, b: a.differs(b))(found.chosen, other.chosen)[:-1])  # noqa: E731
    for k, name in enumerate(NUMBERS):
        at = [both(zero.at[k].set(step), sizes, measured)[0][1] for step in (1e-6, -1e-6)]
        assert all(map(same, at)), f"{name}: a correspondence changes"
        numeric = central_difference(lambda n: both(n, sizes, measured)[0][0], zero, jnp.eye(len(NUMBERS))[k], 1e-6)
        assert abs(numeric) > 1e-8, name
        np.testing.assert_allclose(gradient[k], numeric, rtol=2e-3, err_msg=name)


def test_no_number_is_none_for_any_finite_input(rng):
    """1,000 draws: sizes of any kind, points near and far, some or no frames and points, numbers far off."""
    base, count = jax.tree.map(lambda leaf: leaf[:2], recording(rng)), 1000
    draws = []
    for _ in range(count):
        kind = rng.integers(5)
        spread = (0.02, 0.3, 3.0, 1e3, 1e6)[kind]
        xyz = np.asarray(base.points.xyz) + spread * rng.normal(size=base.points.xyz.shape)
        weight = (rng.random((2, 1)) < 0.7) * (rng.random((2, POINTS)) < rng.choice([0.0, 0.05, 1.0]))
        sizes = np.asarray(BODY.sizes) * np.exp(rng.choice([0.1, 1.0]) * rng.normal(size=BODY.sizes.shape))
        valid, seconds = rng.random(2) < 0.8, rng.choice([0.0, 0.033, 1.0], 2)
        numbers = rng.choice([0.0, 0.3, 3.0]) * rng.normal(size=len(NUMBERS))
        draws.append([np.float32(x) for x in (numbers, sizes, xyz, weight, seconds)] + [valid])
    stacked = [jnp.stack([jnp.asarray(d[k]) for d in draws]) for k in range(6)]

    @jax.jit
    def finite(draws):
        def one(draw):
            numbers, sizes, xyz, weight, seconds, valid = draw
            points = eqx.tree_at(lambda p: (p.xyz, p.weight), base.points, (xyz, weight))
            value, gradient = jax.value_and_grad(lambda *a: moves(*a)[0], (0, 1))(
                numbers, sizes, Measurements(points, seconds, valid, None)
            )
            return jnp.array([jnp.all(jnp.isfinite(leaf)) for leaf in (value, *gradient)])

        return jax.lax.map(one, draws)

    bad = np.flatnonzero(~np.asarray(finite(stacked)).all(1))
    assert not len(bad), f"{len(bad)} of {count} draws, the first: {bad[:5]}"


def test_mapped_over_bodies_and_recordings(rng):
    some = [recording(np.random.default_rng(k)) for k in range(2)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *some)
    sizes = jnp.stack([BODY.sizes, BODY.sizes * 1.02])
    zero = jnp.zeros(len(NUMBERS))
    one = lambda s, m: tracked(zero, s, m)  # noqa: E731
    mapped = jax.jit(jax.vmap(jax.vmap(one, (None, 0)), (0, None)))(sizes, stacked)
    assert all_finite(mapped.poses)
    for i in range(2):
        for k in range(2):
            alone = both(zero, sizes[i], some[k])[0][1]
            np.testing.assert_allclose(mapped.poses.translation[i, k], alone.poses.translation, atol=2e-4)
