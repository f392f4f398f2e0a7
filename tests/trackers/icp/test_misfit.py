"""Limbs on their points fit; limbs beside them, or where nothing is, do not."""

import numpy as np
import pytest

from tests.support.helpers import seen_points
from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.trackers.icp.misfit import misfit

BODY = scaled(human(), 1.7)
LIMBS, SIZES, REST = BODY.topology.limbs, np.asarray(BODY.sizes), on_host(BODY.rest)
SENSOR = np.array([[3.0, 0.0, 1.2]], np.float32)


def found(points, shift=0.0, noise: float = 0.0, count: int = 2):
    """The misfit of the rest pose, moved aside, in so many frames of the same points."""
    rotation, place = np.tile(REST.rotation, (count, 1, 1)), np.tile(REST.translation, (count, 1, 1)) + shift
    frame = BodyObservation(0, points.astype(np.float32), np.zeros(len(points), np.int32), SENSOR, noise=noise)
    return misfit(BODY, rotation, place, [frame] * count)


@pytest.fixture
def points(rng):
    return seen_points(rng, BODY, BODY.rest, SENSOR[0], 1500)


def test_a_body_on_its_points_fits(points):
    fit = found(points)
    assert fit.beside.shape == (2, len(LIMBS)) and fit.beside.mean() < 0.03 and fit.distance.mean() < 0.01
    assert fit.bare.mean() < 0.1


def test_a_body_beside_its_points_does_not(points):
    fit, moved = found(points), found(points, np.array([0.0, 0.1, 0.0]))
    assert moved.distance.mean() > 3 * fit.distance.mean() + 0.01 and moved.bare.mean() > fit.bare.mean() + 0.1
    assert moved.beside.mean() > 0.1


def test_a_limb_without_points_is_bare_unless_another_one_hides_it(points):
    shank, head = LIMBS.index("l_shank"), LIMBS.index("head")
    low = points[points[:, 2] > 0.6]
    fit = found(low)
    assert fit.bare[0, shank] > 0.9 and fit.bare[0, head] < 0.1
    behind = found(points, np.array([-0.6, 0.0, 0.0]))  # all of it behind what is seen
    assert behind.bare[0, LIMBS.index("chest")] == 0


def test_a_limb_behind_furniture_is_not_bare(rng, points):
    """A board between the sensor and the legs hides them, one behind them does not."""
    legs = [LIMBS.index("l_shank"), LIMBS.index("r_shank"), LIMBS.index("l_foot")]
    low, place = points[points[:, 2] > 0.6].astype(np.float32), np.tile(REST.translation, (1, 1, 1))
    for x, bare in ((0.8, 0.0), (-0.8, 1.0)):
        board = np.stack([np.full(2000, x), rng.uniform(-0.6, 0.6, 2000), rng.uniform(0.0, 0.65, 2000)], 1)
        before = board.astype(np.float32)
        frame = BodyObservation(
            0, low, np.zeros(len(low), np.int32), SENSOR, before=before, before_sensor=np.zeros(2000, np.int8)
        )  # fmt: skip
        fit = misfit(BODY, np.tile(REST.rotation, (1, 1, 1)), place, [frame])
        np.testing.assert_allclose(fit.bare[0, legs], bare, atol=0.1)


@pytest.mark.parametrize("there, before", [(False, 0.0), (True, 0.1)])
def test_points_on_an_arm_that_lies_on_the_chest_are_the_chests(rng, there, before):
    """The forearm in the chest's front, where points are the chest's; or so much before it, where they are its own."""
    arm = [LIMBS.index(name) for name in ("r_forearm", "r_hand")]
    chest, place = LIMBS.index("chest"), REST.translation.copy()
    front = REST.translation[chest] + [SIZES[chest, 0] - SIZES[arm[0], 0] + before, 0.0, 0.0]
    place[arm] = front + np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 0.06]])
    true = place.copy()
    if not there:
        true[arm] -= [9.0, 0.0, 0.0]  # where nobody sees it
    seen = seen_points(rng, BODY, Poses(REST.rotation, true), SENSOR[0], 1500).astype(np.float32)
    seen = seen[seen[:, 0] > -2.0]
    seen = seen + rng.normal(0, 0.015, seen.shape).astype(np.float32)
    frame = BodyObservation(0, seen, np.zeros(len(seen), np.int32), SENSOR)
    fit = misfit(BODY, REST.rotation[None], place[None], [frame])
    assert fit.own[0, arm[0]] > 0.7 if there else fit.own[0, arm[0]] < 0.2
    assert np.nanmin(found(seen, count=1).own[0, [chest, LIMBS.index("head"), LIMBS.index("l_shank")]]) > 0.5


def test_noise_is_no_misfit(rng, points):
    noisy = points + rng.normal(0, 0.04, points.shape)
    plain, known = found(noisy), found(noisy, noise=0.04)
    assert known.beside.mean() < 0.5 * plain.beside.mean() and known.distance.mean() < 0.6 * plain.distance.mean()


def test_few_points_tell_nothing(points):
    fit = found(points[:10])
    assert all(np.isnan(each).all() for each in fit)
    assert misfit(BODY, np.zeros((0, len(LIMBS), 4)), np.zeros((0, len(LIMBS), 3)), []).bare.shape == (0, len(LIMBS))
