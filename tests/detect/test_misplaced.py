"""Sensors whose transforms are wrong beside each other: found by the surfaces that both see."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.logs import START, Log, ros_calibration, ros_cloud, ros_image, ros_tf
from tests.support.rooms import box, figure, room
from voodoo_jax import read_log
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.detect.camera_motion import moved, turned
from voodoo_jax.detect.opening import Surface, correction, normals_of

HOME, UP = np.array([0, 0.3, 1.2]), np.array([0, 0, 1.0])


def scene(rng, i: int = 0) -> np.ndarray:
    things = [room(rng), figure(2.5, -0.5 + 0.02 * i), box(3.2, 0.9, 0.7, 1.1)]
    side = box(0, 0, 1.2, 0.9) @ Rotation.from_euler("z", 70, degrees=True).as_matrix().T + [3.0, -1.2, 0]
    return np.concatenate([*things, side]) + rng.normal(0, 0.003, (1, 3))


def log_of_two(rng, path, place, turn: Rotation):
    """Two sensors of one scene, of which the second has another transform than where it is (at HOME, unturned)."""
    log = Log()
    log.add("/tf_static", START, ros_tf((START, "base", "one", (0, 0, 1.2), (0, 0, 0, 1))))
    log.add("/tf_static", START, ros_tf((START, "base", "two", tuple(place), tuple(turn.as_quat()))))
    for i in range(20):
        at, cloud = START + i * 100_000_000, scene(rng, i)
        log.add("/one", at, ros_cloud(at, "one", cloud[::2] - [0, 0, 1.2]))
        log.add("/two", at, ros_cloud(at, "two", cloud[1::2] - HOME))
    return log.write(path)


def gap(recording) -> float:
    """How far the second sensor's part of the person is from the first one's, metres."""
    frame = recording.frames[0]
    near = (
        (np.abs(frame.points[:, 0] - 2.4) < 0.45)
        & (frame.points[:, 2] > 0.5)
        & (np.abs(frame.points[:, 1] + 0.5) < 0.5)
    )
    middles = [np.median(frame.points[near & (frame.sensor == k)], 0) for k in (0, 1)]
    return float(np.linalg.norm(middles[0] - middles[1]))


def test_a_wrong_transform_is_put_right_and_said(rng, tmp_path):
    wrong = HOME + [0.1, -0.06, 0.02], Rotation.from_euler("z", 4, degrees=True)
    recording = read_log(log_of_two(rng, tmp_path / "a.mcap", *wrong))
    (note,) = [note for note in recording.notes if "one of their transforms is wrong" in note]
    assert recording.sure == 0.5 and gap(recording) < 0.03  # clouds do not tell whose floor is level
    # either line settles it, and is believed
    lines = [part.split('"')[0] for part in note.split('--read.transform "')[1:]]
    put_right = read_log(tmp_path / "a.mcap", ReadSettings(transform=(lines[0],)))
    assert put_right.sure == 1 and gap(put_right) < 0.03
    other = read_log(tmp_path / "a.mcap", ReadSettings(transform=(lines[1],)))
    (note,) = [note for note in other.notes if "'/one' sees what '/two' sees" in note]
    one, two = (pose(words) for words in (note.split('--read.transform "')[1].split('"')[0], lines[1]))
    beside = np.eye(4)
    beside[:3, 3] = HOME - [0, 0, 1.2]
    np.testing.assert_allclose(np.linalg.inv(one) @ two, beside, atol=0.03)


def pose(words: str) -> np.ndarray:
    """A transform as read.transform has it."""
    numbers, T = np.array(words.split()[2:], float), np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3]
    return T


def test_level_surfaces_that_fit_hide_no_wrong_transform(rng):
    """Nearly all that both see is a floor, which fits after any level shift; the rest are some boards."""
    floor = np.column_stack([rng.uniform(0, 4, 4000), rng.uniform(-2, 2, 4000), np.zeros(4000)])
    ups = [np.tile(UP, (4000, 1))]
    boards = []
    for place, yaw in (((3.0, 1.0), 20), ((3.5, -1.0), -50), ((2.0, 1.5), 75)):
        turn = Rotation.from_euler("z", yaw, degrees=True).as_matrix()
        flat = np.column_stack([np.zeros(120), rng.uniform(-0.3, 0.3, 120), rng.uniform(0.1, 0.9, 120)])
        boards.append(flat @ turn.T + [*place, 0])
        ups.append(np.tile(-turn[:, 0], (120, 1)))
    whole = seen(np.concatenate([floor, *boards]), np.concatenate(ups))
    T = turned(np.array([0, 0, np.radians(4), 0.2, 0.1, 0]))
    found, doubt = correction(whole, [whole.under(T)] * 4, UP)
    assert doubt < 0.03 and np.abs(moved(moved(whole.points, T), found) - whole.points).max() < 0.02  # 0.4 unmoved
    assert np.array_equal(correction(whole, [whole] * 4, UP)[0], np.eye(4))


def test_right_transforms_are_left_alone(rng, tmp_path):
    recording = read_log(log_of_two(rng, tmp_path / "a.mcap", HOME, Rotation.identity()))
    assert recording.notes == () and recording.sure == 1


K = np.array([[70.0, 0, 39.5], [0, 70, 29.5], [0, 0, 1]])
OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # from optical axes to those of a body
BOARDS = (  # a point, a direction across and half a width, metres: a corner of a room, and boards on its floor
    ((4.0, 0.0), (0.0, 1.0), 3.0), ((2.0, 1.4), (1.0, 0.1), 3.0), ((2.6, -0.3), (0.5, 0.8), 0.3),
    ((3.0, 0.7), (0.9, -0.3), 0.25),
)  # fmt: skip


def pictured(place: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Depth of the floor and the boards, metres, from a place in a direction."""
    v, u = np.mgrid[0:60, 0:80]
    ways = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones((60, 80))], -1) @ turn.T
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(ways[..., 2] < 0, -place[2] / ways[..., 2], 9.0)
        for middle, across, wide in BOARDS:
            across = np.array(across) / np.linalg.norm(across)
            normal = np.array([-across[1], across[0]])
            far = (np.array(middle) - place[:2]) @ normal / (ways[..., :2] @ normal)
            beside = (place[:2] + far[..., None] * ways[..., :2] - middle) @ across
            depth = np.where((far > 0) & (np.abs(beside) < wide), np.minimum(depth, far), depth)
    return depth


