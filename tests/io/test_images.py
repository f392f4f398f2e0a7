"""Colour images of a log: every encoding, and those that are broken."""

import cv2
import numpy as np
import pytest
from mcap.records import Channel, Schema

from tests.support.colour_logs import foxglove_compressed, foxglove_raw, ros_compressed, ros_info, ros_raw
from tests.support.logs import PERIOD, START, K, Log, definition, depth_log, serialise
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.decode.image_codec import pixels
from voodoo_jax.io.decode.registry import Decoder
from voodoo_jax.io.log_reader import LogError, read_log, survey
from voodoo_jax.io.stereo_pairs import picture_of

U, V = np.meshgrid(np.arange(32), np.arange(24))
IMAGE = np.stack([4 * U, 8 * V, 200 - 3 * U], -1).astype(np.uint8)  # blue, green, red


def decoded(message):
    """As the reader does it."""
    name, encoding, data = serialise(message)
    text = definition(name, encoding, message)
    schema = Schema(1, text, "ros2msg" if encoding == "cdr" else "protobuf", name)
    return Decoder().message(schema, Channel(1, "/x", encoding, {}, 1), data)


def image_of(message):
    picture = picture_of(decoded(message))
    assert picture is not None and picture.stamp_ns == START and picture.frame == "cam"
    return pixels(picture)


ALPHA = np.full((24, 32, 1), 9, np.uint8)
RAW = {
    "rgb8": IMAGE[..., ::-1], "bgr8": IMAGE, "8UC3": IMAGE, "rgba8": np.concatenate([IMAGE[..., ::-1], ALPHA], -1),
    "bgra8": np.concatenate([IMAGE, ALPHA], -1),
}  # fmt: skip


@pytest.mark.parametrize("encoding", RAW)
def test_raw_encodings(encoding):
    np.testing.assert_array_equal(image_of(ros_raw(START, "cam", encoding, RAW[encoding], padding=5)), IMAGE)
    np.testing.assert_array_equal(image_of(foxglove_raw(START, "cam", encoding, RAW[encoding])), IMAGE)


def test_grey():
    grey = IMAGE[..., :1]
    np.testing.assert_array_equal(image_of(ros_raw(START, "cam", "mono8", grey)), np.repeat(grey, 3, -1))


@pytest.mark.parametrize("encoding, order", [("yuv422", "UYVY"), ("yuyv", "YUYV"), ("yuv422_yuy2", "YUYV")])
def test_yuv(encoding, order):
    flat = np.full((24, 32, 3), (60, 120, 180), np.uint8)
    y, v, u = np.moveaxis(cv2.cvtColor(flat, cv2.COLOR_BGR2YCrCb).astype(float), -1, 0)
    y, u, v = 16 + y * 219 / 255, 128 + (u - 128) * 224 / 255, 128 + (v - 128) * 224 / 255  # video range
    chroma = np.where(np.arange(32) % 2 == 0, u, v)
    packed = np.stack([chroma, y] if order == "UYVY" else [y, chroma], -1).round().astype(np.uint8)
    assert np.abs(image_of(ros_raw(START, "cam", encoding, packed)).astype(int) - flat).max() <= 6


@pytest.mark.parametrize("format", ["jpeg", "rgb8; jpeg compressed bgr8", "jpg", ""])
def test_jpeg(format):
    made = image_of(ros_compressed(START, "cam", IMAGE, format=format))
    assert made.shape == IMAGE.shape and np.abs(made.astype(int) - IMAGE).mean() < 6


def test_png():
    np.testing.assert_array_equal(image_of(foxglove_compressed(START, "cam", IMAGE)), IMAGE)
    np.testing.assert_array_equal(image_of(ros_compressed(START, "cam", IMAGE, ".png", "bgr8; png compressed ")), IMAGE)


@pytest.mark.parametrize("kind", [".jpg", ".png"])
def test_an_image_that_is_cut_off_is_broken(kind):
    m = ros_compressed(START, "cam", np.repeat(np.repeat(IMAGE, 8, 0), 8, 1), kind)
    m.data = m.data[: len(m.data) // 2]
    with pytest.raises(ValueError, match="cut off"):
        image_of(m)


def test_other_broken_images():
    m = ros_compressed(START, "cam", IMAGE)
    m.data = np.frombuffer(b"not an image at all", np.uint8)
    with pytest.raises(ValueError, match="of a format that is not read"):
        image_of(m)
    m.data = np.zeros(0, np.uint8)
    with pytest.raises(ValueError, match="empty"):
        decoded(m)
    raw = ros_raw(START, "cam", "rgb8", IMAGE)
    raw.data = raw.data[:-1]
    with pytest.raises(ValueError, match="too few for 24 x 32"):
        image_of(raw)


def test_colour_images_do_not_disturb_depth(tmp_path):
    log = depth_log(3)
    for stamp in (START, START + PERIOD, START + 2 * PERIOD):
        log.add("/cam/rgb/compressed", stamp, ros_compressed(stamp, "cam_optical", IMAGE))
    path = log.write(tmp_path / "a.mcap")
    recording = read_log(path)
    assert recording.notes == () and [len(f.points) for f in recording] == [767] * 3
    uses = {t.topic: t.use for t in survey(path).topics}
    assert uses["/cam/depth"] == "depth image" and uses["/cam/rgb/compressed"] == "not used: a colour image"
    off = survey(path, ReadSettings(stereo=False))
    assert {t.topic: t.use for t in off.topics}["/cam/rgb/compressed"] == "not used: a colour image"


def test_one_colour_camera_is_not_enough(tmp_path):
    log = Log().add("/rgb/camera_info", START, ros_info("cam", K, (24, 32)))
    log.add("/rgb/image/compressed", START, ros_compressed(START, "cam", IMAGE))
    with pytest.raises(LogError, match="has no depth data.*skin colour"):
        read_log(log.write(tmp_path / "a.mcap"), ReadSettings(skin=True))
