"""Quaternions against an independent library, and their derivatives where formulas have holes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.support.helpers import random_rotations, scipy_rotation
from voodoo_jax.geometry import rigid
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.geometry.rotations import shortest_turns

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

numbers = st.floats(-3, 3, width=32).map(lambda x: 0.0 if abs(x) < 1e-6 else x)
vectors = st.lists(numbers, min_size=3, max_size=3).map(lambda v: np.array(v, np.float32))


def test_against_scipy(rng):
    p, q = (random_rotations(rng, 50).astype(np.float32) for _ in range(2))
    v = rng.normal(size=(50, 3)).astype(np.float32)
    both = scipy_rotation(p) * scipy_rotation(q)
    np.testing.assert_allclose(rigid.matrix(rigid.quat_multiply(p, q)), both.as_matrix(), atol=2e-6)
    np.testing.assert_allclose(rigid.rotate(p, v), scipy_rotation(p).apply(v), atol=2e-6)
    np.testing.assert_allclose(rigid.unrotate(p, v), scipy_rotation(p).inv().apply(v), atol=2e-6)
    np.testing.assert_allclose(rigid.quat_log(p), scipy_rotation(p).as_rotvec(), atol=1e-5)


def test_shortest_turns(rng):
    """Against scipy's alignment of two vectors; opposite directions turn by half a turn, a zero vector by nothing."""
    a, b = rng.normal(size=(2, 20, 3))
    b[0], b[1] = -2 * a[0], [0, 0, -1.0]
    a[1], a[2] = [0, 0, 3.0], 0.0
    turns = shortest_turns(a, b)
    for turn, u, v in zip(turns[3:], a[3:], b[3:]):
        assert (turn * Rotation.align_vectors(v[None], u[None])[0].inv()).magnitude() == pytest.approx(0, abs=1e-6)
    np.testing.assert_allclose(turns.magnitude()[:3], [np.pi, np.pi, 0.0])
    np.testing.assert_allclose(turns[0].apply(a[0]), -a[0], atol=1e-9)
    assert shortest_turns(np.zeros((0, 3)), np.zeros((0, 3))).as_matrix().shape == (0, 3, 3)


def test_compose_and_inverse(rng):
    a, b = (
        Poses(jnp.asarray(random_rotations(rng, 20), jnp.float32), jnp.asarray(rng.normal(size=(20, 3)), jnp.float32))
        for _ in range(2)
    )
    points = jnp.asarray(rng.normal(size=(20, 3)), jnp.float32)
    twice = rigid.apply(a, rigid.apply(b, points))
    np.testing.assert_allclose(rigid.apply(rigid.compose(a, b), points), twice, atol=5e-6)
    np.testing.assert_allclose(rigid.apply(rigid.inverse(a), rigid.apply(a, points)), points, atol=5e-6)
    np.testing.assert_array_equal(a[3].rotation, a.rotation[3])


@settings(max_examples=60, deadline=None)
@given(vectors)
def test_exp_against_scipy_and_back(r):
    q = rigid.quat_exp(r)
    np.testing.assert_allclose(rigid.matrix(q), Rotation.from_rotvec(r).as_matrix(), atol=2e-6)
    if np.linalg.norm(r) < 3.1:  # beyond half a turn the way back is the shorter one
        np.testing.assert_allclose(rigid.quat_log(q), r, atol=2e-5)
        np.testing.assert_allclose(rigid.quat_log(-q), r, atol=2e-5)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 9e-5, 1.1e-4, 1e-3, 1.0, 3.1])
def test_derivatives_of_exp_and_log(x64, angle):
    r = jnp.array([0.6, 0.0, -0.8]) * angle
    there, back = jax.jacrev(rigid.quat_exp)(r), jax.jacfwd(rigid.quat_log)(rigid.quat_exp(r))
    np.testing.assert_allclose(back @ there, np.eye(3), atol=1e-8)
    for i, e in enumerate(np.eye(3)):
        numeric = (rigid.quat_exp(r + 1e-6 * e) - rigid.quat_exp(r - 1e-6 * e)) / 2e-6
        np.testing.assert_allclose(there[:, i], numeric, atol=1e-8)


def test_normalize():
    q = jnp.array([[0.0, 0.0, 0.0, 0.0], [3.0, 0.0, 4.0, 0.0], [1e-12, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(rigid.quat_normalize(q), [[1, 0, 0, 0], [0.6, 0, 0.8, 0], [1, 0, 0, 0]], atol=1e-7)
    assert np.isfinite(jax.jacrev(rigid.quat_normalize)(q)).all()


def test_log_of_half_a_turn_is_finite():
    for q in np.eye(4, dtype=np.float32):
        assert np.isfinite(jax.jacrev(rigid.quat_log)(jnp.asarray(q))).all()
        assert np.isclose(np.linalg.norm(rigid.quat_log(q)), 0 if q[0] else np.pi, atol=1e-6)
