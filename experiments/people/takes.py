"""Which people do what before which camera; one take made, tracked and judged. Worker processes import this."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.common import human
from experiments.judged import Verdict, judge, read
from experiments.people.bodies import UNUSUAL, USUAL
from experiments.people.figure import BONES, Figure, read_meshes
from experiments.people.motions import RATE, Clip, after_standing, read_clip, there_and_back
from experiments.people.paths import PATHS, moved
from experiments.people.poses import chair, exercise, planted, sitting
from experiments.people.recorded import Found, write, write_truth
from experiments.people.sight import before, beside, detections, in_camera, marked, pixels
from voodoo_jax.settings import Settings
from voodoo_jax.simulate import TOF_NOISE, Box, Camera, Noise, Room, add_noise, render_room, tof_camera

START_NS = 1_700_000_000_000_000_000
CLIPS = {"walk": 2, "run": 1, "jump": 2, "kick": 1, "punch": 1, "spinkick": 1, "dance_a": 1, "dance_b": 1, "spin": 1}
FLOOR = ("crawl", "getup_facedown", "getup_faceup", "roll", "cartwheel")
POSED = {"exercise": 8, "begins in some pose": 4, "sits down and stands up": 6, "sits all the time": 6}
SEATED = tuple(POSED)[2:]
FILMED = ("walk", "kick", "dance_b", "punch", "run", "exercise")  # by a camera that moves
IN_THE_AIR = ("jump", "spinkick", "run")
VIEWS = 8  # of each clip by the usual people
NEAREST, FARTHEST = 2.6, 5.0  # metres, of the middle of where somebody goes
STILL, EASED, HELD = 21, 15, 9  # frames: relaxed at first, taking the clip's first pose, holding its last one


def _camera(width: int, height: int, focal: float) -> Camera:
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, (0.0, 0.0, 1.2), 0.07)


CAMERAS = {
    "time of flight, 160x124": (tof_camera(), TOF_NOISE),
    "Kinect": (_camera(640, 480, 580.0), Noise(0.001, 3e-4, 0.3, 0.01, 0.15, disparity=580 * 0.075 * 8, max_range=8)),
    "Kinect 2": (_camera(512, 424, 366.0), Noise(0.002, 6e-4, 0.3, 0.01, 0.1, max_range=6)),
    "RealSense": (_camera(848, 480, 420.0), Noise(0.001, 2e-3, 0.5, 0.02, 0.1, max_range=8)),
    "Azure Kinect": (_camera(640, 576, 504.0), Noise(0.003, 6e-4, 0.3, 0.01, 0.1, max_range=5.5)),
}
FURNISHED = (
    Box(2.9, 1.55, (0.5, 0.45, 0.75), 0.3), Box(4.3, -1.6, (0.8, 1.2, 0.74), 0.1), Box(4.4, 2.0, (0.6, 0.8, 1.9)),
    Box(1.0, -0.9, (0.3, 0.4, 0.85)),
)  # fmt: skip


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


def takes(meshes: Path, motions: Path, logs: Path) -> list[Take]:
    """Every clip by usual people from all sides, and by unusual ones before other cameras too; then poses drawn at
    random, people on chairs and on the floor."""
    rng, found, cameras = np.random.default_rng(5), [], list(CAMERAS)
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
    return found


def work(take: Take) -> Verdict:
    """Makes the log if there is none, tracks it, judges the tracks."""
    path = take.logs / f"{take.name}.mcap"
    if not path.exists():
        make(take, path)
    recorded, body, settings = read(path, Settings()), human(), Settings()
    log = recorded.log(body, settings)
    return judge(recorded, log, log.track(body, settings))


def make(take: Take, path: Path) -> None:
    """Writes the log and its truth."""
    figure, rng = Figure(read_meshes(take.meshes), take.person), np.random.default_rng(take.seed)
    clip, in_the_air = _moves(take, rng)
    vertices, joints = figure.posed(clip, 1 - in_the_air)
    names, furniture = list(BONES), []
    if take.clip in POSED:
        vertices, joints = planted(vertices, joints, names)
    if take.clip in SEATED:
        furniture = chair(vertices, joints, names, with_back=bool(take.seed % 2))
    turn = Rotation.from_euler("z", np.pi + take.yaw).as_matrix()
    vertices, joints = vertices @ turn.T.astype(np.float32), joints @ turn.T
    camera, noise = CAMERAS[take.camera]
    camera = replace(camera, roll=take.roll)
    if take.stage > 0:
        up = np.array([0, 0, take.stage])
        vertices, joints = vertices + up.astype(np.float32), joints + up
    shift = _in_view(vertices, camera)
    vertices, joints = vertices + shift.astype(np.float32), joints + shift
    box = Box(float(rng.uniform(2.6, 3.6)), 1.4, (0.5, 0.45, float(rng.uniform(0.4, 1.0))), 0.3)
    wall = max(4.5, vertices[..., 0].max() + float(rng.uniform(0.35, 1.5)))
    room = beside(Room(wall=wall, boxes=FURNISHED if take.furnished else (box,)), vertices, rng)
    if take.stage > 0:
        room = replace(room, boxes=(*room.boxes, _stage(vertices, take.stage, rng)))
    for x, y, size in furniture:
        x, y, _ = turn @ [x, y, 0] + shift
        room = replace(room, boxes=(*room.boxes, Box(float(x), float(y), size, np.pi + take.yaw)))
    colour = replace(_camera(640, 480, 554.3), position=(0.0, 0.06, 1.25))
    cameras = {"depth": [camera], "colour": [colour]}
    if take.path:
        middle, seed = joints.mean(1), int(rng.integers(1 << 31))
        cameras = {n: moved(c[0], take.path, middle, np.random.default_rng(seed)) for n, c in cameras.items()}
    empty, where = render_room(camera, room), marked(figure)
    depth: list[np.ndarray] = []
    found: list[Found] = []
    for i, frame in enumerate(vertices):
        if take.path:
            camera, colour = cameras["depth"][i], cameras["colour"][i]
            empty = render_room(camera, room)
        depth.append(add_noise(*before(empty, frame, figure.meshes.faces, camera), camera, noise, rng))
        found.append([] if take.furnished or take.roll else detections(figure, frame, colour, where, rng))
    if not take.told:
        seen = [in_camera(j, cameras["depth"][i % len(cameras["depth"])]) for i, j in enumerate(joints)]
        cameras = {name: [replace(path[0], roll=0.0)] for name, path in cameras.items()}
        first = cameras["depth"][0]
        joints = np.stack(seen) @ first.rotation.T + np.array(first.position)
    time_ns = START_NS + np.round(np.arange(len(depth)) / RATE * 1e9).astype(np.int64)
    write_truth(path.with_suffix(".truth.npz"), time_ns, joints, figure.dims)
    write(path, cameras, time_ns, depth, found)


def _moves(take: Take, rng: np.random.Generator) -> tuple[Clip, np.ndarray]:
    """What somebody does, and how much of it is free of the floor, 0..1 [frame]."""
    if take.clip in POSED:
        clip = sitting(rng, take.clip == SEATED[1]) if take.clip in SEATED else exercise(rng, take.clip == "exercise")
        return clip.mirrored() if take.mirrored else clip, np.zeros(len(clip.place))
    clip = read_clip(take.motions / f"humanoid3d_{take.clip}.txt", take.speed, CLIPS.get(take.clip, 1))
    if take.clip.startswith("getup"):  # lies down first
        clip = there_and_back(clip, HELD)
    clip = after_standing(clip.mirrored() if take.mirrored else clip, STILL, EASED, HELD)
    eased = np.clip((np.arange(len(clip.place)) - STILL) / EASED, 0, 1)
    return clip, eased if take.clip in IN_THE_AIR else np.zeros_like(eased)


def _stage(vertices: np.ndarray, height: float, rng: np.random.Generator) -> Box:
    """What somebody stands on, and some way around it."""
    feet = vertices.reshape(-1, 3)[::50]
    feet = feet[feet[:, 2] < height + 0.25, :2]
    x, y = ((feet.max(0) + feet.min(0)) / 2).tolist()
    deep, wide = (np.ptp(feet, 0) + 2 * rng.uniform(0.1, 0.8, 2)).tolist()
    return Box(x, y, (deep, wide, height))


def _in_view(vertices: np.ndarray, camera: Camera) -> np.ndarray:
    """How to move somebody to be as near as possible and wholly in view all the time."""
    points = vertices[:, ::7].reshape(-1, 3)
    middle = (points.min(0) + points.max(0)) / 2
    shift = np.zeros(3)
    for distance in np.arange(NEAREST, FARTHEST, 0.1):
        shift = np.array([distance - middle[0], -middle[1], 0.0])
        there = in_camera(points + shift, camera)
        at = pixels(there, camera)
        if there[:, 2].min() > 0.8 and at.min() > 1 and (at.max(0) < [camera.width - 2, camera.height - 2]).all():
            break
    return shift
