"""Which people do what before which camera."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from experiments.people.bodies import UNUSUAL, USUAL
from experiments.people.paths import PATHS
from experiments.people.pictures import DAY, RIGS, Light
from voodoo_jax.simulate.sensor import TOF_NOISE, Camera, Noise, tof_camera

CLIPS = {"walk": 2, "run": 1, "jump": 2, "kick": 1, "punch": 1, "spinkick": 1, "dance_a": 1, "dance_b": 1, "spin": 1}
FLOOR = ("crawl", "getup_facedown", "getup_faceup", "roll", "cartwheel")
POSED = {"exercise": 8, "begins in some pose": 4, "sits down and stands up": 6, "sits all the time": 6}
SEATED = tuple(POSED)[2:]
FILMED = ("walk", "kick", "dance_b", "punch", "run", "exercise")  # by a camera that moves
IN_THE_AIR = ("jump", "spinkick", "run")
VIEWS = 8  # of each clip by the usual people


def camera_of(width: int, height: int, focal: float) -> Camera:
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, (0.0, 0.0, 1.2), 0.07)


CAMERAS = {
    "time of flight, 160x124": (tof_camera(), TOF_NOISE),
    "Kinect": (camera_of(640, 480, 580.0), Noise(0.001, 3e-4, 0.3, 0.01, 0.15, disparity=580 * 0.075 * 8, max_range=8)),
    "Kinect 2": (camera_of(512, 424, 366.0), Noise(0.002, 6e-4, 0.3, 0.01, 0.1, max_range=6)),
    "RealSense": (camera_of(848, 480, 420.0), Noise(0.001, 2e-3, 0.5, 0.02, 0.1, max_range=8)),
    "Azure Kinect": (camera_of(640, 576, 504.0), Noise(0.003, 6e-4, 0.3, 0.01, 0.1, max_range=5.5)),
}


@dataclass(frozen=True)
class Take:
    """One log."""

    row: str
    name: str
    person: int
    clip: str
    yaw: float  # from facing the camera, radians
    mirrored: bool
    speed: float
    camera: str
    furnished: bool
    seed: int
    meshes: Path
    motions: Path
    logs: Path
    path: str = ""  # of the camera, see paths.py; "": it stands
    told: bool = True  # the log's transforms tell how it moves, or lies
    roll: float = 0.0  # of the camera, radians
    stage: float = 0.0  # height of what somebody stands on, metres
    most: int = 0  # frames of the clip, its liveliest ones; 0: all
    light: Light = DAY  # of pictures


def takes(meshes: Path, motions: Path, logs: Path, seed: int) -> list[Take]:
    """Every clip by usual people from all sides, and by unusual ones before other cameras too; then poses drawn at
    random, people on chairs and on the floor. Other seeds turn and place them otherwise."""
    rng, found, cameras = np.random.default_rng(seed), [], list(CAMERAS)
    take = partial(Take, meshes=meshes, motions=motions, logs=logs)
    order = rng.permutation(USUAL)
    for clip in CLIPS:
        for view in range(VIEWS):
            found.append(take(
                clip, f"{clip}-{view}", int(order[len(found) % USUAL]), clip,
                2 * np.pi * view / VIEWS + float(rng.uniform(-0.3, 0.3)), bool(rng.integers(2)),
                float(rng.uniform(0.75, 1.0)), cameras[0], False, len(found),
            ))  # fmt: skip
    for who in range(len(UNUSUAL)):
        for turn in range(2):
            clip = ("walk", "punch", "dance_b", "kick")[(who + 2 * turn) % 4]
            camera = cameras[(1 + who % 4) * turn]
            found.append(take(
                "unusual people" if turn == 0 else "the same, other cameras", f"unusual-{who}-{turn}", USUAL + who,
                clip, (0.2, -0.7, 1.0, -0.3)[(who + turn) % 4], bool(who % 2), 0.9, camera, turn == 1, len(found),
            ))  # fmt: skip
    for what, count in [*POSED.items(), *((clip, 2) for clip in FLOOR)]:
        for k in range(count):
            ahead = what in SEATED
            found.append(take(
                "on the floor" if what in FLOOR else what, f"{what.replace(' ', '-')}-{k}",
                int(rng.integers(USUAL + len(UNUSUAL))), what,
                float(rng.uniform(-1.2, 1.2) if ahead else rng.uniform(-np.pi, np.pi)), bool(rng.integers(2)),
                0.85, cameras[k % len(cameras) if ahead else 0], False, len(found),
            ))  # fmt: skip
    for told, count in ((True, 12), (False, 6)):
        for k in range(count):
            found.append(take(
                "moving camera" if told else "camera in a hand, untold", f"{'moving' if told else 'untold'}-{k}",
                int(rng.integers(USUAL + len(UNUSUAL))), FILMED[(k + k // len(PATHS)) % len(FILMED)],
                float(rng.uniform(-np.pi, np.pi)), bool(rng.integers(2)), 0.85, cameras[0], False, len(found),
                path=PATHS[k % len(PATHS)] if told else PATHS[-1], told=told,
            ))  # fmt: skip
    for k in range(12):
        lies = k < 6
        found.append(take(
            "camera on its side or head, untold" if lies else "on a stage", f"{'rolled' if lies else 'stage'}-{k % 6}",
            int(rng.integers(USUAL + len(UNUSUAL))), FILMED[k % len(FILMED)], float(rng.uniform(-np.pi, np.pi)),
            bool(rng.integers(2)), 0.85, cameras[0], False, len(found), told=not lies,
            roll=(k % 3 + 1) * np.pi / 2 if lies else 0.0, stage=0.0 if lies else float(rng.uniform(0.12, 0.4)),
        ))  # fmt: skip
    for k in range(12):
        found.append(take(
            "stereo pair", f"stereo-{k}", int(rng.integers(USUAL + len(UNUSUAL))), FILMED[k % len(FILMED)],
            float(rng.uniform(-1.0, 1.0)), bool(rng.integers(2)), 0.85, list(RIGS)[k % len(RIGS) if k % 2 else 0],
            bool(k % 4 == 3), len(found),
        ))  # fmt: skip
    return found