def log_of_cameras(path, mirrored: tuple[str, ...], yaw: float):
    """Two depth cameras of one room, the second turned by `yaw` degrees; images of some are mirrored."""
    log, rng = Log(), np.random.default_rng(0)
    poses = {"one": (np.array([0, 0, 1.2]), 0.0), "two": (np.array([0.1, -yaw / 50, 1.3]), yaw)}
    for name, (place, angle) in poses.items():
        turn = Rotation.from_euler("zy", [angle, 15], degrees=True).as_matrix() @ OPTICAL
        q = tuple(Rotation.from_matrix(turn).as_quat().tolist())
        log.add("/tf_static", START, ros_tf((START, "base", name, tuple(place.tolist()), q)))
        log.add(f"/{name}/camera_info", START, ros_calibration(name, K, size=(60, 80)))
        depth = pictured(place, turn)[:, :: -1 if name in mirrored else 1]
        for i in range(12):
            at = START + i * 100_000_000
            log.add(f"/{name}/depth", at, ros_image(at, name, depth + rng.normal(0, 0.004, depth.shape)))
    return log.write(path)


@pytest.mark.parametrize(("yaw", "sure"), [(15.0, 1.0), (0.0, 0.5)])
def test_a_mirrored_camera_is_turned_round_and_said(yaw, sure, tmp_path):
    """Beside a right one that looks elsewhere; of two that look the same way nothing tells which is mirrored."""
    right, found = (read_log(log_of_cameras(tmp_path / f"{m}.mcap", m, yaw)) for m in ((), ("two",)))
    assert right.sure == 1 and not right.notes and found.sure == sure
    (note,) = [note for note in found.notes if "mirrored left to right" in note]
    assert "read.mirror" in note and ("nothing tells which" in note) == (sure < 1)
    second = [frame.points[frame.sensor == 1] for frame in (right.frames[0], found.frames[0])]
    assert np.median(np.linalg.norm(second[0] - second[1], axis=1)) < 0.03
    said = read_log(tmp_path / f"{('two',)}.mcap", ReadSettings(mirror=("/two/depth=x",)))
    assert said.sure == 1 and not said.notes


def patch(normal, middle, rng, size: float = 1.0) -> Surface:
    """A flat piece of a wall or floor."""
    across = np.linalg.svd(np.array(normal, float)[None])[2][1:]
    points = rng.uniform(-size, size, (800, 2)) @ across + middle
    return seen(points, np.broadcast_to(np.array(normal, float), points.shape))


def seen(points, normals, eye=(0, 0, 1.2)) -> Surface:
    """Surfaces that a sensor sees."""
    return Surface(points, normals, np.tile(eye, (len(points), 1)).astype(float))


@pytest.mark.parametrize("walls, sure", [([(-1, 0, 0), (0, 1, 0)], True), ([(-1, 0, 0)], False), ([], False)])
def test_what_the_surfaces_leave_open_is_doubted(rng, walls, sure):
    """The floor tells height and slope, one wall a shift and a turn, the corner all."""
    shift = np.array([0.09, 0.08, 0.07])
    there = [patch((0, 0, 1), (3, 0, 0), rng), *(patch(n, -1.0 * np.array(n) + [3, 0, 1], rng) for n in walls)]
    whole = Surface(*map(np.concatenate, zip(*there)))
    T, doubt = correction(whole, [seen(whole.points + shift, whole.normals)] * 4, UP)
    assert (doubt < 0.03) == sure and abs(T[2, 3] + shift[2] + (T[2, :3] - UP) @ [3, 0, 0.5]) < 0.02
    if sure:
        np.testing.assert_allclose(T[:3, 3] + (T[:3, :3] - np.eye(3)) @ [3, 0, 0.5], -shift, atol=0.01)


def test_what_another_sensor_sees_through_is_not_there(rng):
    wall, before = (patch((-1, 0, 0), (x, 0, 1), rng) for x in (4.0, 3.0))
    assert wall.seen_through(before) == 0 and wall.seen_through(wall) == 0  # hidden, and the same
    assert before.seen_through(wall) > 0.5  # beside the wall nothing is known


def test_normals_as_by_eigenvectors(rng):
    patches = rng.normal(size=(50, 12, 3)) * [1, 0.7, 0.05] @ Rotation.random(rng=np.random.default_rng(1)).as_matrix()
    patches -= patches.mean(1, keepdims=True)
    normals, flat = normals_of(patches)
    least = np.linalg.eigh(np.einsum("kpi,kpj->kij", patches, patches))[1][:, :, 0]
    assert flat.all() and (np.abs(np.sum(normals * least, 1)) > 0.999).all()
    assert normals_of(rng.normal(size=(50, 12, 3)))[1].mean() < 0.3
