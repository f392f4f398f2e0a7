"""Sensors of two computers whose clocks differ by a part of a second."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.logs import START, Log, ros_cloud, ros_tf
from tests.support.rooms import figure, room
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.detect.delays import Motion, offset
from voodoo_jax.detect.opening import read_log

TENTH = 100_000_000


def walk(time, late: float = 0.0, view=(1.0, 0, 0), aside=(0.0, 0, 0)) -> Motion:
    """Somebody who sets out, stops and goes on, as one sensor has it."""
    at = np.asarray(time, float)
    x = 2 + 0.8 * at + 0.25 * np.sin(3 * at)
    return Motion(at + late, np.column_stack([x, 0.3 * np.sin(at), np.ones(len(at))]) + aside, np.array(view))


@pytest.mark.parametrize("late", [0.25, -0.25, 0.12, -0.6])
@pytest.mark.parametrize("view, aside", [((1.0, 0, 0), (0.01, 0, 0)), ((-1.0, 0, 0), (0.2, 0.02, 0))])
def test_what_both_see_move_tells_the_offset(late, view, aside):
    time = np.arange(0, 4, 0.066)
    found = offset(walk(time), walk(time[::2] + 0.01, late, view, aside))
    assert abs(found - late) <= 0.02


def test_what_does_not_tell_is_left_alone():
    time = np.arange(0, 4, 0.066)
    assert offset(walk(time), walk(time)) == 0
    assert offset(walk(time), walk(time, 0.03)) == 0  # less than exposure and reading take
    stands = Motion(time, np.full((len(time), 3), 1.0), np.array([1.0, 0, 0]))
    assert offset(stands, stands._replace(time=time + 0.3)) == 0
    other = walk(time)
    assert offset(walk(time), other._replace(place=other.place[::-1] + [0, 1.0, 0])) == 0  # somebody else
    assert offset(walk(time), walk(time + 10)) == 0  # at another time


@pytest.mark.parametrize("early", [0, 2])
def test_a_log_of_two_hosts(rng, tmp_path, early):
    """The second one's stamps are early: latency would look the same, only motion tells."""
    around, log = room(rng), Log()
    log.add("/tf_static", START, ros_tf((START, "base", "one", (0, 0, 1.2), (0, 0, 0, 1))))
    log.add("/tf_static", START, ros_tf((START, "base", "two", (0, 0.3, 1.2), (0, 0, 0, 1))))
    for i in range(20):
        at = START + i * TENTH
        cloud = np.concatenate([around, figure(2.5, -1.0 + 0.1 * i)])
        log.add("/one", at, ros_cloud(at, "one", cloud[::2] - [0, 0, 1.2]))
        log.add("/two", at, ros_cloud(at - early * TENTH, "two", cloud[1::2] - [0, 0.3, 1.2]))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert ("0.20 s early" in " ".join(recording.notes)) == bool(early)
    assert len(recording) == 20 and all(len(np.unique(frame.sensor)) == 2 for frame in recording)
    as_stamped = read_log(tmp_path / "a.mcap", ReadSettings(delays=("/two=0",)))
    assert len(as_stamped) == 20 + early and as_stamped.notes == ()


@pytest.mark.parametrize("late, pan", [(0, 0.3), (2, 0.3), (-1, 0.3), (2, 0.002)])
def test_transforms_of_a_head_that_pans(rng, tmp_path, late, pan):
    """Late or early, the room tells; not where the head hardly moves. `read.delays` says it as well."""
    around, log = room(rng), Log()
    turns = [Rotation.from_rotvec([0, 0, pan * np.sin(0.5 * i)]) for i in range(-4, 34)]
    for i, turn in enumerate(turns, -4):
        at = START + i * TENTH
        pose = (at + late * TENTH, "base", "head", (0, 0, 1.2), tuple(turn.as_quat()))
        log.add("/tf", at, ros_tf(pose))
        if 0 <= i < 30:
            cloud = np.concatenate([around, figure(2.5, -1.0 + 0.05 * i)])[::2] - [0, 0, 1.2]
            log.add("/lidar", at, ros_cloud(at, "head", turn.inv().apply(cloud).astype(np.float32)))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    said = [note for note in recording.notes if note.startswith("'/tf'")]
    if not late or pan < 0.1:
        assert not said
        return
    assert f"{abs(late) / 10:.2f} s {'late' if late > 0 else 'early'}" in said[0]
    given = read_log(tmp_path / "a.mcap", ReadSettings(delays=(f"/tf={late / 10}",)))
    for one, other in zip(recording, given, strict=True):
        np.testing.assert_array_equal(one.points, other.points)
