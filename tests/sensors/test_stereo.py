"""Stereo pairs: clouds of boards at known distances, through every way a log may describe its cameras."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.colour_logs import Board, foxglove_compressed, picture, ros_compressed, ros_info, ros_raw
from tests.support.logs import HALF, PERIOD, START, Log, depth_log, ros_tf
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.log_reader import LogError, read_log, survey
from voodoo_jax.io.stereo_pairs import partners

SIZE = (240, 320)
K = np.array([[400.0, 0.0, 159.5], [0.0, 400.0, 119.5], [0.0, 0.0, 1.0]])
BASE = 0.12
BOX = Board(2.5, (-0.4, -0.5), (0.3, 0.4))
BOARDS = [Board(4.0), BOX]
LEFT = picture(BOARDS, K, SIZE)
RIGHT = picture(BOARDS, K, SIZE, (BASE, 0, 0))
LEVEL = (0.0, 0.0, 0.0, 1.0)
NAMES = ("/rig/left/image_raw/compressed", "/rig/right/image_raw/compressed")


def infos(log: Log, p03: float = -K[0, 0] * BASE, left="left_optical", right="right_optical") -> Log:
    log.add("/rig/left/camera_info", START, ros_info(left, K, SIZE))
    return log.add("/rig/right/camera_info", START, ros_info(right, K, SIZE, p03=p03))


def images(log: Log, i: int, left=LEFT, right=RIGHT, names=NAMES) -> Log:
    stamp = START + i * PERIOD
    log.add(names[0], stamp, ros_compressed(stamp, "left_optical", left, ".png", "png"))
    return log.add(names[1], stamp, ros_compressed(stamp + 2_000_000, "right_optical", right, ".png", "png"))


def check(points: np.ndarray, boxed: float = 0.035, flying: float = 0.01) -> None:
    """Of a cloud in the left camera's frame: near points on the box, the others on the wall, next to none between."""
    x, y, z = points.T
    on_box, on_wall = np.abs(z - 2.5) < 0.15, np.abs(z - 4) < 0.4
    assert len(points) > 5000 and (~on_box & ~on_wall).mean() < flying
    assert np.sqrt(np.mean((z[on_box] - 2.5) ** 2)) < boxed and abs(np.median(z[on_box]) - 2.5) < 0.015
    assert abs(np.median(z[on_wall]) - 4) < 0.03
    # as wide and high as it is: edges are neither fattened nor eaten
    for axis, low, high in ((x, BOX.low[0], BOX.high[0]), (y, BOX.low[1], BOX.high[1])):
        edges = np.percentile(axis[on_box], [0.5, 99.5])
        np.testing.assert_allclose(edges, [low, high], atol=0.025)


def test_calibrated_by_projection_matrices(tmp_path):
    log = infos(Log())
    for i in range(3):
        images(log, i)
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert recording.sensors == (NAMES[0],) and recording.fixed_frame == "left_optical" and len(recording) == 3
    assert [f.time_ns for f in recording] == [START + i * PERIOD for i in range(3)]
    assert recording.up.tolist() == [0.0, -1.0, 0.0]
    for frame in recording:
        check(frame.points)
    np.testing.assert_array_equal(recording.frames[0].points, recording.frames[2].points)
    uses = {t.topic: t.use for t in survey(tmp_path / "a.mcap").topics}
    assert uses[NAMES[0]] == "stereo pair" and uses[NAMES[1]] == f"right image of '{NAMES[0]}'"


def test_ranges_and_number_of_points(tmp_path):
    path = images(infos(Log()), 0).write(tmp_path / "a.mcap")
    frame = read_log(path, ReadSettings(max_range=3.0, max_points=5000)).frames[0]
    distance = np.linalg.norm(frame.points, axis=1)
    assert 300 < len(frame.points) <= 5000 and distance.max() <= 3.0
    assert np.abs(frame.points[:, 2] - 2.5).max() < 0.3


@pytest.mark.parametrize("d", [(), (-0.2, 0.05, 0.001, -0.001, 0.0)])
def test_calibrated_by_transforms(tmp_path, d):
    """Cameras that are turned towards each other, with lenses, and only transforms to say how they stand."""
    turn = Rotation.from_euler("xyz", [0.01, -0.05, 0.02])
    place = np.array([BASE, 0.004, -0.006])
    right = picture(BOARDS, K, SIZE, place, turn.as_matrix(), d)
    log = Log().add("/rig/left/camera_info", START, ros_info("left_optical", K, SIZE, d))
    log.add("/rig/right/camera_info", START, ros_info("right_optical", K, SIZE, d))
    tf = (START, "left_optical", "right_optical", tuple(place), tuple(turn.as_quat()))
    log.add("/tf_static", START, ros_tf((START, "base", "left_optical", (0.0, 0.0, 1.25), (-0.5, 0.5, -0.5, 0.5)), tf))
    images(log, 0, picture(BOARDS, K, SIZE, d=d), right)
    frame = read_log(log.write(tmp_path / "a.mcap")).frames[0]
    x, y, z = frame.points.T
    check(np.column_stack([-y, 1.25 - z, x]), boxed=0.04)


