"""What hides limbs: what is between a sensor and the body, not the floor, what is behind it, or far beside it."""

import numpy as np
import pytest

from voodoo_jax.detect.visibility import FEWEST, KEPT, in_the_way
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.records.observation import BodyObservation, with_places

FLOOR = Plane(np.array([0.0, 0.0, 1.0], np.float32), 0.0)
ORIGINS = np.array([[0.0, 0.0, 1.2], [0.0, 3.0, 1.2]], np.float32)


def block(rng, x, y, z, count=1000):
    """Points in a box of 0.4 m around a place, on the floor up to a height."""
    low, high = [x - 0.2, y - 0.2, 0.0], [x + 0.2, y + 0.2, z]
    return rng.uniform(low, high, (count, 3)).astype(np.float32)


def asked(*things, body, sensor=0):
    points = np.concatenate([*things, body])
    frame = BodyObservation(0, points, np.full(len(points), sensor, np.int32), ORIGINS)
    return in_the_way(frame, np.arange(len(points) - len(body), len(points)), FLOOR)


def test_a_desk_before_the_body_is_in_the_way(rng):
    body, desk = block(rng, 3.0, 0.0, 1.7), block(rng, 2.0, 0.0, 0.8)
    found, sensor = asked(desk, body=body)
    assert KEPT / 2 < len(found) <= KEPT and not sensor.any()
    assert (found[:, 2] > 0.05).all() and (found[:, 0] < 3.0).all()
    assert (found[:, 0] < 2.3).all()  # none of the body's own front


@pytest.mark.parametrize("count, some", [(2000, True), (500, True), (10, False)])
def test_little_in_a_large_picture_is_looked_at_closely(rng, count, some):
    """Somebody else, far from the camera, in a picture with 50,000 points of walls; not a few points of noise."""
    body, other, wall = block(rng, 5.0, 0.0, 1.7), block(rng, 4.0, 0.3, 1.7, count), block(rng, 7.0, 0.0, 2.0, 50_000)
    found, _ = asked(wall, other, body=body)
    assert len(found) > min(count, KEPT) / 4 if some else not len(found)


@pytest.mark.parametrize("x, y, z", [(4.0, 0.0, 0.8), (2.0, 1.5, 0.8), (2.0, 0.0, 0.03), (-1.0, 0.0, 0.8)])
def test_what_is_behind_beside_or_lies_on_the_floor_is_not(rng, x, y, z):
    body = block(rng, 3.0, 0.0, 1.7)
    found, _ = asked(block(rng, x, y, z), body=body)
    assert not ((np.abs(found[:, 0] - x) < 0.21) & (np.abs(found[:, 1] - y) < 0.21)).any()


def test_each_sensor_has_its_own_way(rng):
    """What is before the body for one sensor is beside it for the other one."""
    body, desk = block(rng, 3.0, 0.0, 1.7), block(rng, 1.8, 0.0, 0.8)
    for sensor, some in ((0, True), (1, False)):
        found, seen_by = asked(desk, body=body, sensor=sensor)
        assert ((found[:, 0] < 2.1).sum() > FEWEST) == some and (seen_by == sensor).all()


def test_without_a_body_nothing_is(rng):
    frame = BodyObservation(0, block(rng, 2.0, 0.0, 1.0), np.zeros(1000, np.int32), ORIGINS)
    assert not len(in_the_way(frame, np.zeros(0, int), FLOOR)[0])


def test_it_moves_with_the_frame(rng):
    before = block(rng, 2.0, 0.0, 1.0)
    frame = BodyObservation(
        0, before, np.zeros(1000, np.int32), ORIGINS, before=before, before_sensor=np.zeros(1000, np.int8)
    )
    moved = with_places(frame, lambda points: points + np.float32(1.0))
    assert moved.before is not None
    np.testing.assert_allclose(moved.before, before + 1.0)
