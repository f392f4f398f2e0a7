"""Where images were cropped: found by the floor, else said, and joints are only as sure as that."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.logs import PERIOD, START, Log, ros_calibration, ros_cloud, ros_image, ros_tf
from tests.support.segments import blank_tracks
from voodoo_jax.detect.opening import open_checked, read_log
from voodoo_jax.model.body_file import human
from voodoo_jax.records.recording import Recording
from voodoo_jax.records.tracks import for_users, only_as_sure

K = np.array([[140.0, 0, 79.5], [0, 140.0, 61.5], [0, 0, 1]])
SHAPE, HIGH, WALL = (124, 160), 0.7, 4.5
OPTICAL = (-0.5, 0.5, -0.5, 0.5)  # of a level camera, in a frame whose x points ahead and z up


def room(rng) -> np.ndarray:
    """Metres, as a level camera sees a floor and a wall ahead."""
    down = (np.arange(SHAPE[0]) - K[1, 2]) / K[1, 1]
    z = np.minimum(WALL, HIGH / np.maximum(down, 1e-3))
    return np.repeat(z[:, None], SHAPE[1], 1) + rng.normal(0, 0.004, SHAPE)


def cropped(tmp_path, rng, cut, transforms: bool = True):
    log = Log()
    if transforms:
        log.add("/tf_static", START, ros_tf((START, "base", "cam_optical", (0, 0, HIGH), OPTICAL)))
    log.add("/i", START, ros_calibration("cam_optical", K, size=SHAPE))
    for i in range(4):
        log.add("/d", START + i * PERIOD, ros_image(START + i * PERIOD, "cam_optical", room(rng)[cut]))
    return log.write(tmp_path / "a.mcap")


def lowest(recording: Recording) -> np.ndarray:
    points = recording.frames[0].points
    return points[points[:, 0] < WALL - 0.3]


@pytest.mark.parametrize("rows", [np.s_[24:], np.s_[:100], np.s_[12:112], np.s_[6:106]])
def test_a_floor_tells_how_far_from_the_top_rows_were_cut(rng, tmp_path, rows):
    path = cropped(tmp_path, rng, rows)
    assert open_checked(path).moved["/d"][1] == pytest.approx(12 - (rows.start or 0), abs=1.0)
    read = read_log(path)
    assert abs(np.median(lowest(read)[:, 2])) < 0.02 and read.sure == 1
    assert len([note for note in read.notes if "cropped" in note]) == 1


@pytest.mark.parametrize("cut, transforms", [(np.s_[:, 32:], True), (np.s_[24:], False), (np.s_[16:, 40:], True)])
def test_where_no_floor_tells_it_places_are_less_sure(rng, tmp_path, cut, transforms):
    read = read_log(cropped(tmp_path, rng, cut, transforms))
    assert 0.5 < read.sure < 0.8
    assert any("Nothing tells where" in note and "read.camera" in note for note in read.notes)


def test_a_little_less_is_no_doubt(rng, tmp_path):
    read = read_log(cropped(tmp_path, rng, np.s_[:, 4:]))
    assert read.sure > 0.95 and not any("Nothing tells" in note for note in read.notes)


def test_a_cloud_of_a_calibrated_camera_was_not_cropped(rng, tmp_path):
    log = Log().add("/cam/i", START, ros_calibration("cam_optical", K, size=SHAPE))
    cloud = ros_cloud(START, "cam_optical", rng.uniform(1, 3, (500, 3)))
    path = log.add("/cam/points", START, cloud).write(tmp_path / "a.mcap")
    assert open_checked(path).leeway("/cam/points")[0] == (0, 0) and read_log(path).sure == 1


def test_joints_are_only_as_sure():
    tracks = blank_tracks(human(), 2, joint_confidence=np.full((2, 14), 0.9, np.float32))
    np.testing.assert_allclose(only_as_sure(tracks, 0.5).joint_confidence, 0.45)
    assert only_as_sure(tracks, 1.0) is tracks
    log = SimpleNamespace(origin=np.array([1.0, 2.0, 0.0]), sure=0.5)  # as users get them, from Python and the command
    given = for_users(tracks, log)
    np.testing.assert_allclose(given.joint_confidence, 0.45)
    np.testing.assert_allclose(given.joints, tracks.joints + log.origin)