def test_rectified_by_the_calibration(tmp_path):
    """R and P as a stereo calibration writes them: the left camera's frame is that of the rectified image."""
    turn = Rotation.from_euler("xyz", [0.01, -0.04, 0.02]).as_matrix()
    d, p = (-0.15, 0.03, 0.0, 0.0, 0.0), np.array([[380.0, 0.0, 155.0], [0.0, 380.0, 121.0], [0.0, 0.0, 1.0]])
    log = Log().add("/rig/left/camera_info", START, ros_info("left_optical", K, SIZE, d, r=turn, p=p))
    log.add("/rig/right/camera_info", START, ros_info("right_optical", K, SIZE, d, -380 * BASE, turn.T, p))
    images(log, 0, picture(BOARDS, K, SIZE, turn=turn, d=d), picture(BOARDS, K, SIZE, (BASE, 0, 0), turn.T, d))
    check(read_log(log.write(tmp_path / "a.mcap")).frames[0].points, boxed=0.04)


def test_rectified_raw_images_of_half_size(tmp_path):
    names = ("/rig/left/image_rect", "/rig/right/image_rect")
    large = (480, 640)
    double = np.array([[800.0, 0.0, 319.5], [0.0, 800.0, 239.5], [0.0, 0.0, 1.0]])
    log = Log().add("/rig/left/camera_info", START, ros_info("left_optical", double, large, (-0.3,) + (0.0,) * 4))
    log.add(
        "/rig/right/camera_info", START, ros_info("right_optical", double, large, (-0.3,) + (0.0,) * 4, -800 * BASE)
    )
    log.add(names[0], START, ros_raw(START, "left_optical", "mono8", LEFT[..., :1]))
    log.add(names[1], START, ros_raw(START, "right_optical", "bgr8", RIGHT))
    images(log, 0, LEFT[::-1], RIGHT[::-1])  # not rectified: the others are better
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert recording.sensors == (names[0],)
    check(recording.frames[0].points)


def test_large_images_are_shrunk(tmp_path):
    big = np.array([[1600.0, 0.0, 639.5], [0.0, 1600.0, 479.5], [0.0, 0.0, 1.0]])
    size = (960, 1280)
    log = Log().add("/left/camera_info", START, ros_info("l", big, size))
    log.add("/right/camera_info", START, ros_info("r", big, size, p03=-1600 * BASE))
    stamp = START
    log.add("/left/image", stamp, ros_compressed(stamp, "l", picture(BOARDS, big, size)))
    log.add("/right/image", stamp, ros_compressed(stamp, "r", picture(BOARDS, big, size, (BASE, 0, 0))))
    check(read_log(log.write(tmp_path / "a.mcap")).frames[0].points)


@pytest.mark.parametrize("gain, offset", [(0.8, 10), (1.0, 0), (1.2, -15)])
def test_cameras_of_different_exposure_and_boards_of_little_texture(tmp_path, gain, offset):
    pale = 110 + 0.3 * (np.stack([LEFT, RIGHT]).astype(float) - 110)
    pale[1] = gain * pale[1] + offset
    pale += np.random.default_rng(3).normal(0, 2, (2, *SIZE, 1))
    left, right = np.clip(pale, 0, 255).astype(np.uint8)
    log = images(infos(Log()), 0, left, right)
    check(read_log(log.write(tmp_path / "a.mcap")).frames[0].points)


@pytest.mark.parametrize("side", ["left", "right"])
def test_what_is_at_the_border_of_the_picture_is_matched_as_far_as_both_cameras_see_it(tmp_path, side):
    low, high = (-1.6, -0.7) if side == "left" else (0.5, 1.6)
    boards = [Board(4.0), Board(2.5, (low, -0.5), (high, 0.4))]
    log = images(infos(Log()), 0, picture(boards, K, SIZE), picture(boards, K, SIZE, (BASE, 0, 0)))
    x, y, z = read_log(log.write(tmp_path / "a.mcap")).frames[0].points.T
    near = np.abs(z - 2.5) < 0.15
    # the left camera's picture ends 1 m to each side; the right one sees 12 cm less of it on the left
    seen = (-0.88, high) if side == "left" else (low, 1.0)
    np.testing.assert_allclose(np.percentile(x[near], [0.5, 99.5]), seen, atol=0.03)


def test_partners():
    left = np.array([0, 100, 200, 300, 400])
    assert partners(left, np.array([1, 201, 99, 430, 303])) == {0: 0, 1: 2, 2: 1, 3: 4}  # 430 is too far from 400
    assert partners(left, np.array([195, 204])) == {2: 1}  # the nearer one, and each once
    assert partners(left, np.zeros(0, np.int64)) == partners(np.zeros(0, np.int64), left) == {}


