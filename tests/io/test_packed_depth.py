"""Depth images that image_transport has packed: the same points as from raw ones."""

import struct

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.support.colour_logs import foxglove_compressed, ros_compressed
from tests.support.logs import (
    PERIOD,
    START,
    Log,
    T,
    depth_metres,
    foxglove_calibration,
    header,
    ros_calibration,
    ros_image,
)
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.decode.image_codec import packed_depth, raw_of
from voodoo_jax.io.log_reader import LogError, read_log, survey

A, B = 101.0, -4.0  # of 32FC1: steps of 2 cm at 1.5 m
TOPIC = "/cam/depth/image_raw/compressedDepth"
INFO = "/cam/depth/camera_info"


def millimetres(i: int = 0) -> np.ndarray:
    return np.round(depth_metres(i) * 1000).astype(np.uint16)


def png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def rvl(image: np.ndarray) -> bytes:
    """As in the paper's listing, number by number."""
    nibbles: list[int] = []

    def put(number: int) -> None:
        while True:
            more = number > 7
            nibbles.append(number & 7 | 8 * more)
            number >>= 3
            if not more:
                return

    values, at, before = [int(v) for v in image.ravel()], 0, 0
    while at < len(values):
        zeros = at
        while at < len(values) and values[at] == 0:
            at += 1
        put(at - zeros)
        end = at
        while end < len(values) and values[end] != 0:
            end += 1
        put(end - at)
        for v in values[at:end]:
            put(2 * (v - before) if v >= before else 2 * (before - v) - 1)
            before = v
        at = end
    nibbles += [0] * (-len(nibbles) % 8)
    words = [sum(n << (28 - 4 * k) for k, n in enumerate(nibbles[i : i + 8])) for i in range(0, len(nibbles), 8)]
    return struct.pack(f"<ii{len(words)}I", image.shape[1], image.shape[0], *words)


def message(image: np.ndarray, encoding: str = "16UC1", how: str = "png", stamp: int = START):
    packed = rvl(image) if how == "rvl" else png(image)
    data = np.frombuffer(struct.pack("<iff", 0, A, B) + packed, np.uint8)
    name = f"{encoding}; compressedDepth {how}".strip()
    return T["sensor_msgs/msg/CompressedImage"](header(stamp, "cam"), name, data)


def log_of(make, topic: str = TOPIC, info=None, frames: int = 3) -> Log:
    log = Log().add(INFO, START, info or ros_calibration("cam"))
    for i in range(frames):
        stamp = START + i * PERIOD
        log.add(topic, stamp, make(i, stamp))
    return log


@pytest.fixture
def raw_points(tmp_path):
    log = log_of(lambda i, stamp: ros_image(stamp, "cam", depth_metres(i)), "/cam/depth/image_raw")
    return [f.points for f in read_log(log.write(tmp_path / "raw.mcap"))]


@pytest.mark.parametrize("how", ["png", "", "rvl"])
def test_the_same_points_as_from_raw_images(tmp_path, raw_points, how):
    path = log_of(lambda i, stamp: message(millimetres(i), how=how, stamp=stamp)).write(tmp_path / "a.mcap")
    found = read_log(path)
    assert found.notes == read_log(tmp_path / "raw.mcap").notes
    for frame, points in zip(found, raw_points, strict=True):
        np.testing.assert_array_equal(frame.points, points)
    assert {t.topic: t.use for t in survey(path).topics}[TOPIC] == "depth image"


def test_floats_are_packed_with_steps_that_grow_with_distance(tmp_path, raw_points):
    metres = depth_metres()
    with np.errstate(divide="ignore"):
        raw = np.where(metres > 0, np.round(A / metres + B), 0).astype(np.uint16)
    path = log_of(lambda i, stamp: message(raw, "32FC1", stamp=stamp), frames=1).write(tmp_path / "a.mcap")
    (frame,) = read_log(path)
    assert len(frame.points) == len(raw_points[0])
    step = metres[metres > 0] ** 2 / A
    assert (np.abs(frame.points[:, 2] - metres[metres > 0]) <= 0.51 * step).all()


