"""Sensors of several rigs in one recording: each with its own rate, place and pauses."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.logs import (
    HEIGHT,
    START,
    WIDTH,
    Log,
    depth_metres,
    ros_calibration,
    ros_cloud,
    ros_image,
    ros_laser,
    ros_tf,
    with_field,
)
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.records.recording import Recording
from voodoo_jax.simulate.motion import Motion, make_motion, placed, pose_body
from voodoo_jax.simulate.recording import render, simulate
from voodoo_jax.simulate.room import Room
from voodoo_jax.simulate.sensor import Camera
from voodoo_jax.trackers.front import track

LEVEL = (0.0, 0.0, 0.0, 1.0)
MS = 1_000_000
DEPTH, LIDAR, STEREO, LASER = 0, 1, 2, 3


def spinning(lines: int = 8, step: float = 0.02) -> np.ndarray:
    """What a scanner of few lines sees of a round room."""
    a, e = np.meshgrid(np.arange(0, 2 * np.pi, step), np.linspace(-0.3, 0.3, lines))
    return 3 * np.stack([np.cos(a), np.sin(a), np.tan(e)], -1).reshape(-1, 3)


def stereo() -> np.ndarray:
    v, u = np.mgrid[0:40, 0:50]
    return 2.5 * np.stack([np.ones(u.size), (u.ravel() - 25) / 70, (v.ravel() - 20) / 70], -1)


def rig(tmp_path, depth=(), lidar=(), clouds=(), laser=()) -> tuple[Recording, list[list[int]]]:
    """A log of four sensors with stamps in ms from START; the recording, and for each frame its stamp in ms and the
    number of points of each sensor."""
    log = Log().add("/cam/info", START, ros_calibration("cam"))
    frames = ("cam", "lidar", "stereo", "laser")
    log.add("/tf_static", START, ros_tf(*[(START, "base", f, (0.0, 0.0, 1.0), LEVEL) for f in frames]))
    at = lambda ms: START + round(ms * MS)  # noqa: E731
    for t in map(at, depth):
        log.add("/cam/depth", t, ros_image(t, "cam", depth_metres()))
    for t in map(at, lidar):
        log.add("/lidar", t, ros_cloud(t, "lidar", spinning()))
    for t in map(at, clouds):
        log.add("/stereo", t, ros_cloud(t, "stereo", stereo()))
    for t in map(at, laser):
        log.add("/x/laser", t, ros_laser(t, "laser", -1.0, 0.1, [2.0] * 21))
    recording = read_log(log.write(tmp_path / "rig.mcap"), ReadSettings(laser=True))
    number = [
        recording.sensors.index(n) if n in recording.sensors else -1
        for n in ("/cam/depth", "/lidar", "/stereo", "/x/laser")
    ]
    rows = [[(f.time_ns - START) // MS, *(int((f.sensor == n).sum()) for n in number)] for f in recording]
    return recording, rows


def test_four_sensors_and_their_rates(tmp_path):
    """Depth at 30 Hz leads; stereo at 15, lidar at 10 and laser at 40 Hz with offsets join its frames."""
    depth = np.arange(0, 2000, 33.4)
    lidar, clouds, laser = np.arange(17, 2000, 100.0), np.arange(11, 2000, 66.8), np.arange(5, 2000, 25.0)
    _, rows = rig(tmp_path, depth, lidar, clouds, laser)
    assert [r[0] for r in rows] == [int(t) for t in depth]
    counts = np.array(rows)[:, 1:]
    assert (counts[:, DEPTH] == WIDTH * HEIGHT - 1).all()
    assert (counts[:, STEREO] > 0).sum() == len(clouds) and counts[:, STEREO].max() == 2000
    assert (counts[:, LIDAR] > 0).sum() == len(lidar)
    assert (counts[:, LASER] == 21).all()  # the nearest of a faster one


@pytest.mark.parametrize("offset", [-16.0, -5.0, 0.0, 5.0, 16.0])
def test_a_laser_at_any_offset_neither_stops_nor_makes_frames(tmp_path, offset):
    """It starts late, stops for a second, and ends after the depth."""
    depth = np.arange(0, 3000, 33.0)
    laser = [t + offset for t in np.arange(528, 3300, 83.0) if not 1200 < t < 2200]
    _, rows = rig(tmp_path, depth, laser=laser)
    assert [r[0] for r in rows] == [int(t) for t in depth]
    joined = sum(r[1 + LASER] > 0 for r in rows)
    assert joined == sum(t <= depth[-1] + 16.5 for t in laser)


def test_a_thin_lidar_faster_than_the_depth_does_not_lead(tmp_path):
    depth = np.array([t for k, t in enumerate(np.arange(0, 2000, 66.0)) if k % 7 != 3])  # some images got lost
    _, rows = rig(tmp_path, depth, lidar=np.arange(-300, 2300, 50.0))
    assert [r[0] for r in rows] == [int(t) for t in depth] and all(r[1 + LIDAR] for r in rows)


def test_a_thin_lidar_leads_in_long_pauses_only(tmp_path):
    depth = [*np.arange(2000, 3000, 33.0), *np.arange(3500, 4000, 33.0), *np.arange(6000, 6500, 33.0)]
    lidar = np.arange(0, 9000, 100.0)
    _, rows = rig(tmp_path, depth, lidar)
    alone = [r[0] for r in rows if not r[1 + DEPTH]]
    begin, pause, end = np.arange(0, 1900, 100), np.arange(4100, 5900, 100), np.arange(6600, 9000, 100)
    assert alone == [*begin, *pause, *end]
    assert sum(r[1 + DEPTH] > 0 for r in rows) == len(depth)
    _, rows = rig(tmp_path, lidar=lidar)
    assert [r[0] for r in rows] == lidar.tolist()


def test_dense_sensors_stand_in_for_each_other(tmp_path):
    """A stereo cloud of the density of the depth image goes on while that pauses, without a laser's help."""
    depth = [t for t in np.arange(0, 2000, 33.0) if not 700 < t < 1000]
    clouds = np.arange(4, 2000, 66.0)
    _, rows = rig(tmp_path, depth, clouds=clouds, laser=np.arange(1, 2000, 25.0))
    alone = [r[0] for r in rows if not r[1 + DEPTH]]
    assert alone == [t for t in clouds if 710 < t < 1006]
    assert all(r[1 + STEREO] == 2000 for r in rows if not r[1 + DEPTH])


