"""Distances in other units than usual: found by what is seen, or asked."""

import numpy as np
import pytest

from tests.support.logs import (
    PERIOD,
    START,
    Log,
    ros_calibration,
    ros_cloud,
    ros_image,
    ros_marker,
    ros_markers,
    ros_tf,
)
from tests.support.rooms import figure, room
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.detect.opening import read_log
from voodoo_jax.io.log_reader import LogError

HIGH = 1.2  # metres: the sensor's place


def log_of(cloud: np.ndarray, unit: float, transforms: bool = True, kind: str = "f4") -> Log:
    """What a sensor sees, in units of so many metres."""
    log = Log()
    if transforms:
        log.add("/tf_static", START, ros_tf((START, "base", "lidar", (0, 0, HIGH), (0, 0, 0, 1))))
    for i in range(4):
        at = START + i * PERIOD
        log.add("/p", at, ros_cloud(at, "lidar", (cloud - [0, 0, HIGH]) / unit, kind))
    return log


@pytest.mark.parametrize("unit", [0.001, 0.00025 / 0.001, 0.1, 0.01])
@pytest.mark.parametrize("transforms", [True, False])
def test_somebody_on_a_floor_tells_the_unit(rng, tmp_path, unit, transforms):
    cloud = np.concatenate([room(rng), figure(2.5, 0.1)])
    log = log_of(cloud, unit, transforms).write(tmp_path / "a.mcap")
    recording = read_log(log)
    low = -0.1 - (0 if transforms else HIGH)
    assert low < recording.frames[0].points[:, 2].min() and 1.5 < np.ptp(recording.frames[0].points[:, 2]) < 3.5
    assert sum("read.scale" in note for note in recording.notes) == 1
    said = read_log(log, ReadSettings(scale=(f"/p={unit}",)))
    np.testing.assert_array_equal(said.frames[0].points, recording.frames[0].points)
    assert not any("read.scale" in note for note in said.notes)


def test_what_is_usual_is_left_as_it_is(rng, tmp_path):
    for i, scene in enumerate((np.concatenate([room(rng), figure(2.5, 0.1)]), figure(2.5, 0.1), 3 * room(rng))):
        recording = read_log(log_of(scene, 1.0).write(tmp_path / f"{i}.mcap"))
        assert recording.notes == ()


def test_an_empty_room_is_told_by_the_sensors_height(rng, tmp_path):
    recording = read_log(log_of(room(rng), 0.25).write(tmp_path / "a.mcap"))
    assert "0.25 m" in " ".join(recording.notes)


def test_what_nothing_tells_is_asked(rng, tmp_path):
    points = rng.uniform(-1, 1, (500, 3)) + [90.0, 0, 0]
    with pytest.raises(LogError, match=r"/p.*read\.scale"):
        read_log(log_of(points, 1.0).write(tmp_path / "a.mcap"))


def test_a_scanner_in_the_open_measures_far(rng, tmp_path):
    """A car's scanner in a street without a person near: median distance 17 m, as of real ones."""
    away, round_about = rng.uniform(6, 60, 4000), rng.uniform(-np.pi, np.pi, 4000)
    ground = np.stack([away * np.cos(round_about), away * np.sin(round_about), rng.normal(-1.8, 0.3, 4000)], 1)
    log = log_of(ground + [0, 0, HIGH], 1.0, transforms=False).write(tmp_path / "a.mcap")
    recording = read_log(log)
    assert "read.scale" not in " ".join(recording.notes)
    assert np.median(recording.frames[0].points[:, 2]) == pytest.approx(-1.8, abs=0.1)


@pytest.mark.parametrize("unit, word", [(1.0, ""), (0.001, "millimetres"), (0.01, "centimetres")])
def test_markers(tmp_path, unit, word):
    places = {"head": (0.0, 0, 1.7), "hip": (0.1, 0, 0.9), "knee": (0.1, 0.1, 0.5), "heel": (0.0, 0.1, 0.05)}
    log = Log()
    for i in range(3):
        at = START + i * PERIOD
        markers = [ros_marker(at, "lab", name, np.array(p) / unit) for name, p in places.items()]
        log.add("/m", at, ros_markers(*markers))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    pairs = recording.frames[0].pairs
    np.testing.assert_allclose(pairs.points, [places[name] for name in pairs.names], atol=1e-6)
    assert (word in " ".join(recording.notes)) and sum("read.scale" in note for note in recording.notes) == bool(word)
    assert read_log(tmp_path / "a.mcap", ReadSettings(scale=("/m=2",))).frames[0].pairs.points.max() > 3 * unit


def test_pixels_without_a_distance_tell_nothing(tmp_path):
    log = Log()
    for i in range(3):
        metres = np.full((24, 32), 65.535)
        metres[:, :20] = 2.0 if i else 65.535
        log.add("/d", START + i * PERIOD, ros_image(START + i * PERIOD, "cam", metres))
    log.add("/i", START, ros_calibration("cam"))
    assert "read.scale" not in " ".join(read_log(log.write(tmp_path / "a.mcap")).notes)


def test_a_floor_at_another_height_is_doubted_and_a_child_stays_one(rng, tmp_path):
    """Twice too near is nothing unusual by itself: the transforms say how high the sensor is."""
    near = read_log(log_of(np.concatenate([room(rng), figure(2.5, 0.1)]), 2.0).write(tmp_path / "a.mcap"))
    assert np.ptp(near.frames[0].points[:, 2]) > 2.2 and "2 m" in " ".join(near.notes)
    raised = np.concatenate([room(rng), figure(2.5, 0.1, 0.95, 0.12)]) - [0, 0, 0.6]  # the frame is a robot's middle
    child = read_log(log_of(raised, 1.0).write(tmp_path / "b.mcap"))
    assert child.notes == ()
