"""Somebody in a room full of furniture, all of it drawn at random, as a depth camera sees them; worker processes import
this."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from experiments.common import human
from experiments.people.figure import Figure, read_meshes
from experiments.people.making import EASED, STILL
from experiments.people.motions import RATE, Clip, after_standing, read_clip
from experiments.people.sight import before, in_camera, pixels
from experiments.people.takes import CAMERAS, CLIPS
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.records.recording import Frame
from voodoo_jax.simulate.room import Box, Room, render_room
from voodoo_jax.simulate.sensor import Camera, add_noise

FRAMES = 90  # at most
HELD = 3  # of them in the clip's last pose
FURNITURE = (
    (0.45, 0.45, 0.85), (1.2, 0.7, 0.73), (0.8, 0.45, 1.9), (0.4, 0.4, 0.5), (1.6, 0.8, 0.74), (0.5, 0.5, 1.2),
    (0.6, 0.35, 2.1), (0.9, 0.9, 0.42),
)  # fmt: skip
CLOSE = 0.08  # metres: a point of the person that is found, or that is right, is so near to one


@dataclass(frozen=True)
class Draw:
    """One of the rooms."""

    seed: int
    meshes: Path
    motions: Path


@dataclass(frozen=True)
class Shot:
    """What the camera records of a room, and the truth."""

    camera: str
    what: str
    frames: list[Frame]
    theirs: list[np.ndarray]  # of each frame: the person's points
    joints: np.ndarray  # [frame, joint, 3] as BONES of experiments/people/figure.py are named


@dataclass(frozen=True)
class Found:
    """How well the person was told from the room, each a mean over the frames."""

    seed: int
    camera: str
    what: str
    share: float  # of the person's points that are found, 0..1
    right: float  # of the found points that are the person's, 0..1


def work(job: Draw) -> Found:
    """Draws a room and looks for the person in it."""
    shot = drawn(job)
    people = find_body(shot.frames, np.array([0, 0, 1], np.float32), human(), Settings())[1]
    return Found(job.seed, shot.camera, shot.what, *shares_of(shot.theirs, [f.points for f in people]))


def drawn(job: Draw, somebody: bool = True, lies: bool = False) -> Shot:
    """Draws a room; `somebody`: the person is in it, else nobody is; `lies`: on a bed or the floor, in one pose."""
    rng = np.random.default_rng(1000 + job.seed)
    meshes = read_meshes(job.meshes)
    figure = Figure(meshes, int(rng.integers(len(meshes.vertices))))
    clip = str(rng.choice(list(CLIPS)))
    vertices, joints = figure.posed(moves := _clip(job, clip, rng), np.ones(len(moves.place)))
    turned = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).as_matrix().T
    if lies:
        turned, vertices = Rotation.from_euler("y", -90, degrees=True).as_matrix().T @ turned, vertices[:5]
    vertices = vertices @ turned.astype(np.float32)
    if lies:
        vertices[..., 2] += (bed := float(rng.choice([0.0, 0.3, 0.6]))) - vertices[..., 2].min()
    name = list(CAMERAS)[0] if rng.random() < 0.6 else str(rng.choice(list(CAMERAS)))
    camera, noise = CAMERAS[name]
    here = vertices[0, 0].copy()
    vertices, camera = _in_view(vertices, camera, rng)
    room = room_around(vertices, rng)
    if lies and bed:
        (x, y), (long, wide) = vertices[0, :, :2].mean(0), np.ptp(vertices[0, :, :2], axis=0) + 0.2
        room = replace(room, boxes=(*room.boxes, Box(float(x), float(y), (float(long), float(wide), bed))))
    empty, rays = render_room(camera, room), camera.rays().reshape(camera.height, camera.width, 3)
    origin, frames, theirs = np.array(camera.position, np.float32), [], []
    for k, frame in enumerate(vertices):
        exact = before(empty, frame, meshes.faces, camera) if somebody else empty
        depth = add_noise(*exact, camera, noise, rng).astype(float) / 1000
        seen = depth > 0
        points = (rays * depth[..., None] + origin)[seen].astype(np.float32)
        theirs.append(points[(exact[0] < empty[0])[seen]])
        frames.append(Frame(int(k * 1e9 / RATE), points, np.zeros(len(points), np.int32), origin[None]))
    what = f"{clip} by somebody of {figure.dims['stature']:.2f} m, {len(room.boxes)} things"
    return Shot(name, what, frames, theirs, joints[: len(vertices)] @ turned + (vertices[0, 0] - here))


def shares_of(theirs: list[np.ndarray], found: list[np.ndarray]) -> tuple[float, float]:
    """Means over frames of the share of the person's points near a found one, and of found ones near the person's."""
    share, right = [], []
    for points, got in zip(theirs, found):
        body = points[points[:, 2] > 0.06]  # above the floor's noise
        if len(body) < 30:
            continue
        share.append(float(np.mean(KDTree(got).query(body[::3])[0] < CLOSE)) if len(got) else 0.0)
        if len(got):
            right.append(float(np.mean(KDTree(points).query(got)[0] < CLOSE)))
    return float(np.mean(share)), float(np.mean(right)) if right else 0.0


def _clip(job: Draw, clip: str, rng: np.random.Generator) -> Clip:
    """Some of a clip, mostly with standing before it, mostly from the beginning."""
    found = read_clip(job.motions / f"humanoid3d_{clip}.txt", float(rng.uniform(0.75, 1)), CLIPS[clip])
    if rng.random() < 0.7:
        found = after_standing(found, STILL, EASED, HELD)
    first = 0 if rng.random() < 0.7 else int(rng.integers(0, max(1, len(found.place) - 75)))
    some = slice(first, first + FRAMES)
    return Clip({k: v[some] for k, v in found.turns.items()}, found.place[some])


def _in_view(vertices: np.ndarray, camera: Camera, rng: np.random.Generator) -> tuple[np.ndarray, Camera]:
    """The camera at some height, the person moved to where it sees nearly all of them."""
    height, points = float(rng.uniform(0.7, 1.9)), vertices[:, ::7].reshape(-1, 3)
    middle, shift = (points.min(0) + points.max(0)) / 2, np.zeros(3)
    for distance in np.arange(float(rng.uniform(2.0, 3.2)), 6, 0.15):
        shift = np.array([distance - middle[0], float(rng.uniform(-0.3, 0.3)) - middle[1], 0])
        pitch = float(np.arctan2(height - 0.9, distance) + rng.uniform(-0.04, 0.04))
        camera = replace(camera, position=(0.0, 0.0, height), pitch=pitch)
        there = in_camera(points + shift, camera)
        at = pixels(there, camera)
        inside = ((at > -3) & (at < [camera.width + 2, camera.height + 2])).all(1)
        if there[:, 2].min() > 0.7 and inside.mean() > 0.95:
            break
    return vertices + shift.astype(np.float32), camera


def room_around(vertices: np.ndarray, rng: np.random.Generator) -> Room:
    """Up to six things where nobody runs into them, nor stands behind them all the time; a wall mostly, side walls."""
    points, boxes = vertices[:, ::7].reshape(-1, 3), []
    bearing = np.median(points[:, 1] / points[:, 0])
    for _ in range(int(rng.integers(0, 7))):
        for _ in range(40):
            size = np.array(FURNITURE[rng.integers(len(FURNITURE))]) * rng.uniform(0.8, 1.25)
            x, y, yaw = (
                float(rng.uniform(1.2, 6)),
                float(rng.uniform(-2.5, 2.5)),
                float(rng.choice([0, 0.3, -0.4, 0.8])),
            )
            away = np.abs((points[:, :2] - [x, y]) @ Rotation.from_euler("z", yaw).as_matrix()[:2, :2]) - size[:2] / 2
            touched = (away < rng.choice([0.1, 0.3])).all(1) & (points[:, 2] < size[2] + 0.1)
            if not touched.any() and (x > points[:, 0].max() or abs(y / x - bearing) > 0.25):
                boxes.append(Box(x, y, (float(size[0]), float(size[1]), float(size[2])), yaw))
                break
    far, (right, left) = float(points[:, 0].max()), (float(points[:, 1].min()), float(points[:, 1].max()))
    for side, edge in ((-1, right), (1, left)):
        if rng.random() < 0.35:
            at = max(float(rng.uniform(1.2, 3)), side * edge + 0.4)
            boxes.append(Box(3.0, side * at, (7.0, 0.05, 2.6)))
    behind = rng.uniform(0.15, 0.5) if rng.random() < 0.5 else rng.uniform(0.5, 3)
    return Room(wall=None if rng.random() < 0.2 else far + float(behind), boxes=tuple(boxes))
