"""Shares of points, and some of them."""

import numpy as np

from voodoo_jax.geometry.point_cloud import even_share, picked


def test_an_even_share_has_no_gaps_and_is_no_columns():
    whole = np.arange(5000)
    for share in (1.0, 0.5**0.5, 0.5, 0.25):
        found = even_share(share, 5000)
        assert abs(len(found) - share * 5000) < 3 and np.isin(found, whole).all()
        assert np.diff(found).max() <= 2 / share + 1
    np.testing.assert_array_equal(even_share(0.5, 100), even_share(0.5, 5000)[: len(even_share(0.5, 100))])
    columns = np.bincount(even_share(0.25, 5000) % 100, minlength=100)  # of an image 100 pixels wide
    assert columns.min() > 5 and columns.max() < 25
    assert len(even_share(0.5, 0)) == 0


def test_points_that_are_picked_are_by_coordinate():
    points = np.arange(30, dtype=np.float32).reshape(10, 3)
    for some in (points, np.asfortranarray(points)):
        found = picked(some, np.array([7, 2]))
        np.testing.assert_array_equal(found, points[[7, 2]])
        assert found.flags.f_contiguous
