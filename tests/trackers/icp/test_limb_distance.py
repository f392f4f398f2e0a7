"""Distances to a limb against points that lie at known distances from it."""

import numpy as np
import trimesh

from voodoo_jax.trackers.shared.leftovers import signed_distance


def test_round_limb_as_trimesh():
    """A cylinder with many sides; inside only the distance to the side counts."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.4, 0.8, (300, 3))
    mesh = trimesh.creation.cylinder(0.1, 0.5, sections=128)
    mesh.apply_translation([0, 0, 0.25])
    found = signed_distance(np.array([0.1, 0.1, 0.1, 0.1, 0.5]), points)
    expected = -trimesh.proximity.signed_distance(mesh, points)
    assert (np.sign(found) == np.sign(expected)).all()
    np.testing.assert_allclose(found[found > 0], expected[found > 0], atol=2e-3)


def test_elliptic_cone_is_zero_on_its_surface():
    angle, along = np.meshgrid(np.linspace(0, 6, 20), np.linspace(0, 1, 7))
    a, b = 0.2 - 0.1 * along, 0.1 + 0.05 * along
    on = np.stack([a * np.cos(angle), b * np.sin(angle), 0.4 * along], -1).reshape(-1, 3)
    size = np.array([0.2, 0.1, 0.1, 0.15, 0.4])
    np.testing.assert_allclose(signed_distance(size, on), 0, atol=1e-12)
    assert (signed_distance(size, on * [1.01, 1.01, 1]) > 0).all()
    assert (signed_distance(size, on * [0.99, 0.99, 1]) < 0).all()
