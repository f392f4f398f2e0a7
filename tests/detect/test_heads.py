"""People who touch are several, by their heads; one person is one, whatever the arms do."""

import numpy as np
import pytest

from voodoo_jax.detect.body_likelihood import Build
from voodoo_jax.detect.heads import parted, summits
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.simulate.motion import motion_of_turns, placed
from voodoo_jax.simulate.recording import in_one_picture, simulate
from voodoo_jax.simulate.sensor import tof_camera

BUILD, CAMERA = Build(1.75, 0.45), tof_camera(1.2, 0.0)
ARMS_UP = {"l_shoulder": (2.6, 0, 0), "r_shoulder": (-2.6, 0, 0)}
ARMS_ASIDE = {"l_shoulder": (1.5, 0, 0), "r_shoulder": (-1.5, 0, 0)}
RAISED = {"r_shoulder": (-1.5, 0, 0), "r_elbow": (0, -1.5, 0)}


def cloud(*people: tuple[float, float, float, dict]) -> np.ndarray:
    """Points above the floor of people with (stature, y, yaw, joint turns), 3.2 m before a camera."""
    seen = []
    for stature, y, yaw, turns in people:
        body = scaled(human(), stature)
        motion = motion_of_turns(body, np.zeros(1), {k: np.array([v], np.float32) for k, v in turns.items()})
        seen.append(simulate(body, placed(motion, 3.2, y, np.pi + yaw), CAMERA, room=None))
    depth = in_one_picture(*seen).depth[0].ravel() / 1000.0
    points = CAMERA.rays()[depth > 0] * depth[depth > 0, None] + np.array(CAMERA.position)
    return points[points[:, 2] > 0.05].astype(np.float32)


def who(points: np.ndarray) -> np.ndarray:
    return parted(points[:, 2], points[:, :2].T, BUILD, 0.5)


@pytest.mark.parametrize("turns", [{}, ARMS_UP, ARMS_ASIDE, RAISED], ids=["hang", "up", "aside", "raised"])
@pytest.mark.parametrize("yaw", [0.0, 1.57])
def test_one_person_is_one(turns, yaw):
    assert not who(cloud((1.75, 0.0, yaw, turns))).any()


def test_who_bows_is_one():
    bow = {"waist": (0, 1.3, 0), "l_shoulder": (0, -1.3, 0), "r_shoulder": (0, -1.3, 0)}
    for yaw in (0.0, 1.57):
        assert not who(cloud((1.75, 0.0, yaw, bow))).any()


@pytest.mark.parametrize("apart", [0.42, 0.55])
def test_two_shoulder_to_shoulder_are_two_each_with_their_own_points(apart):
    points = cloud((1.8, apart / 2, 0.0, {}), (1.65, -apart / 2, 0.0, {}))
    found = who(points)
    assert set(found) == {0, 1}
    left = points[:, 1] > 0
    tall = found == 0  # the highest head is the first
    assert np.mean(tall == left) > 0.93


def test_two_who_face_each_other_and_hold_hands_and_three_in_a_row():
    give = {"l_shoulder": (0, -1.2, 0), "r_shoulder": (0, -1.2, 0)}
    assert set(who(cloud((1.75, 0.5, -1.57, give), (1.7, -0.4, 1.57, give)))) == {0, 1}
    row = cloud((1.8, 0.6, 0, ARMS_ASIDE), (1.7, 0.0, 0, {}), (1.6, -0.55, 0, {}))
    found = who(row)
    assert set(found) == {0, 1, 2}
    middle = [float(np.median(row[found == k, 1])) for k in range(3)]
    np.testing.assert_allclose(middle, [0.6, 0.0, -0.55], atol=0.1)


def test_a_cupboard_beside_somebody_has_no_head():
    person = cloud((1.75, 0.0, 0.0, {}))
    y, z = np.meshgrid(np.arange(0.25, 1.1, 0.02), np.arange(0.06, 1.9, 0.02))
    box = np.stack([np.full(y.size, 3.2), y.ravel(), z.ravel()], -1).astype(np.float32)
    both = np.concatenate([person, box])
    found = who(both)
    assert not found.any() or np.mean(found[: len(person)] == found[0]) > 0.9


def test_summits_are_told_by_the_ground_between():
    level = np.stack(np.meshgrid(np.arange(0, 1.0, 0.02), np.arange(0, 0.2, 0.02), indexing="ij"), 0).reshape(2, -1)
    height = (1.5 + 0.2 * np.cos(2 * np.pi * level[0] / 0.5)).astype(np.float32)  # tops at 0, 0.5, (1.0)
    found = summits(height, level.astype(np.float32), 0.12)
    assert len(found) >= 2 and np.isclose(found[1][0], 0.5, atol=0.06) or np.isclose(found[0][0], 0.5, atol=0.06)
    assert len(summits(height, level.astype(np.float32), 0.45)) == 1
