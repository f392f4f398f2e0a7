"""One take made, tracked and judged: who moves how before which camera. Worker processes import this."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.common import human
from experiments.judged import Verdict, judge, read
from experiments.people.figure import BONES, Figure, read_meshes
from experiments.people.motions import RATE, Clip, after_standing, read_clip, there_and_back
from experiments.people.paths import moved
from experiments.people.pictures import RIGS, Rig, dressed, painted, photographed
from experiments.people.poses import chair, exercise, planted, sitting
from experiments.people.recorded import Found, write, write_pairs, write_truth
from experiments.people.sight import before, beside, detections, in_camera, marked, pixels
from experiments.people.takes import CAMERAS, CLIPS, IN_THE_AIR, POSED, SEATED, Take, camera_of
from voodoo_jax.config.options import Settings
from voodoo_jax.simulate.room import Box, Room, render_room
from voodoo_jax.simulate.sensor import Camera, add_noise

START_NS = 1_700_000_000_000_000_000
NEAREST, FARTHEST = 2.6, 5.0  # metres, of the middle of where somebody goes
STILL, EASED, HELD = 21, 15, 9  # frames: relaxed at first, taking the clip's first pose, holding its last one
EVERY = 2  # frames: of so many a stereo pair shows one
FURNISHED = (
    Box(2.9, 1.55, (0.5, 0.45, 0.75), 0.3), Box(4.3, -1.6, (0.8, 1.2, 0.74), 0.1), Box(4.4, 2.0, (0.6, 0.8, 1.9)),
    Box(1.0, -0.9, (0.3, 0.4, 0.85)),
)  # fmt: skip


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
    if take.camera in RIGS:
        _in_pictures(take, path, figure, RIGS[take.camera], rng)
    else:
        _in_depth(take, path, figure, rng)


def _in_depth(take: Take, path: Path, figure: Figure, rng: np.random.Generator) -> None:
    """As a depth camera sees it, and a detector of face and hands beside it."""
    camera, noise = CAMERAS[take.camera]
    camera = replace(camera, roll=take.roll)
    vertices, joints, room = _staged(take, figure, camera, rng)
    colour = replace(camera_of(640, 480, 554.3), position=(0.0, 0.06, 1.25))
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
    time_ns = _times(len(depth))
    write_truth(path.with_suffix(".truth.npz"), time_ns, joints, figure.dims)
    write(path, cameras, time_ns, depth, found)


def _in_pictures(take: Take, path: Path, figure: Figure, rig: Rig, rng: np.random.Generator) -> None:
    """As two cameras side by side see it."""
    vertices, joints, room = _staged(take, figure, rig.cameras()[0], rng)
    colours, empty = dressed(figure, rng), painted(room, rig, rng)
    shown = range(0, len(vertices), EVERY)
    pictures = [
        [
            photographed(nobody, vertices[i], figure.meshes.faces, colours, camera, rng, rig.grey)[0]
            for nobody, camera in zip(empty, rig.cameras())
        ]
        for i in shown
    ]
    time_ns = _times(len(vertices))[::EVERY]
    write_truth(path.with_suffix(".truth.npz"), time_ns, joints[::EVERY], figure.dims)
    write_pairs(path, rig, time_ns, pictures)


def _times(count: int) -> np.ndarray:
    return START_NS + np.round(np.arange(count) / RATE * 1e9).astype(np.int64)


def _staged(
    take: Take, figure: Figure, camera: Camera, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, Room]:
    """Vertices [frame, vertex, 3] and joints [frame, joint, 3] of somebody in view of the camera, and the room."""
    clip, in_the_air = _moves(take, rng)
    vertices, joints = figure.posed(clip, 1 - in_the_air)
    names, furniture = list(BONES), []
    if take.clip in POSED:
        vertices, joints = planted(vertices, joints, names)
    if take.clip in SEATED:
        furniture = chair(vertices, joints, names, with_back=bool(take.seed % 2))
    turn = Rotation.from_euler("z", np.pi + take.yaw).as_matrix()
    vertices, joints = vertices @ turn.T.astype(np.float32), joints @ turn.T
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
    return vertices, joints, room


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