def test_images_that_come_apart(tmp_path):
    """First all left images, then the right ones: those that waited too long are lost, the others are paired."""
    log = infos(Log())
    tiny = np.zeros((24, 32, 3), np.uint8)
    for i in range(70):
        log.add(NAMES[0], START, ros_compressed(START + i * PERIOD, "left_optical", LEFT if i > 67 else tiny))
    for i in range(70):
        log.add(NAMES[1], START, ros_compressed(START + i * PERIOD, "right_optical", RIGHT if i > 67 else tiny))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert (
        f"'{NAMES[0]}': 6 messages left out, without an image of the other camera at the same time." in recording.notes
    )
    assert [f.time_ns for f in recording] == [START + i * PERIOD for i in range(6, 70)]
    assert all((len(f.points) > 5000) == (i > 61) for i, f in enumerate(recording))


def test_broken_and_missing_images_are_said(tmp_path):
    log = infos(Log())
    for i in range(5):
        images(log, i)
    log.items[4][2].data = log.items[4][2].data[:100]  # left, second pair
    log.items.pop(9)  # right, fourth pair
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert [f.time_ns for f in recording] == [START + i * PERIOD for i in (0, 2, 4)]
    assert sorted(recording.notes) == [
        f"'{NAMES[0]}': 1 message cannot be decoded, left out.",
        f"'{NAMES[0]}': 1 message left out, without an image of the other camera at the same time.",
        "(The log has no transforms: results are in the frame of its measurements, 'left_optical'.)",
        "The log is damaged: 1 message that frames were to be made of is lost.",
    ]


def test_foxglove_images(tmp_path):
    log = infos(Log())
    log.add("/rig/left/image", START, foxglove_compressed(START, "left_optical", LEFT))
    log.add("/rig/right/image", START, foxglove_compressed(START, "right_optical", RIGHT))
    check(read_log(log.write(tmp_path / "a.mcap")).frames[0].points)


@pytest.mark.parametrize(
    "p03, right, why",
    [
        (0.0, "right_optical", "the distance of its cameras is unknown"),
        (K[0, 0] * BASE, "right_optical", "the right camera must be 0.005 to 2 m to the right"),
        (-K[0, 0] * 5, "right_optical", "the right camera must be 0.005 to 2 m to the right"),
    ],
)
def test_wrong_calibrations(tmp_path, p03, right, why):
    path = images(infos(Log(), p03, right=right), 0).write(tmp_path / "a.mcap")
    with pytest.raises(LogError, match=f"a stereo pair, but {why}"):
        read_log(path)
    assert why in {t.topic: t.use for t in survey(path).topics}[NAMES[0]]


def test_no_calibration(tmp_path):
    with pytest.raises(LogError, match=f"a stereo pair, but no calibration for '{NAMES[0]}'"):
        read_log(images(Log(), 0).write(tmp_path / "a.mcap"))


def test_beside_depth_cameras(tmp_path):
    log = images(infos(depth_log(1)), 0)
    log.add("/tf_static", START, ros_tf((START, "base", "left_optical", (0.0, 0.0, 1.0), (-0.5, 0.5, -0.5, 0.5))))
    path = log.write(tmp_path / "a.mcap")
    both = read_log(path)  # another camera's depth: both are used
    assert both.sensors == ("/cam/depth", NAMES[0]) and len(both) == 1 and set(both.frames[0].sensor) == {0, 1}
    assert read_log(path, ReadSettings(stereo=False)).sensors == ("/cam/depth",)
    assert read_log(path, ReadSettings(topics=(NAMES[0],))).sensors == (NAMES[0],)
    log.items = [("/rig/depth" if topic == "/cam/depth" else topic, t, m) for topic, t, m in log.items]
    log.items = [("/rig/camera_info" if topic == "/cam/camera_info" else topic, t, m) for topic, t, m in log.items]
    path = log.write(tmp_path / "b.mcap")  # the rig's own depth: the pair is not needed
    assert read_log(path).sensors == ("/rig/depth",) and read_log(path).notes == ()
    use = {t.topic: t.use for t in survey(path).topics}[NAMES[0]]
    assert use == "not used: a stereo pair, but '/rig/depth' gives the depth of its rig"
    assert read_log(path, ReadSettings(topics=(NAMES[0],))).sensors == (NAMES[0],)


def test_half_turn_is_no_matter(tmp_path):
    """The fixed frame may be anywhere: the cloud comes out in it."""
    log = images(infos(Log()), 0)
    log.add("/tf_static", START, ros_tf((START, "room", "left_optical", (1.0, 2.0, 3.0), (0.0, 0.0, HALF, HALF))))
    frame = read_log(log.write(tmp_path / "a.mcap")).frames[0]
    x, y, z = (frame.points - [1.0, 2.0, 3.0]).T
    check(np.column_stack([y, -x, z]))
    np.testing.assert_allclose(frame.origins, [[1.0, 2.0, 3.0]])
