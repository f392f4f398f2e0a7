"""Boxes against meshes, and the three rules for points in several boxes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.helpers import frustum_mesh, random_rotations, scipy_rotation, two_limbs
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.kernels.bounding_boxes import body_box, in_box, in_limb_box, resolve_overlap
from voodoo_jax.model.body_file import BUILT_IN, load_body
from voodoo_jax.solve.pulls import adjacency


@pytest.mark.parametrize("name", BUILT_IN)
def test_body_box_against_meshes(rng, name):
    sizes = np.asarray(load_body(name).sizes)
    rotations, places = random_rotations(rng, len(sizes)), rng.normal(size=(len(sizes), 3))
    corners = []
    for size, q, t in zip(sizes, rotations, places):
        corners += list(scipy_rotation(q).apply(frustum_mesh(size, around=256, along=1).vertices) + t)
    poses = Poses(jnp.asarray(rotations, jnp.float32), jnp.asarray(places, jnp.float32))
    low, high = jax.jit(body_box)(jnp.asarray(sizes), poses, jnp.asarray(0.2))
    np.testing.assert_allclose(low, np.min(corners, 0) - 0.2, atol=3e-5)
    np.testing.assert_allclose(high, np.max(corners, 0) + 0.2, atol=3e-5)


def test_limb_box_and_box(rng):
    size = np.array([0.1, 0.05, 0.06, 0.08, 0.3])
    points = rng.uniform(-0.5, 0.5, (2000, 3)).astype(np.float32)
    low, high = frustum_mesh(size).bounds + np.array([[-0.1], [0.1]])
    expected = np.all((points >= low) & (points <= high), -1)
    args = jnp.asarray(size, jnp.float32), *jnp.asarray(points).T, jnp.asarray(0.1)
    np.testing.assert_array_equal(in_limb_box(*args), expected)
    corners = jnp.asarray(low, jnp.float32), jnp.asarray(high, jnp.float32)
    np.testing.assert_array_equal(in_box(*corners, jnp.asarray(points)), expected)
    assert 10 < expected.sum() < 1990


CHAIN = np.array([[1, 1, 0], [1, 1, 1], [0, 1, 1]], bool)  # limbs 0 - 1 - 2


@pytest.mark.parametrize(
    "rule,expected",
    [
        ("exclusive", [[1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0, 0, 1, 0, 0]]),
        ("adjacent", [[1, 1, 0, 0, 0], [1, 1, 0, 0, 0], [0, 1, 1, 0, 0]]),
        ("shared", [[1, 1, 1, 0, 0], [1, 1, 0, 0, 0], [1, 1, 1, 0, 0]]),
    ],
)
def test_rules_by_hand(rule, expected):
    candidate = np.array([[1, 1, 1, 0, 0], [1, 1, 0, 0, 0], [1, 1, 1, 0, 0]], bool)
    # signed: deep inside wins over a little inside and over outside; limbs that are no candidate never win
    distance = np.array([[-0.2, 0.1, 0.3, 0.0, -1], [0.1, -0.3, -9.0, 0.0, -1], [0.2, 0.0, 0.2, 0.0, -1]])
    found = resolve_overlap(rule, jnp.asarray(candidate), jnp.asarray(distance, jnp.float32), jnp.asarray(CHAIN))
    np.testing.assert_array_equal(found, np.array(expected, bool))


@pytest.mark.parametrize("name", ["human", "dog"])
def test_rules_on_random_candidates(rng, name):
    near = adjacency(load_body(name).topology)
    candidate = rng.random((len(near), 300)) < 0.3
    distance = rng.normal(size=candidate.shape)
    args = jnp.asarray(candidate), jnp.asarray(distance, jnp.float32), near
    shared, exclusive, adjacent = (np.asarray(resolve_overlap(r, *args)) for r in ("shared", "exclusive", "adjacent"))
    np.testing.assert_array_equal(shared, candidate)
    some = candidate.any(0)
    np.testing.assert_array_equal(exclusive.sum(0), some)
    np.testing.assert_array_equal(exclusive.argmax(0)[some], np.where(candidate, distance, np.inf).argmin(0)[some])
    assert not (exclusive & ~adjacent).any() and not (adjacent & ~candidate).any()
    assert adjacent.sum() > exclusive.sum()
    for point in range(300):
        winner = exclusive[:, point].argmax()
        assert all(near[winner, limb] for limb in np.flatnonzero(adjacent[:, point]))


def test_adjacency():
    np.testing.assert_array_equal(adjacency(two_limbs().topology), np.ones((2, 2), bool))
    body = load_body("human")
    near = np.asarray(adjacency(body.topology))
    assert (near == near.T).all() and near.diagonal().all()
    assert near.sum() == len(near) + 2 * len(body.topology.joints)
