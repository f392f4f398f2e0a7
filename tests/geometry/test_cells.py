"""Grids of cells against brute force, in boxes of moderate size and beyond."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from voodoo_jax.geometry import voxels
from voodoo_jax.geometry.voxels import (
    Counted,
    about_within,
    cells_of,
    components,
    touching,
    unique_cells,
    within,
)


@pytest.fixture(params=["array", "sorted"])
def way(request, monkeypatch):
    """Both ways to look up cells."""
    if request.param == "sorted":
        monkeypatch.setattr(voxels, "MODERATE", 0)
        monkeypatch.setattr(voxels, "LARGE", 0)


def cloud(rng, count: int, spread: float = 1.0) -> np.ndarray:
    return rng.normal(0, spread, (count, 3)).astype(np.float32)


def test_unique_cells_are_numpys(rng, way):
    some = cells_of(cloud(rng, 500), 0.3)
    unique, inverse = unique_cells(some)
    np.testing.assert_array_equal(unique, np.unique(some, axis=0))
    np.testing.assert_array_equal(unique[inverse], some)


def test_touching_cells_differ_by_one_at_most(rng, way):
    some, others = cells_of(cloud(rng, 200), 0.2), cells_of(cloud(rng, 60, 2.0), 0.2)
    expected = (np.abs(some[:, None] - others[None]).max(2) <= 1).any(1)
    assert 5 < expected.sum() < 195
    np.testing.assert_array_equal(touching(some, others), expected)
    assert not touching(some, others[:0]).any() and len(touching(some[:0], others)) == 0


@pytest.mark.parametrize("distance", [0.06, 0.25, 1.0])
def test_within_a_distance_as_a_search_tree_says(rng, way, distance):
    points, others = cloud(rng, 800), cloud(rng, 300, 1.5)
    apart = KDTree(others).query(points)[0]
    np.testing.assert_array_equal(within(points, others, distance), apart < distance)
    about = about_within(points, others, distance)
    assert about[apart < distance].all() and not about[apart > 1.34 * np.sqrt(3) * distance].any()


def test_components_are_the_same_both_ways(rng, monkeypatch):
    points = cloud(rng, 400, 2.0)
    label = components(points, 0.4)
    monkeypatch.setattr(voxels, "MODERATE", 0)
    monkeypatch.setattr(voxels, "LARGE", 0)
    np.testing.assert_array_equal(components(points, 0.4), label)
    assert 10 < label.max() < 390


def test_counted_cells(rng):
    seen, points = Counted(0.1), cloud(rng, 50)
    assert (seen.at(points) == 0).all()
    seen.add(cells_of(points, 0.1), 1.0)
    seen.add(cells_of(np.repeat(points[:20], 3, 0), 0.1), 2.0)
    np.testing.assert_array_equal(seen.at(points[:20]), 3.0)
    assert set(map(tuple, seen.cells(2).tolist())) == set(map(tuple, cells_of(points[:20], 0.1).tolist()))
    assert (seen.at(points + np.float32(20)) == 0).all()
    seen.clear()
    assert len(seen) == 0