def test_every_sensor_alone(tmp_path):
    times = [0, 40, 80]
    for k in range(4):
        _, rows = rig(tmp_path, *[times if k == sensor else [] for sensor in range(4)])
        assert [r[0] for r in rows] == times


@dataclass(frozen=True)
class Line(Camera):
    """A laser scanner: 2 radians around `yaw`, a level line."""

    def rays(self):
        angle = np.linspace(-1, 1, self.width) + self.yaw
        return np.stack([np.cos(angle), np.sin(angle), np.zeros(self.width)], -1)


def part_of(motion: Motion, rows) -> Motion:
    return Motion(motion.time[rows], motion.root[rows], motion.rotations[rows])


def camera(x: float, yaw: float) -> Camera:
    return Camera(160, 124, 182.0, 182.0, 79.5, 61.5, (x, 0.0, 1.0), 0.07, yaw)


@pytest.fixture(scope="module")
def two_sides(tmp_path_factory):
    """A person who stands sideways and waves between two depth cameras of 30 and 15 Hz, with a laser scanner at 12 Hz
    that stops for a second; the log, and the truth at the first camera's frames."""
    body = scaled(human(), 1.78)
    motion = placed(make_motion(body, "wave", 2.0, 60.0), 3.0, 0.0, np.pi / 2)
    room, log = Room(wall=6.6, boxes=()), Log()
    rows = {"front": np.arange(0, 120, 2), "back": np.arange(1, 118, 4)}
    truth = None
    for seed, (name, view) in enumerate({"front": camera(0.0, 0.0), "back": camera(6.0, np.pi)}.items()):
        sim = simulate(body, part_of(motion, rows[name]), view, room=room, seed=seed, start_ns=START)
        truth = truth or sim
        q = tuple(Rotation.from_matrix(view.rotation).as_quat())
        log.add("/tf_static", START, ros_tf((START, "base", name, view.position, q)))
        k = np.array([[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1]])
        log.add(f"/{name}/camera_info", START, ros_calibration(name, k, size=(124, 160)))
        for t, image in zip(sim.time_ns.tolist(), sim.depth):
            log.add(f"/{name}/depth", t, ros_image(t, name, image / 1000))
    line = Line(480, 1, 1, 1, 0, 0, (1.2, 1.6, 0.45), yaw=-0.8)
    log.add("/tf_static", START, ros_tf((START, "base", "laser", line.position, LEVEL)))
    rng = np.random.default_rng(5)
    for row in range(7, 120, 5):
        if not 30 <= row < 90:
            poses = pose_body(body, motion.root[row], motion.rotations[row])
            ranges = render(body, poses, line, room)[0].ravel() + rng.normal(0, 0.01, 480)
            t = START + round((motion.time[row] + rng.uniform(-0.007, 0.007)) * 1e9)
            log.add("/scan", t, ros_laser(t, "laser", -1.8, 2 / 479, ranges))
    log.items.sort(key=lambda item: item[1])
    return log.write(tmp_path_factory.mktemp("rig") / "two_sides.mcap"), truth


