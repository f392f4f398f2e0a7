"""Where images were cropped: found by the floor, else said, and joints are only as sure as that."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.colour_logs import Board, picture, ros_compressed, ros_info
from tests.support.logs import PERIOD, START, Log, ros_calibration, ros_cloud, ros_image, ros_tf
from tests.support.segments import blank_tracks
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.detect.opening import open_checked, read_log
from voodoo_jax.model.body_file import human
from voodoo_jax.records.recording import Recording
from voodoo_jax.records.tracks import for_users, scale_confidence

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
    assert open_checked(path).measuring.moved["/d"][1] == pytest.approx(12 - (rows.start or 0), abs=1.0)
    read = read_log(path)
    assert abs(np.median(lowest(read)[:, 2])) < 0.02 and read.sure == 1
    assert len([note for note in read.notes if "cropped" in note]) == 1


@pytest.mark.parametrize("cut, transforms", [(np.s_[:, 32:], True), (np.s_[24:], False), (np.s_[16:, 40:], True)])
def test_where_no_floor_tells_it_places_are_less_sure(rng, tmp_path, cut, transforms):
    read = read_log(cropped(tmp_path, rng, cut, transforms))
    assert 0.5 < read.sure < 0.8
    assert any("It is unknown where" in note and "read.camera" in note for note in read.notes)


def test_a_little_less_is_no_doubt(rng, tmp_path):
    read = read_log(cropped(tmp_path, rng, np.s_[:, 4:]))
    assert read.sure > 0.95 and not any("It is unknown where" in note for note in read.notes)


def test_a_cloud_of_a_calibrated_camera_was_not_cropped(rng, tmp_path):
    log = Log().add("/cam/i", START, ros_calibration("cam_optical", K, size=SHAPE))
    cloud = ros_cloud(START, "cam_optical", rng.uniform(1, 3, (500, 3)))
    path = log.add("/cam/points", START, cloud).write(tmp_path / "a.mcap")
    assert open_checked(path).leeway("/cam/points")[0] == (0, 0) and read_log(path).sure == 1


def pair(tmp_path, size, **settings):
    """A stereo pair of images of 160 x 124 pixels, with a calibration for another size."""
    log, k = Log(), np.array([[140.0, 0, (size[1] - 1) / 2], [0, 140.0, (size[0] - 1) / 2], [0, 0, 1]])
    for side, p03 in (("left", 0.0), ("right", -14.0)):
        log.add(f"/{side}/camera_info", START, ros_info("cam_optical", k, size, p03=p03))
    for i in range(3):
        for side, x in (("left", 0.0), ("right", 0.1)):
            image = picture([Board(2.5)], K, SHAPE, (x, 0.0, 0.0))
            log.add(f"/{side}/image_rect", START + i * PERIOD, ros_compressed(START + i * PERIOD, "cam_optical", image))
    return open_checked(log.write(tmp_path / "a.mcap"), ReadSettings(**settings))


def test_places_by_a_pair_whose_images_were_cropped_are_less_sure(tmp_path):
    log = pair(tmp_path, (124, 200))
    assert log.sensors == ("/left/image_rect",) and 0.5 < log.sure < 0.8
    assert any("It is unknown where '/left/image_rect'" in note for note in log.notes)
    whole = pair(tmp_path, SHAPE)
    assert whole.sure == 1 and not any("cropped" in note for note in whole.notes)


def test_colour_images_that_were_cropped_are_named(rng, tmp_path):
    def notes(size) -> list[str]:
        log = Log().add("/d/camera_info", START, ros_calibration("cam_optical", K, size=SHAPE))
        log.add("/colour/camera_info", START, ros_info("cam_optical", K, size))
        for i in range(3):
            log.add("/d/image", START + i * PERIOD, ros_image(START + i * PERIOD, "cam_optical", room(rng)))
            colour = ros_compressed(START + i * PERIOD, "cam_optical", picture([Board(2.5)], K, SHAPE))
            log.add("/colour/image", START + i * PERIOD, colour)
        found = open_checked(log.write(tmp_path / "a.mcap"), ReadSettings(images=True))
        assert found.sure == 1  # joints are where the depth is
        return [note for note in found.notes if "/colour/image" in note and "cropped" in note]

    assert len(notes((124, 200))) == 1 and not notes(SHAPE)


def test_joints_are_scaled_confidence():
    tracks = blank_tracks(human(), 2, joint_confidence=np.full((2, 14), 0.9, np.float32))
    np.testing.assert_allclose(scale_confidence(tracks, 0.5).joint_confidence, 0.45)
    assert scale_confidence(tracks, 1.0) is tracks
    log = SimpleNamespace(origin=np.array([1.0, 2.0, 0.0]), sure=0.5)  # as users get them, from Python and the command
    given = for_users(tracks, log)
    np.testing.assert_allclose(given.joint_confidence, 0.45)
    np.testing.assert_allclose(given.joints, tracks.joints + log.origin)


def test_what_is_said_to_be_doubtful_counts_the_calibration_too():
    confidence = np.full((2, 14), 0.95, np.float32)
    tracks = blank_tracks(human(), 2, joint_confidence=confidence, status=np.zeros(2, np.int8))
    said = lambda sure: for_users(tracks, SimpleNamespace(origin=np.zeros(3), sure=sure)).notes  # noqa: E731
    assert said(1.0) == () and "skullbase (48 %)" in said(0.5)[0]