def test_png_of_sixteen_bits_is_depth_and_of_eight_is_not(tmp_path, raw_points):
    """image_transport's `compressed` of a depth image, and Foxglove's; a grey picture beside them."""
    ros = log_of(lambda i, stamp: ros_compressed(stamp, "cam", millimetres(i), ".png", "16UC1; png compressed "))
    fox = log_of(lambda i, stamp: foxglove_compressed(stamp, "cam", millimetres(i)), info=foxglove_calibration("cam"))
    for log in (ros, fox):
        log.add(
            "/cam/grey",
            START,
            ros_compressed(START, "other", np.zeros((24, 32), np.uint8), ".png", "mono8; png compressed "),
        )
        path = log.write(tmp_path / "a.mcap")
        for settings_ in (ReadSettings(), ReadSettings(stereo=False)):
            for frame, points in zip(read_log(path, settings_), raw_points, strict=True):
                np.testing.assert_array_equal(frame.points, points)
        assert {t.topic: t.use for t in survey(path).topics}["/cam/grey"] == "not used: a colour image"


def test_packed_and_raw_images_of_one_camera_are_used_once(tmp_path, raw_points):
    log = log_of(lambda i, stamp: message(millimetres(i), stamp=stamp))
    for i in range(3):
        log.add("/cam/depth/image_raw", START + i * PERIOD, ros_image(START + i * PERIOD, "cam", depth_metres(i)))
    path = log.write(tmp_path / "a.mcap")
    assert [len(f.points) for f in read_log(path)] == [len(p) for p in raw_points]
    uses = {t.topic: t.use for t in survey(path).topics}
    assert uses["/cam/depth/image_raw"] == "depth image" and "the same camera" in uses[TOPIC]


def test_the_calibration_of_the_namespace_is_found(tmp_path):
    path = log_of(lambda i, stamp: message(millimetres(i), stamp=stamp), info=ros_calibration("elsewhere"))
    assert len(read_log(path.write(tmp_path / "a.mcap"))) == 3


@pytest.mark.parametrize("how", ["png", "rvl"])
def test_broken_ones_are_counted(tmp_path, how):
    def make(i, stamp):
        m = message(millimetres(i), how=how, stamp=stamp)
        if i == 1:
            m.data = m.data[: len(m.data) // 2]
        return m

    found = read_log(log_of(make).write(tmp_path / "a.mcap"))
    assert len(found) == 2 and any("1 message cannot be decoded" in note for note in found.notes)


def test_one_that_is_too_short_to_tell(tmp_path):
    short = T["sensor_msgs/msg/CompressedImage"](header(START, "cam"), "16UC1; compressedDepth png", np.zeros(9, "u1"))
    with pytest.raises(LogError, match="9 bytes are too few"):
        read_log(log_of(lambda i, stamp: short).write(tmp_path / "a.mcap"))


@given(
    arrays(
        np.uint16, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.sampled_from([0, 0, 1, 7, 4000, 65535])
    )
)
@settings(max_examples=60, deadline=None)
def test_rvl_of_any_image(image):
    found = packed_depth(START, "cam", "16UC1; compressedDepth rvl", bytes(12) + rvl(image) + bytes(8))
    assert found is not None and found.shape == image.shape
    np.testing.assert_array_equal(raw_of(found), image)


def test_rvl_of_noise_is_an_error_not_a_picture(rng):
    for _ in range(50):
        data = bytes(12) + struct.pack("<ii", 32, 24) + rng.bytes(int(rng.integers(8, 400)))
        found = packed_depth(START, "cam", "16UC1; compressedDepth rvl", data)
        assert found is not None
        try:
            assert raw_of(found).shape == (24, 32)
        except ValueError as error:
            assert "depth image" in str(error)
