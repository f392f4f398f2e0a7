"""The flexible body keeps its lengths, swings and rests like a physical one, stays within its limits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import voodoo_jax as vj
from voodoo_jax.trackers.base import Unsuitable
from voodoo_jax.trackers.flexible.cylinders import surface_distance
from voodoo_jax.trackers.flexible.filters import refined
from voodoo_jax.trackers.flexible.flexible_body import ENDS, LIMBS, SPRINGS, FlexibleBody, flexible_body, rest_points
from voodoo_jax.trackers.flexible.physics import (
    LEGS_NEAR,
    frames,
    inverse_masses,
    length,
    relax,
    separate_legs,
    verlet,
)
from voodoo_jax.trackers.flexible.vectors import vectors

GRAVITY = np.array([0.0, 0.0, -9.81], np.float32)
PULL = jnp.broadcast_to(jnp.asarray(GRAVITY), (16, 3))
BODY = flexible_body(vj.human(), 1.75)
SPRING_LENGTHS = jax.jit(lambda x: length(x[ENDS[:, 1]] - x[ENDS[:, 0]])[:, 0])


def shaken(size: float, seed: int = 0) -> jax.Array:
    return BODY.rest + size * jax.random.normal(jax.random.key(seed), (16, 3))


def energy(body: FlexibleBody, x: jax.Array, before: jax.Array, dt: float, gravity: float = 9.81) -> jax.Array:
    """Kinetic and potential energy of the points that can move, relative masses times square metres per square second.
    Heights along z."""
    m = jnp.where(jnp.isinf(body.masses), 0.0, body.masses)
    speed = (x - before) / dt
    return jnp.sum(m * (0.5 * jnp.sum(speed**2, -1) + gravity * (x[:, 2] + before[:, 2]) / 2))


def test_it_has_the_papers_points_and_springs():
    assert BODY.rest.shape == (16, 3) and len(SPRINGS) == 24 and sorted(LIMBS.ravel().tolist())[0] == 2
    np.testing.assert_allclose(SPRING_LENGTHS(BODY.rest), BODY.lengths, atol=1e-4)
    with pytest.raises(Unsuitable, match="--tracker icp"):
        rest_points(vj.load_body("dog"))


def test_relaxation_gives_all_springs_their_lengths_and_moves_nothing_infinitely_heavy():
    x = jax.jit(lambda x: relax(BODY, x, BODY.masses, 200, limits=False))(shaken(0.05))
    np.testing.assert_allclose(SPRING_LENGTHS(x), BODY.lengths, atol=3e-3)
    np.testing.assert_array_equal(x[0], shaken(0.05)[0])
    one = relax(BODY, BODY.rest, jnp.ones(16), 1, limits=False)
    np.testing.assert_allclose(one, BODY.rest, atol=1e-5)


def test_a_single_pendulum_has_the_period_of_one():
    """A wrist that hangs on a fixed elbow: T = 2 pi sqrt(l / g), the small angle's."""
    masses = jnp.full(16, jnp.inf).at[4].set(1.0)
    arm, dt = float(BODY.lengths[1]), 0.002
    x = BODY.rest.at[4].set(BODY.rest[3] + arm * jnp.array([jnp.sin(0.1), 0.0, -jnp.cos(0.1)]))

    def one(carry, _):
        x, before = carry
        moved = jnp.where((jnp.arange(16) == 4)[:, None], verlet(x, before, PULL, jnp.asarray(dt)), x)
        new = relax(BODY, moved, masses, 2, limits=False)
        return (new, x), new[4, 0] - new[3, 0]

    swing = np.asarray(jax.jit(lambda: jax.lax.scan(one, (x, x), None, 1500))()[1])
    down = np.flatnonzero((swing[:-1] > 0) & (swing[1:] <= 0))
    assert np.diff(down)[0] * dt == pytest.approx(2 * np.pi * np.sqrt(arm / 9.81), rel=0.02)
    assert 0.9 < np.abs(swing[-500:]).max() / np.abs(swing[:500]).max() < 1.1


@pytest.mark.parametrize("dt", [1 / 200, 1 / 30, 0.2])
def test_dangling_loses_energy_and_never_explodes(dt):
    """0.2 s is the longest step that the tracker takes, 0.2 m far more noise than its filters make."""

    def one(carry, _):
        x, before = carry
        free = inverse_masses(BODY.masses)[:, None] > 0
        moved = jnp.where(free, verlet(x, before, PULL, jnp.asarray(dt), 0.1), x)
        new = relax(BODY, moved, BODY.masses, 6)
        return (new, x), energy(BODY, new, x, dt)

    begin = shaken(0.2)
    (x, before), e = jax.jit(lambda: jax.lax.scan(one, (begin, begin), None, 300))()
    assert np.isfinite(np.asarray(x)).all() and np.abs(x - begin[0]).max() < 2.5
    assert np.asarray(e)[-30:].mean() < np.asarray(e)[:5].max()
    assert np.abs(np.asarray(x[2:] - before[2:])).max() < 0.05 * max(1.0, dt * 30)
    assert float(SPRING_LENGTHS(x)[:8].max() / BODY.lengths[:8].max()) < 1.6