def test_a_person_between_two_cameras_and_a_laser(two_sides):
    """The front camera alone does not see the arm that waves, and errs by 8 cm."""
    path, truth = two_sides
    recording = read_log(path, ReadSettings(laser=True, weights=("/scan=0.5",)))
    assert recording.sensors == ("/back/depth", "/front/depth", "/scan") and recording.notes == ()
    assert [f.time_ns for f in recording] == truth.time_ns.tolist()  # the front camera leads, nobody else makes frames
    of = np.array([[(f.sensor == s).sum() > 0 for s in range(3)] for f in recording])
    assert of[:, 1].all() and of[:, 0].sum() == 30 and 10 <= of[:, 2].sum() <= 11
    tracks = track(human(), recording)
    error = np.linalg.norm(tracks.joints - truth.joints, axis=-1)
    assert tracks.tracked.all() and abs(float(tracks.body.scale) - 1.78) < 0.03
    assert error.mean() < 0.02 and np.percentile(error, 99) < 0.06


def test_a_log_of_assigned_points_only(tmp_path):
    """Somebody has cut the person out of the picture, and labelled the forearms: no floor, no wall, no free point."""
    body = scaled(load_body("human10"), 1.78)  # fewer limbs compile faster
    motion = placed(make_motion(body, "wave", 0.7, 12.0), 3.0, 0.0, np.pi)
    view, log = camera(0.0, 0.0), Log()
    sim = simulate(body, motion, view, room=None, start_ns=START)
    names = [*body.topology.limbs]
    log.add("/tf_static", START, ros_tf((START, "base", "people", (0.0, 0.0, 0.0), LEVEL)))
    for t, image, rotation, origin in zip(sim.time_ns.tolist(), sim.depth, sim.rotation, sim.translation):
        points = (view.rays() * (image.reshape(-1, 1) / 1000.0) + view.position)[image.ravel() > 0]
        label = np.full(len(points), 99, "u1")
        for number, name in enumerate(("l_forearm", "r_forearm"), 1):
            k = names.index(name)
            size = np.asarray(body.sizes[k])
            local = (points - origin[k]) @ Rotation.from_quat(rotation[k], scalar_first=True).as_matrix()
            inside = (np.abs(local[:, 2] / size[4] - 0.5) < 0.4) & (np.hypot(*local[:, :2].T) < 0.07)
            label[inside] = number
        log.add("/people", t, with_field(ros_cloud(t, "people", points), "label", label))
    settings = ReadSettings(labels=("1=l_forearm", "2=r_forearm", "99=body"))
    recording = read_log(log.write(tmp_path / "a.mcap"), settings)
    assert recording.notes == () and all(f.part is not None and (f.part >= 0).all() for f in recording)
    assert recording.frames[0].parts == ("l_forearm", "r_forearm", "body")
    tracks = track(load_body("human10"), recording)
    error = np.linalg.norm(tracks.joints - sim.joints, axis=-1)
    assert tracks.tracked.all() and error.mean() < 0.03
    assert tracks.evidence.points.tolist() == [len(f.points) for f in recording]  # not one is lost on the way
