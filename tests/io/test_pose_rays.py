"""Key points that a network finds in a log's images as rays: by a network that knows where they are."""

import numpy as np
import pytest

from tests.support.colour_logs import ros_compressed, ros_info
from tests.support.logs import PERIOD, START, Log, depth_log, ros_tf
from voodoo_jax.config.options import ReadSettings, SettingsError
from voodoo_jax.io.log_reader import open_log, read_log, survey
from voodoo_jax.io.pose_rays import NAMES
from voodoo_jax.sensors.pose_net import KEY_POINTS, KeyPoints

K = np.array([[300.0, 0.0, 159.5], [0.0, 310.0, 119.5], [0.0, 0.0, 1.0]])
EYE = np.array([0.2, -0.1, 1.4])  # of the colour camera in `base`, looking along x
D = (-0.28, 0.07, 0.0002, -0.0005, 0.0)
PLACES = np.array([2.0, 0.0, 1.2]) + 0.3 * np.random.default_rng(5).uniform(-1, 1, (33, 3))  # in `base`
HIDDEN = KEY_POINTS.index("left_wrist")


class Knowing:
    """In place of the network: finds the points in images that are bright."""

    made = 0

    def __init__(self, files):
        Knowing.made += 1

    def find(self, image):
        assert image.shape == (240, 320, 3)
        if image.mean() < 100:
            return None
        away = PLACES - EYE
        pixels = np.column_stack([-away[:, 1], -away[:, 2]]) / away[:, :1] @ K[:2, :2] + K[:2, 2]
        return KeyPoints(pixels, np.where(np.arange(33) == HIDDEN, 0.3, 0.8))


@pytest.fixture
def net(monkeypatch):
    monkeypatch.setattr("voodoo_jax.io.pose_rays.PoseNet", Knowing)
    monkeypatch.setattr("voodoo_jax.io.pose_rays.pose_files", lambda place: (b"", b""))
    monkeypatch.setattr("voodoo_jax.io.log_reader.check_pose_net", lambda place: None)
    monkeypatch.setattr(Knowing, "made", 0)
    return ReadSettings(pose_net="mediapipe", weights=("/colour/image/compressed=2",))


def colour_log(images, d=D) -> Log:
    log = depth_log(len(images)).add("/tf_static", START, ros_tf((START, "base", "colour", tuple(EYE), OPTICAL)))
    log.add("/colour/camera_info", START, ros_info("colour", K, (240, 320), d))
    for i, brightness in enumerate(images):
        stamp = START + i * PERIOD + 4_000_000
        picture = np.full((240, 320, 3), brightness, np.uint8)
        message = ros_compressed(stamp, "colour", picture, ".png", "png")
        if brightness == 1:
            message.data[:] = 0  # broken
        log.add("/colour/image/compressed", stamp, message)
    return log


OPTICAL = (-0.5, 0.5, -0.5, 0.5)


def test_key_points_are_rays_through_them(tmp_path, net):
    """The network's image has no lens left, and one that it says is hidden is left out."""
    path = colour_log([200, 0, 1, 200]).write(tmp_path / "a.mcap")
    recording = read_log(path, net)
    seen = tuple(name for name in NAMES if name != "left_wrist")
    assert [f.rays.names for f in recording] == [seen, (), (), seen] and Knowing.made == 1
    for frame in (recording.frames[0], recording.frames[3]):
        to = PLACES[[KEY_POINTS.index(n) for n in seen]] - EYE
        d = frame.rays.directions
        np.testing.assert_allclose(frame.rays.origins, np.tile(EYE, (len(seen), 1)), atol=1e-6)
        np.testing.assert_allclose(to, np.sum(to * d, 1, keepdims=True) * d, atol=1e-4)
        np.testing.assert_allclose(frame.rays.weights, 2 * 0.8, rtol=1e-6)
        assert d.dtype == np.float32 and frame.pictures == ()  # images were not asked for
    said = " ".join(recording.notes)
    assert (
        "1 message in which read.pose_net finds no person" in said
        and "an image that cannot be decoded" in said
        and "does not count" not in said
    )
    # as trackers see the log before it is read, and in `info`
    assert set(NAMES) == set(next(iter(open_log(path, net).named_at_once)))
    uses = {t.topic: t.use for t in survey(path, net).topics}
    assert uses["/colour/image/compressed"] == "key points"
    # without the setting nothing has changed
    assert all(f.rays.names == () for f in read_log(path))


def test_a_log_without_colour_images(tmp_path, net):
    recording = read_log(depth_log(2).write(tmp_path / "a.mcap"), ReadSettings(pose_net="mediapipe"))
    assert any("read.pose_net has no effect" in note for note in recording.notes) and len(recording) == 2


def test_a_network_that_is_not_there_is_said_before_anything_is_read(tmp_path):
    with pytest.raises(SettingsError, match="read.pose_net: there is no 'nowhere.whl'"):
        open_log(tmp_path / "none.mcap", ReadSettings(pose_net="nowhere.whl"))