def test_limits_are_kept():
    for seed in range(4):
        x = jax.jit(lambda x: relax(BODY, x, BODY.masses, 60, 0.02))(shaken(0.25, seed))
        f = frames(x)
        for root, middle, end in LIMBS[2:]:
            thigh = np.asarray(x[middle] - x[root]) / float(length(x[middle] - x[root])[0])
            assert thigh @ np.asarray(f.lower[0]) > -0.70  # a thigh hardly goes backward
            assert float(length(x[end] - x[root])[0]) > 0.2
        across = np.asarray((x[jnp.array([11, 12])] - f.middle) @ f.lower[1])
        other = np.asarray((x[jnp.array([14, 15])] - f.middle) @ f.lower[1])
        assert across.min() > 0.0 > other.max()  # each leg on its own side
        trunk = np.asarray((x[jnp.array([4, 7])] - f.middle) @ f.upper.T)
        inside = (
            (np.abs(trunk[:, 0]) < 0.03) & (np.abs(trunk[:, 1]) < 0.08) & (trunk[:, 2] > 0.05) & (trunk[:, 2] < 0.4)
        )
        assert not inside.any()  # no wrist in the torso


def test_a_trunk_does_not_fold_at_the_waist():
    """Hips pushed towards the neck go back to where a bowed spine holds them; the springs alone leave them there."""
    folded = BODY.rest.at[8:].add(jnp.array([-0.05, 0.0, 0.15]))
    span = lambda x: float(jnp.linalg.norm(x[1] - (x[10] + x[13]) / 2))  # noqa: E731
    upright = span(BODY.rest)
    assert span(folded) < 0.8 * upright
    assert span(jax.jit(lambda x: relax(BODY, x, BODY.masses, 6))(folded)) > 0.9 * upright


def test_legs_have_room_beside_each_other_and_may_cross_one_before_the_other():
    inside = BODY.rest.at[jnp.array([14, 15])].set(BODY.rest[jnp.array([11, 12])] + jnp.array([0.03, 0.0, 0.0]))
    apart = lambda x: separate_legs(vectors(x), jnp.ones(16), LEGS_NEAR * BODY.stature).stacked()  # noqa: E731
    moved = apart(inside)
    for left, right, least in ((11, 14, 0.075), (12, 15, 0.058)):
        assert float(jnp.linalg.norm(moved[left] - moved[right])) == pytest.approx(least * 1.75, abs=1e-3)
        assert float(moved[left, 1] - moved[right, 1]) > 0.05
    ahead = BODY.rest.at[jnp.array([14, 15])].set(BODY.rest[jnp.array([11, 12])] + jnp.array([0.3, 0.05, 0.0]))
    np.testing.assert_array_equal(apart(ahead), ahead)


def test_points_pull_a_displaced_body_back_and_gradients_pass():
    """Points on the body's own surface; the gradient of the result by the stature agrees with differences."""
    rng = np.random.default_rng(3)
    cloud = np.asarray(BODY.rest)[rng.integers(0, 16, 3000)] + rng.normal(0, 0.12, (3000, 3))
    d = np.asarray(surface_distance(BODY, BODY.rest, vectors(np.float32(cloud))))
    points = jnp.asarray(cloud[np.abs(d).min(0) < 0.006], jnp.float32)
    assert len(points) > 100
    share = jnp.ones(len(points))
    begin = BODY.rest + jnp.array([0.06, 0.0, 0.03])
    again = jax.jit(lambda body, x: refined(body, x, points, share, 16))
    off = lambda x: float(jnp.abs(x - BODY.rest).mean())  # noqa: E731
    assert off(again(BODY, begin)) < 0.5 * off(begin)
    by_radius = lambda r: jnp.sum(again(eqx.tree_at(lambda b: b.radii, BODY, BODY.radii * r), begin))  # noqa: E731
    slope = float(jax.grad(by_radius)(1.0))
    assert np.isfinite(slope) and slope != 0


def test_gradients_through_relaxation_are_the_differences():
    begin = shaken(0.03)

    def loss(scale):
        body = eqx.tree_at(lambda b: b.lengths, BODY, BODY.lengths * scale)
        return jnp.mean((relax(body, begin, body.masses, 8) - BODY.rest) ** 2) * 1e4

    value = jax.jit(loss)
    slope = float(jax.jit(jax.grad(loss))(1.05))
    assert slope == pytest.approx((float(value(1.052)) - float(value(1.048))) / 0.004, rel=0.05)
