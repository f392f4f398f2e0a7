"""What is measured on simulated logs: several sensors, things that are held, and how still who stands still is held."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

import voodoo_jax as vj
from experiments.foxglove_log import depth_image, foxglove_log, put_camera
from voodoo_jax.config.options import DetectSettings, StartSettings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.model.body import scaled, site_points
from voodoo_jax.records.recording import Frame
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import Motion, make_motion, placed
from voodoo_jax.simulate.recording import Simulation, simulate
from voodoo_jax.simulate.room import Box, Room
from voodoo_jax.simulate.sensor import Camera, tof_camera

TOGETHER = 17_000_000  # nanoseconds: half a frame at 30 Hz
# simulated people may stand as still as nobody does
FROZEN = DetectSettings(skip=("drop_motionless",))
SHELF = Box(5.0, 0.3, (0.4, 1.1, 1.9), 0.2)
MISSING = 1.0  # metres that count where there is no answer, as for recordings


def errors(tracks: vj.Tracks, sim: Simulation) -> np.ndarray:
    """[frame, joint] Distances from the truth in each frame of a simulation, metres."""
    frame = np.abs(tracks.time_ns[None] - sim.time_ns[:, None]).argmin(1)
    error = np.linalg.norm(tracks.joints[frame] - sim.joints, axis=-1)
    near = np.abs(tracks.time_ns[frame] - sim.time_ns) < TOGETHER
    return np.where(np.isfinite(error) & near[:, None], error, MISSING)


def write_log(path: Path, views: Mapping[str, Simulation]) -> Path:
    """A log of several depth cameras, by name, that saw the same."""
    with open(path, "wb") as stream, foxglove_log(stream) as put:
        for name, sim in views.items():
            put_camera(put, int(sim.time_ns[0]), sim.camera, sim.fixed_frame, name, f"/{name}/camera_info")
        images = [
            (stamp, name, sim.camera, image)
            for name, sim in views.items()
            for stamp, image in zip(sim.time_ns.tolist(), sim.depth)
        ]
        for stamp, name, camera, image in sorted(images, key=lambda item: item[:2]):
            put(f"/{name}/depth", stamp, depth_image(camera, name, image))
    return path


def camera(x: float, y: float, yaw: float) -> Camera:
    """A time-of-flight camera a metre above the floor."""
    return Camera(160, 124, 182.0, 182.0, 79.5, 61.5, (x, y, 1.0), 0.07, yaw)


@dataclass(frozen=True)
class TwoCameras:
    """Somebody between two cameras, 30 and 15 Hz, whose frames are not of the same times; with both, and the first.

    The outcome: mean joint error with both and with the first alone, cm.
    """

    motion: str
    stature: float  # metres
    facing: float  # degrees from away from the first camera, to its left
    beside: bool  # the second camera looks from the side, not from behind
    seconds = 12.0

    def run(self) -> tuple[float, float]:
        body = scaled(vj.human(), self.stature)
        motion = placed(make_motion(body, self.motion, 2.0, 60.0), 3.0, 0.0, np.radians(self.facing))
        room = Room(wall=6.6, boxes=())
        views = {
            "first": (camera(0.0, 0.0, 0.0), np.arange(0, 120, 2)),
            "second": (camera(3.0, -3.0, np.pi / 2) if self.beside else camera(6.0, 0.0, np.pi), np.arange(1, 118, 4)),
        }
        seen = {
            name: simulate(body, part(motion, rows), view, room=room, seed=seed)
            for seed, (name, (view, rows)) in enumerate(views.items())
        }
        with tempfile.TemporaryDirectory() as folder:
            both, one = (
                vj.track(vj.human(), vj.read_log(write_log(Path(folder) / "log.mcap", some)))
                for some in (seen, {"first": seen["first"]})
            )
        mean = lambda tracks: 100 * float(errors(tracks, seen["first"]).mean())  # noqa: E731
        return mean(both), mean(one)


def part(motion: Motion, rows: np.ndarray) -> Motion:
    """Some frames of a motion."""
    return Motion(motion.time[rows], motion.root[rows], motion.rotations[rows])


@dataclass(frozen=True)
class PickedUp:
    """Somebody waves, picks up a stick and puts it down; the settings say when, and where it is held or also how.

    The outcome: mean error of the body's joints, and mean and median of the stick's ends while it is there, cm.
    """

    stature: float  # metres
    known: bool  # the settings give the direction of the stick
    seconds = 12.0
    UP, DOWN = 1.0, 2.4  # seconds

    def run(self) -> tuple[float, float, float]:
        at, grip, axis = (0.0, 0.0, 0.06), (0.0, 0.0, 0.4), (1.0, 0.0, 0.3)
        stick = vj.load_body("stick")
        body = scaled(vj.attach(vj.human(), stick, "r_hand", at=at, grip=grip, axis=axis), self.stature)
        motion = placed(make_motion(body, "wave", 3.4), 2.6, 0.0, np.pi)
        present = np.ones((len(motion), body.limb_count), bool)
        present[:, -1] = (motion.time >= self.UP) & (motion.time < self.DOWN)
        sim = simulate(body, motion, present=present)
        pick = vj.Change(self.UP, add="stick", to="r_hand", at=at, grip=grip, axis=axis if self.known else ())
        start = StartSettings(scale=self.stature)
        settings = vj.Settings(changes=(pick, vj.Change(self.DOWN, remove=("stick",))), start=start, detect=FROZEN)
        with tempfile.TemporaryDirectory() as folder:
            tracks = vj.track(vj.human(), vj.read_log(write_simulation(sim, Path(folder) / "stick.mcap")), settings)
        count = len(vj.human().topology.centres)
        joints = errors(tracks, sim)[:, :count]
        stick = stick_errors(tracks, sim, np.flatnonzero(present[:, -1]))
        return 100 * float(joints.mean()), 100 * float(stick.mean()), 100 * float(np.median(stick))


def stick_errors(tracks: vj.Tracks, sim: Simulation, frames: np.ndarray) -> np.ndarray:
    """[frame] Mean distance of a stick's ends from the truth, metres. Which end is which nobody can see."""
    away = []
    for i in frames:
        want = ends(sim.body, sim.rotation[i], sim.translation[i])
        got = ends(tracks.body, tracks.rotation[i], tracks.translation[i])
        each = [np.linalg.norm(got - w, axis=1).mean() for w in (want, want[::-1])]
        away.append(min(each) if np.isfinite(each).all() else MISSING)
    return np.array(away)


