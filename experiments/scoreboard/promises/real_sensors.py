"""Real depth cameras, a car's lidar and a radar: few have a truth, so each is asked what is known of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import voodoo_jax as vj
from experiments.scoreboard.board import Data, Figure, Job, Promise
from experiments.scoreboard.tracked import recording_of

HEADING = 15.0  # degrees
TRUNK = 0.25  # metres from the middle of the person's points to the neck, level: half a person's breadth
NECK = (0.15, 0.45)  # metres from the top of the head down to the neck, with room for a bent head
# metres ahead of the lidar and to its left: the nearest walkers. Labels are of what the car's camera sees ahead, where
# the nearest one is 8.7 m away; three who walk on the left side, 4.3 to 5 m away, are plain to see in the points
WALKERS, ABOUT = ((1.25, 4.3), (2.1, 3.8), (2.65, 4.3)), 0.5
LABELLED, FARTHER = 8.7, 0.7  # metres away, whatever the direction, and how far off is still them
STATURE = (1.5, 2.1)  # metres that a grown person may have


@dataclass(frozen=True)
class Turn:
    """An upper body before a structured-light camera turns round once; the turn is known, and that it begins facing us.

    The outcome: the share of the views in which it is found, and in which its heading is right, too.
    """

    log: Path
    seconds = 25.0

    def run(self) -> dict[str, float]:
        tracks = vj.track(vj.human(), recording_of(self.log))
        cut = recording_of(self.log.with_name("uva-turn-cut.mcap"))  # the same views with nothing but the person
        people = {frame.time_ns: np.asarray(frame.points) for frame in cut}
        with np.load(self.log.with_name("uva-turn.poses.npz"), allow_pickle=False) as file:
            poses = dict(zip(file["time_ns"].tolist(), file["pose"]))  # T_person_camera of each view
        views = range(len(tracks.time_ns))
        there = [tracks.tracked[i] and neck_inside(tracks.joint("vc7")[i], people[tracks.time_ns[i]]) for i in views]
        wrong = np.array([turned(heading(tracks, i), faced(poses[tracks.time_ns[i]])) for i in views])
        return {
            "turn: found, %": 100 * float(np.mean(there)),
            "turn: found, heading within 15 degrees, %": 100 * float(np.mean(there & (wrong < HEADING))),
        }


def neck_inside(neck: np.ndarray, points: np.ndarray) -> bool:
    """Whether a neck is where that of an upper body is, of which there are points on one side. Metres, z up."""
    down = np.percentile(points[:, 2], 99.5) - neck[2]
    return bool(np.hypot(*(np.median(points, 0) - neck)[:2]) < TRUNK and NECK[0] < down < NECK[1])


def heading(tracks: vj.Tracks, frame: int) -> np.ndarray:
    """[2] Where the shoulders face, level, metres."""
    left = (tracks.joint("l_shoulder") - tracks.joint("r_shoulder"))[frame]
    return np.array([left[1], -left[0]])


def faced(pose: np.ndarray) -> np.ndarray:
    """[2] Where somebody faces, level, who faced the camera in the first view. Fixed frame: x forward, y left.

    **Arguments:** `pose` [4, 4] turn of an optical frame (x right, y down, z forward) since the first view.
    """
    right, _, forward = pose[:3, :3].T @ np.array([0.0, 0.0, -1.0])
    return np.array([forward, -right])


def turned(one: np.ndarray, other: np.ndarray) -> float:
    """Degrees between two directions in the plane, 0 to 180."""
    cross, dot = one[0] * other[1] - one[1] * other[0], one @ other
    return abs(float(np.degrees(np.arctan2(cross, dot))))


@dataclass(frozen=True)
class Radar:
    """A radar of some 30 points a frame: too few for anybody to be claimed."""

    log: Path
    seconds = 10.0

    def run(self) -> dict[str, float]:
        tracks = vj.track(vj.human(), recording_of(self.log))
        return {"radar: claimed, %": 100 * float(tracks.tracked.mean())}


@dataclass(frozen=True)
class Lidar:
    """A scan of a car's lidar in a street: the nearest walker, or nothing."""

    log: Path
    seconds = 10.0

    def run(self) -> dict[str, float]:
        tracks = vj.track(vj.human(), recording_of(self.log))
        neck = tracks.joint("vc7")[:, :2]  # the fixed frame is below the lidar
        off = np.linalg.norm(neck[:, None] - np.array(WALKERS), axis=2).min(1)
        walker = (off < ABOUT) | (abs(np.linalg.norm(neck, axis=1) - LABELLED) < FARTHER)
        return {"lidar: something else claimed, %": 100 * float((tracks.tracked & ~walker).mean())}


@dataclass(frozen=True)
class Standing:
    """A person stands before a Kinect v2."""

    log: Path
    seconds = 10.0

    def run(self) -> dict[str, float]:
        tracks = vj.track(vj.human(), recording_of(self.log))
        plausible = STATURE[0] < float(tracks.body.scale) < STATURE[1]
        return {"standing: tracked at a plausible stature, %": 100 * float(tracks.tracked.mean() * plausible)}


JOBS: dict[str, type[Turn | Radar | Lidar | Standing]] = {
    "uva-turn": Turn, "uva-turn-cut": Turn, "mars-s1": Radar, "kitti-pedestrian": Lidar, "panoptic-stand": Standing,
}  # fmt: skip


def jobs(data: Data) -> Sequence[Job]:
    """A job for each log that is there; quick: all but one of the turns."""
    folder = None if data.recordings is None else data.recordings / "real"
    if folder is None or not folder.is_dir():
        return []
    return [job(folder / f"{name}.mcap") for name, job in JOBS.items() if not (data.quick and name == "uva-turn")]


def measure(outcomes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The mean of each figure over the jobs that have it."""
    names = dict.fromkeys(name for one in outcomes for name in one)
    return {name: float(np.mean([one[name] for one in outcomes if name in one])) for name in names}


PROMISE = Promise(
    name="real_sensors",
    sentence="Real sensors: an upper body that turns round is found and faces where it faces; of a radar's few points "
    "nothing is claimed, of a car's lidar the nearest walker or nothing.",
    data="five recordings in real/",
    figures=(
        Figure("turn: found, %", 90.0, "more", 3.0, 1),
        Figure("turn: found, heading within 15 degrees, %", 90.0, "more", 3.0, 1),
        Figure("radar: claimed, %", 0.0, tolerance=0.5, digits=1),
        Figure("lidar: something else claimed, %", 0.0, tolerance=10.0, digits=1),
        Figure("standing: tracked at a plausible stature, %", 99.0, "more", 5.0, 1),
    ),
    jobs=jobs,
    measure=measure,
)
