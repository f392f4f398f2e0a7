"""What depth images say of themselves, against what they show: which is depth, along which way, in which frame."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.logs import START, Log, T, ros_calibration, ros_image, ros_tf
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.as_shown import flat_share, word
from voodoo_jax.io.container import LogError
from voodoo_jax.io.log_reader import open_log, read_log, survey

SIZE = (60, 80)
K = np.array([[70.0, 0, 39.5], [0, 70, 29.5], [0, 0, 1]])
HEIGHT, WALL, PITCH = 1.3, 3.5, 20.0  # metres, metres, degrees downwards
BODY = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # from optical axes to those of a body
DOWN = Rotation.from_euler("y", PITCH, degrees=True).as_matrix()  # from the camera's body to the room


def rays():
    v, u = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    return np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(SIZE)], -1)


def room(seed=0):
    """Depth of a floor and a wall, metres, with noise of 4 mm."""
    ways = rays() @ (DOWN @ BODY).T
    with np.errstate(divide="ignore"):
        depth = np.minimum(WALL / ways[..., 0], np.where(ways[..., 2] < 0, -HEIGHT / ways[..., 2], np.inf))
    return depth + np.random.default_rng(seed).normal(0, 0.004, SIZE)


def brightness(depth, seed):
    return 2.0 / depth**2 + np.random.default_rng(seed).normal(0, 0.01, SIZE)


def log(path, images, frame="optical", pose=None):
    """A log of some frames of images by topic; `pose` of their frame in the room."""
    place = DOWN @ BODY if pose is None else pose
    q = tuple(Rotation.from_matrix(place).as_quat().tolist())
    out = Log().add("/tf_static", START, ros_tf((START, "room", frame, (0.0, 0.0, HEIGHT), q)))
    out.add("/camera/camera_info", START, ros_calibration(frame, K, size=SIZE))
    for i in range(3):
        for topic, make in images.items():
            out.add(topic, START + i * 10**8, ros_image(START + i * 10**8, frame, make(room(i), i)))
    return out.write(path)


@pytest.mark.parametrize(("depth", "other"), [("/camera/z", "/camera/a"), ("/camera/depth", "/camera/confidence")])
def test_brightness_and_confidence_are_no_depth(depth, other, tmp_path):
    """Whatever their names, and though they come first."""
    noise = lambda _, i: np.random.default_rng(i).uniform(0.5, 5, SIZE)  # noqa: E731
    made = brightness if other == "/camera/a" else noise
    path = log(tmp_path / "a.mcap", {other: made, depth: lambda z, i: z})
    reader = open_log(path)
    assert reader.sensors == (depth,) and any(other in note and "no depth" in note for note in reader.notes)
    uses = {topic.topic: topic.use for topic in survey(path).topics}
    assert uses[depth] == "depth image" and "no depth" in uses[other]
    alone = open_log(log(tmp_path / "b.mcap", {other: made}))  # nothing else is there
    assert alone.sensors == (other,)


@pytest.mark.parametrize("values", [1, 2, 4])
def test_flags_are_no_wall(values, tmp_path):
    """An image of flags, or one that is saturated, is the same everywhere, as a wall straight ahead would be."""
    flags = lambda z, i: 3.0 * (1 + np.floor(z - z.min()) % values)  # noqa: E731
    path = log(tmp_path / "a.mcap", {"/camera/a": flags, "/camera/z": lambda z, i: z})
    reader = open_log(path)
    assert reader.sensors == ("/camera/z",) and any("'/camera/a' is left out: no depth" in n for n in reader.notes)


@pytest.mark.parametrize(("encoding", "base", "says"), [("16UC1", 0.1, "has to be 32FC1"), ("32FC1", 0.0, "base 0")])
def test_a_disparity_image_that_says_too_little_is_not_damaged(encoding, base, says, tmp_path):
    image = ros_image(START, "optical", 10 / room(), encoding)
    area = T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    made = T["stereo_msgs/msg/DisparityImage"](image.header, image, 70.0, base, area, 0.0, 64.0, 0.1)
    path = log(tmp_path / "a.mcap", {})
    out = (
        Log().add("/camera/camera_info", START, ros_calibration("optical", K, size=SIZE)).add("/camera/d", START, made)
    )
    with pytest.raises(LogError, match=says) as refused:
        open_log(out.write(path))
    assert "damaged" not in str(refused.value) and "another version" not in str(refused.value)


def test_of_two_depth_images_of_a_camera_one_is_used(tmp_path):
    path = log(tmp_path / "a.mcap", {"/camera/depth": lambda z, i: z, "/camera/filtered": lambda z, i: z})
    assert open_log(path).sensors == ("/camera/depth",)
    assert word("/ir/depth/image") == 1 and word("/depth/confidence") == -1 and word("/camera/image") == 0


def test_distances_along_the_rays(tmp_path):
    length = np.linalg.norm(rays(), axis=-1)
    depth = open_log(log(tmp_path / "z.mcap", {"/camera/image": lambda z, i: z}))
    path = log(tmp_path / "r.mcap", {"/camera/image": lambda z, i: z * length})
    radial = read_log(path)
    assert not depth.measuring.radial and any("read.radial=/camera/image=yes" in note for note in radial.notes)
    a, b = next(depth.frames()).points, radial.frames[0].points
    np.testing.assert_allclose(a, b, atol=3e-3)  # whole millimetres
    said = open_log(path, ReadSettings(radial=("/camera/image=no",)))
    assert float(np.abs(next(said.frames()).points - a).max()) > 0.1


def test_noise_has_no_planes():
    assert flat_share(rays()[..., :2], np.random.default_rng(0).uniform(1, 4, SIZE)) == (0.0, False)
    share, along = flat_share(rays()[..., :2], room())
    assert share > 0.8 and not along


def test_images_in_the_frame_of_a_cameras_body(tmp_path):
    """Their floor is level once they are taken for optical ones."""
    images = {"/camera/image": lambda z, i: z}
    right = read_log(log(tmp_path / "a.mcap", images))
    found = read_log(log(tmp_path / "b.mcap", images, "camera_link", DOWN))
    assert any("'camera_link'" in note and "camera's body" in note for note in found.notes)
    np.testing.assert_allclose(found.frames[1].points, right.frames[1].points, atol=1e-4)
    optical = read_log(log(tmp_path / "c.mcap", images, "camera_link", DOWN @ BODY))  # a name that says nothing
    np.testing.assert_allclose(optical.frames[1].points, right.frames[1].points, atol=1e-4)
    assert not any("camera's body" in note for note in optical.notes)


def test_mirrored_images_are_turned_round(tmp_path):
    plain, flipped = (
        log(tmp_path / f"{name}.mcap", {"/camera/image": make})
        for name, make in (("a", lambda z, i: z), ("b", lambda z, i: z[:, ::-1]))
    )
    mirror = ReadSettings(mirror=("/camera/image=x",))
    np.testing.assert_array_equal(read_log(flipped, mirror).frames[0].points, read_log(plain).frames[0].points)