def ends(body: vj.Body, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """[2, 3] The ends of the stick, metres, fixed frame."""
    sites = np.asarray(site_points(body, Poses(jnp.asarray(rotation), jnp.asarray(translation))))
    return sites[[body.topology.sites.index(name) for name in ("stick_bottom", "stick_top")]]


@dataclass(frozen=True)
class StandingStill:
    """Somebody stands still before a time-of-flight camera. The outcome: how much joints tremble, mm."""

    stature: float  # metres
    away: float  # from the camera, metres
    seconds = 6.0

    def run(self) -> float:
        body = scaled(vj.human(), self.stature)
        still = placed(make_motion(body, "stand", 2.0), self.away, 0.0, np.pi)
        sim = simulate(body, still, tof_camera())
        with tempfile.TemporaryDirectory() as folder:
            recording = vj.read_log(write_simulation(sim, Path(folder) / "still.mcap"))
            tracks = vj.track(vj.human(), recording, vj.Settings(detect=FROZEN))
        joints = tracks.joints[8:-4].astype(float)  # but for the first and last, in which the smoothing begins
        return 1000 * float(np.sqrt(np.mean(np.sum((joints - joints.mean(0)) ** 2, -1))))


@dataclass(frozen=True)
class MisplacedCamera:
    """Somebody before two cameras, of which the second is not where the log says.

    The outcome: how far its points are from where they should be beside the first one's, as the log has it and as it is
    read, cm; whether a note says so; and the probability that places are right.
    """

    motion: str
    stature: float  # metres
    facing: float  # degrees
    second: tuple[float, float, float]  # x, y, metres, and yaw, degrees
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)  # metres
    turn: tuple[float, float] = (0.0, 0.0)  # degrees of yaw and pitch
    seconds = 4.0

    def run(self) -> tuple[float, float, bool, float]:
        body = scaled(vj.human(), self.stature)
        motion = placed(make_motion(body, self.motion, 2.0, 30.0), 3.0, 0.0, np.radians(self.facing))
        x, y, yaw = self.second
        views = {"first": camera(0.0, 0.0, 0.0), "second": camera(x, y, np.radians(yaw))}
        room = Room(
            wall=6.6, boxes=(Box(2.9, 0.95, (0.5, 0.45, 0.75), 0.3), Box(4.0, -1.1, (0.6, 0.9, 1.0), -0.5), SHELF)
        )
        seen = {
            name: simulate(body, part(motion, np.arange(0, 60, 4)), view, room=room, seed=seed)
            for seed, (name, view) in enumerate(views.items())
        }
        right = views["second"]
        place = tuple(float(a + b) for a, b in zip(right.position, self.shift))
        yaw, pitch = np.radians(self.turn)
        wrong = replace(right, position=place, yaw=right.yaw + yaw, pitch=right.pitch + pitch)
        with tempfile.TemporaryDirectory() as folder:
            true = next(open_log(write_log(Path(folder) / "true.mcap", seen)).frames())  # as it is, not put right
            moved = seen | {"second": replace(seen["second"], camera=wrong)}
            log = write_log(Path(folder) / "moved.mcap", moved)
            read, as_given = vj.read_log(log), next(open_log(log).frames())
        said = any("transforms is wrong" in note for note in read.notes)
        return _beside(as_given, true), _beside(read.frames[0], true), said, read.sure


