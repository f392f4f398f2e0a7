"""Pictures that come again: a sensor with noise never measures the same twice, a simulated one may."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from tests.support.logs import (
    PERIOD,
    START,
    Log,
    T,
    depth_metres,
    depth_points,
    header,
    ros_calibration,
    ros_cloud,
    ros_image,
    ros_tf,
)
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.log_reader import read_log

STOOD, RUNS = 6, (4, 3)  # pictures that come again, pictures that are new before and after them


def as_image(stamp: int, metres: np.ndarray) -> Any:
    return ros_image(stamp, "cam_optical", metres)


def as_floats(stamp: int, metres: np.ndarray) -> Any:
    """With NaN, which is not equal to itself, where nothing is seen, and with bytes beside each row."""
    return ros_image(stamp, "cam_optical", np.where(metres == 0, np.nan, metres), "32FC1", padding=8, big=True)


def as_cloud(stamp: int, metres: np.ndarray) -> Any:
    return ros_cloud(stamp, "cam_optical", depth_points(np.where(metres == 0, np.nan, metres)))


def as_png(stamp: int, metres: np.ndarray) -> Any:
    ok, data = cv2.imencode(".png", np.round(metres * 1000).astype(np.uint16))
    assert ok
    packed = np.concatenate([np.zeros(12, np.uint8), data.ravel()])
    return T["sensor_msgs/msg/CompressedImage"](header(stamp, "cam_optical"), "16UC1; compressedDepth png", packed)


KINDS = [as_image, as_floats, as_cloud, as_png]


def log_of(pictures: list[np.ndarray], kind: Callable[[int, np.ndarray], Any]) -> Log:
    log = Log()
    log.add("/tf_static", START, ros_tf((START, "base", "cam_optical", (0.0, 0.0, 1.25), (-0.5, 0.5, -0.5, 0.5))))
    log.add("/cam/camera_info", START, ros_calibration("cam_optical"))
    for i, picture in enumerate(pictures):
        log.add("/cam/depth", START + i * PERIOD, kind(START + i * PERIOD, picture))
    return log


def standing_still(noise: float, moves: bool = True) -> list[np.ndarray]:
    """Depth images, metres, in which something moves before a wall, of which some show what the one before showed."""
    rng, pictures = np.random.default_rng(0), []
    for k in range(sum(RUNS)):
        picture = depth_metres() + noise * rng.standard_normal(depth_metres().shape)
        picture[8:16, 3 * k * moves : 3 * k * moves + 5] = 1.5
        picture[0, 0] = 0
        pictures.append(picture)
    return [*pictures[: RUNS[0]], *[pictures[RUNS[0] - 1]] * STOOD, *pictures[RUNS[0] :]]


@pytest.mark.parametrize("kind", KINDS)
def test_what_stood_still_is_left_out_and_said(tmp_path, kind):
    found = read_log(log_of(standing_still(0.01), kind).write(tmp_path / "a.mcap"))
    assert len(found.frames) == sum(RUNS)
    assert [
        note
        for note in found.notes
        if note.startswith(f"'/cam/depth': {STOOD} messages left out, which repeat the previous image")
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_without_noise_the_same_picture_may_be_right(tmp_path, kind):
    found = read_log(log_of(standing_still(0.0), kind).write(tmp_path / "a.mcap"))
    assert len(found.frames) == sum(RUNS) + STOOD and found.notes == ()


@pytest.mark.parametrize("kind", KINDS)
def test_what_stood_still_at_first_is_kept_and_said(tmp_path, kind):
    """By then nobody knows whether the sensor has noise; of one picture all the time it is never known."""
    new = standing_still(0.01)
    found = read_log(log_of([new[0]] * 4 + new[1:3], kind).write(tmp_path / "a.mcap"))
    assert (
        len(found.frames) == 6
        and len([note for note in found.notes if "3 messages which repeat the first image" in note]) == 1
    )
    one = read_log(log_of([new[0]] * 5, kind).write(tmp_path / "b.mcap"))
    assert len(one.frames) == 5 and one.notes == ()


@pytest.mark.parametrize("kind", KINDS)
def test_darkness_is_no_picture_that_comes_again(tmp_path, kind):
    pictures = standing_still(0.01)
    dark = [*pictures[:2], *[np.zeros_like(pictures[0])] * 3, pictures[-1]]
    found = read_log(log_of(dark, kind).write(tmp_path / "a.mcap"))
    assert len(found.frames) == len(dark) and found.notes == ()
    assert [len(frame.points) == 0 for frame in found.frames] == [False, False, True, True, True, False]


@pytest.mark.parametrize("kind", KINDS)
def test_a_sensor_that_never_changes_is_left_out_beside_one_that_does(tmp_path, kind):
    pictures = standing_still(0.01)
    log = log_of(pictures[: RUNS[0]], kind)
    for i in range(RUNS[0]):
        log.add("/frozen/depth", START + i * PERIOD, kind(START + i * PERIOD, pictures[0]))
    log.add("/frozen/camera_info", START, ros_calibration("cam_optical"))
    found = read_log(log.write(tmp_path / "a.mcap"), ReadSettings(topics=("/cam/depth", "/frozen/depth")))
    assert [len({*frame.sensor.tolist()}) for frame in found.frames[2:]] == [1] * (RUNS[0] - 2)
    assert any(note.startswith("'/frozen/depth'") and "was frozen" in note for note in found.notes)
