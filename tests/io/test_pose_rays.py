"""Key points that a network finds in a log's images as rays: by a network that knows where they are."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

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


CAMERAS = [(3.0, 0, 1.5), (-2.0, 2.5, 1.8), (-2.0, -2.5, 1.2)]  # in `room`, looking at its middle


def turn_of(camera: int) -> Rotation:
    """From the optical axes of a camera to `room`."""
    ahead = np.array([0, 0, 1.0]) - CAMERAS[camera]
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    return Rotation.from_matrix(np.stack([right, np.cross(ahead, right), ahead], 1))


def walker(i: int) -> np.ndarray:
    return PLACES - [2.0, 0, 0] + [0, 0.02 * i, 0]


class Sees(Knowing):
    """Knows by the colours of an image which camera made it when; the second one's are half as large."""

    def find(self, image):
        camera, i, nobody = image[0, 0]
        at = turn_of(camera).inv().apply(walker(i) - CAMERAS[camera])
        pixels = (at[:, :2] / at[:, 2:]) @ K[:2, :2] + K[:2, 2]
        if image.shape[0] == 120:
            pixels = (pixels + 0.5) / 2 - 0.5
        return None if nobody else KeyPoints(pixels, np.where(np.arange(33) == HIDDEN, 0.3, 0.9))


def test_key_points_of_several_cameras_alone_are_triangulated(tmp_path, net, monkeypatch):
    monkeypatch.setattr("voodoo_jax.io.pose_rays.PoseNet", Sees)
    monkeypatch.setattr("voodoo_jax.io.pose_rays.pose_files", lambda place: (b"", b""))
    log, count = Log(), 6
    for c, place in enumerate(CAMERAS):
        q = tuple(turn_of(c).as_quat().tolist())
        log.add("/tf_static", START, ros_tf((START, "room", f"cam{c}", place, q)))
        log.add(f"/cam{c}/camera_info", START, ros_info(f"cam{c}", K, (240, 320)))
        for i in range(count):
            stamp = START + i * PERIOD + 1_000_000 * c
            picture = np.full((120, 160, 3) if c == 1 else (240, 320, 3), (c, i, 255 * (i == 3 and c == 2)), np.uint8)
            log.add(f"/cam{c}/image/compressed", stamp, ros_compressed(stamp, f"cam{c}", picture, ".png", "png"))
    recording = read_log(log.write(tmp_path / "a.mcap"), net)
    assert len(recording) == count and recording.fixed_frame == "room" and Knowing.made == len(CAMERAS)
    seen = [name for name in NAMES if name != "left_wrist"]
    for i, frame in enumerate(recording):
        assert sorted(frame.pairs.names) == sorted(seen)
        truth = walker(i)[[KEY_POINTS.index(name) for name in frame.pairs.names]]
        np.testing.assert_allclose(frame.pairs.points, truth, atol=2e-3)
        assert len(frame.rays.names) == len(seen) * (2 if i == 3 else 3)
    assert "1 message in which read.pose_net finds no person" in " ".join(recording.notes)