def _beside(frame: Frame, true: Frame) -> float:
    """How far the second sensor's points are from where they should be beside the first one's, cm."""
    (first, second), (first_true, second_true) = (
        [f.points[f.sensor == k].astype(float) for k in (0, 1)] for f in (frame, true)
    )
    middle, middle_true = first.mean(0), first_true.mean(0)
    turn = Rotation.align_vectors(first_true - middle_true, first - middle)[0]
    return 100 * float(np.linalg.norm(turn.apply(second - middle) + middle_true - second_true, axis=1).mean())


@dataclass(frozen=True)
class Scan:
    """Somebody who stands in a room, in one cloud of points (PLY) of several cameras around them.

    The outcome: mean joint error, cm; whether it is said to be tracked; mean confidence.
    """

    stature: float  # metres
    arms: float  # degrees from hanging to raised, both
    facing: float  # radians from towards the first camera
    cameras: int
    seconds = 1.0

    def run(self) -> tuple[float, float, float]:
        body = scaled(vj.human(), self.stature)
        motion = make_motion(body, "stand", 0.04, 30.0)
        turns = np.array(motion.rotations)
        for joint, side in (("l_shoulder", 1), ("r_shoulder", -1)):
            turns[:, body.topology.joints.index(joint)] = [side * np.radians(self.arms), 0, 0]
        motion = replace(motion, rotations=turns)
        lens = Camera(320, 288, 208.0, 226.0, 159.5, 143.5, (0.0, 0.0, 1.2), 0.07)
        clouds, truth = [], np.zeros((0, 3))
        for k in range(self.cameras):
            turn = Rotation.from_euler("z", 2 * np.pi * k / self.cameras)  # the person turns before one camera
            facing = np.pi + self.facing - 2 * np.pi * k / self.cameras
            room = Room(wall=None if k else 4.5, boxes=())
            seen = simulate(body, placed(motion, 3.0, 0.0, facing), lens, room=room, seed=k)
            truth = truth if k else seen.joints[0]
            depth = seen.depth[0].ravel() * 1e-3
            points = np.array(lens.position) + (lens.rays() * depth[:, None])[depth > 0]
            clouds.append(turn.apply(points - [3.0, 0, 0]) + [3.0, 0, 0])
        with tempfile.TemporaryDirectory() as folder:
            trimesh.PointCloud(np.concatenate(clouds)).export(Path(folder) / "scan.ply")
            tracks = vj.track(vj.human(), vj.read_log(Path(folder) / "scan.ply"))
        error = np.linalg.norm(tracks.joints[0] - truth, axis=1)
        return 100 * float(np.nan_to_num(error, nan=MISSING).mean()), float(tracks.tracked.mean()), _sure(tracks)


def _sure(tracks: vj.Tracks) -> float:
    return float(np.nan_to_num(tracks.confidence).mean())
