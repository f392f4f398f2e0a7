"""Crops of simulated people and of nobody: python -m experiments.eye.data BODIES.npz MOTIONS FOLDER SHARDS [FIRST]

BODIES.npz as people/bodies.py writes it; MOTIONS the folder pybullet_data/data/motions. Shard k of FOLDER is made from
seed k alone; those that are there stay. A crop: points about a column (1.5 m), their labels, joints, the sensor.
"""

import sys
import time
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.eye import render
from experiments.eye.postures import LIES, drawn
from experiments.people.figure import BONES, LIMBS, Figure, Meshes, read_meshes
from experiments.people.motions import read_clip

JOINTS = tuple(BONES)  # 14
PARTS = (
    "head",
    "chest",
    "belly",
    *(f"{s}_{p}" for p in ("upper_arm", "forearm", "thigh", "shank", "foot") for s in "lr"),
)
BACKGROUND, OTHER, CLASSES = 13, 14, 15  # labels after the parts, and their number
KEPT, THIN, REACH = 768, 0.03, 1.5  # points of a crop, metres between them, radius
SHARD, POSES, VIEWS = 4096, 32, 3  # crops; postures made at once; sensors that see a scene
COARSE = 0.035  # metres: vertices nearer to each other are one
LEFT_OUT = 5  # every so manieth body is for tests
BALL = 6  # rings of an ellipsoid


class Crop(NamedTuple):
    """Points relative to a column on the floor, z up."""

    points: np.ndarray  # [KEPT, 3] metres
    labels: np.ndarray  # [KEPT] 255 after the last
    joints: np.ndarray  # [14, 3]; zeros for nobody
    sensor: np.ndarray  # [3]
    person: bool
    kind: str


@cache
def coarse(path: Path) -> Meshes:
    """The bodies with vertices merged, so that skinning and drawing take a tenth of the time."""
    meshes = read_meshes(path)
    key = np.floor(meshes.vertices.mean(0) / COARSE).astype(int)
    _, kept, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
    faces = group.ravel()[meshes.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])]
    faces = np.unique(np.sort(faces, 1), axis=0)
    return meshes._replace(
        vertices=meshes.vertices[:, kept], faces=faces, skin=meshes.skin[kept], weights=meshes.weights[kept]
    )


def parts_of(meshes: Meshes) -> np.ndarray:
    """[face] The part of the body, by most of its vertices' weight."""
    of_bone = np.array([_part(bone) for bone in meshes.bones])
    share = np.zeros((len(meshes.skin), len(PARTS)))
    np.add.at(share, (np.arange(len(share))[:, None], of_bone[meshes.skin]), meshes.weights)
    return share[meshes.faces].sum(1).argmax(1).astype(np.uint8)


def _part(bone: str) -> int:
    stem, _, side = bone.partition(".")
    for start, segment in LIMBS if side else ():
        if stem.startswith(start):
            return PARTS.index(f"{side.lower()}_{segment}")
    if stem.startswith(("spine0", "breast", "clavicle", "shoulder")):
        return PARTS.index("belly" if stem in ("spine05", "spine04") else "chest")
    return PARTS.index("belly" if stem.startswith(("root", "pelvis")) else "head")


class Scene:
    """Meshes and boxes with labels."""

    def __init__(self):
        self.points, self.faces, self.labels, self.count = [], [], [], 0
        self.boxes: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def copy(self) -> "Scene":
        other = Scene()
        other.points, other.faces, other.labels = list(self.points), list(self.faces), list(self.labels)
        other.boxes, other.count = list(self.boxes), self.count
        return other

    def mesh(self, points: np.ndarray, faces: np.ndarray, labels: np.ndarray) -> None:
        self.points.append(points)
        self.faces.append(faces + self.count)
        self.labels.append(labels)
        self.count += len(points)

    def box(self, middle, size, yaw: float = 0.0, turn: np.ndarray | None = None) -> None:
        axes = Rotation.from_euler("z", yaw).as_matrix().T if turn is None else turn.T
        self.boxes.append((np.asarray(middle, float), axes, np.asarray(size, float) / 2))

    def ball(self, middle, radii, label: int = BACKGROUND, turn: np.ndarray | None = None) -> None:
        points, faces = _ball()
        points = points * radii if turn is None else points * radii @ turn.T
        self.mesh(points + middle, faces, np.full(len(faces), label, np.uint8))

    def tube(self, middle, low: float, high: float, height: float, label: int = BACKGROUND) -> None:
        points, faces = _ball()
        ring = points.copy()
        level = np.hypot(ring[:, 0], ring[:, 1])
        way = np.where(level > 1e-6, 1 / np.maximum(level, 1e-6), 0)
        up = np.clip(ring[:, 2] * 1.2, -1, 1)
        wide = (low + (high - low) * (up + 1) / 2) * (level > 1e-6)
        points = np.column_stack([ring[:, 0] * way * wide, ring[:, 1] * way * wide, (up + 1) / 2 * height])
        self.mesh(points + middle, faces, np.full(len(faces), label, np.uint8))


@cache
def _ball() -> tuple[np.ndarray, np.ndarray]:
    around = np.arange(10) * 2 * np.pi / 10
    rings = [np.column_stack([np.sin(t) * np.cos(around), np.sin(t) * np.sin(around), np.full(10, np.cos(t))])
             for t in np.linspace(0, np.pi, BALL + 1)]  # fmt: skip
    faces = [f for a in range(BALL) for i in range(10) for j in [(i + 1) % 10]
             for below in [10 * a + 10]
             for f in ((10 * a + i, below + i, 10 * a + j), (10 * a + j, below + i, below + j))]  # fmt: skip
    return np.concatenate(rings), np.array(faces)


def furniture(scene: Scene, at: np.ndarray, rng: np.random.Generator) -> None:
    """Something that is nobody, standing at a place on the floor."""
    u, yaw = rng.uniform, rng.uniform(0, 2 * np.pi)
    x, y = at
    turn = Rotation.from_euler("z", yaw).as_matrix()
    kind = rng.integers(9)
    if kind == 0:
        high = u(0.3, 2.1)
        scene.box((x, y, high / 2), (u(0.25, 1.2), u(0.25, 1.2), high), yaw)
    elif kind == 1:
        chair(scene, at, yaw, u(0.4, 0.55), rng)
    elif kind == 2:
        table(scene, at, yaw, u(0.68, 1.1), rng)
    elif kind == 3:  # coat stand
        high = u(1.4, 2.0)
        scene.tube((x, y, 0), 0.03, 0.03, high)
        scene.tube((x, y, u(0.4, 0.9)), u(0.15, 0.3), u(0.06, 0.16), u(0.5, 0.8))
        if rng.random() < 0.5:
            scene.ball((x, y, high), (0.14, 0.14, u(0.08, 0.2)))
    elif kind == 4:  # dummy of boxes
        wide = u(0.25, 0.5)
        for low, up, share in ((0.0, 0.8, 0.8), (0.8, 1.4, 1.0), (1.4, 1.65, 0.45)):
            scene.box((x, y, (low + up) / 2), (wide * share, wide * 0.6 * share, up - low), yaw)
    elif kind == 5:  # dog
        high = u(0.25, 0.6)
        scene.ball((x, y, high), (high * 0.6, high * 0.2, high * 0.25), turn=turn)
        for i in (-1, 1):
            for j in (-1, 1):
                scene.tube(turn @ [i * 0.4 * high, j * 0.14 * high, 0] + [x, y, 0], high * 0.06, high * 0.06, high)
        scene.ball(turn @ [0.7 * high, 0, 1.25 * high] + [x, y, 0], (high * 0.25, high * 0.13, high * 0.16), turn=turn)
    elif kind == 6:
        scene.tube((x, y, 0), u(0.06, 0.3), u(0.06, 0.3), u(0.4, 2.3))
    elif kind == 7:  # bed with what looks like somebody under a blanket
        high = u(0.4, 0.65)
        scene.box((x, y, high / 2), (0.9, 2.0, high), yaw)
        scene.ball(turn @ [0, 0.75, high] + [x, y, 0], (0.3, 0.2, 0.12), turn=turn)
        scene.ball(turn @ [0, -0.2, high] + [x, y, 0], (0.35, 0.7, u(0.05, 0.2)), turn=turn)
    else:
        for _ in range(rng.integers(2, 6)):
            scene.box((*(at + rng.normal(size=2) * 0.2), u(0, 1.5)), u(0.1, 0.6, 3), u(0, 1.5))


def chair(scene: Scene, at: np.ndarray, yaw: float, seat: float, rng: np.random.Generator) -> None:
    """Who sits on it looks along x turned by yaw."""
    turn, u = Rotation.from_euler("z", yaw).as_matrix(), rng.uniform

    def put(x, y, z, size):
        scene.box(turn @ [x, y, z] + [*at, 0], size, yaw)

    kind = rng.random()
    if kind < 0.25:  # sofa
        wide = u(0.8, 2.2)
        put(-0.1, 0, seat / 2, (0.8, wide, seat))
        put(-0.5, 0, seat, (0.22, wide, 2 * seat + u(-0.1, 0.2)))
    elif kind < 0.45:  # box
        put(0, 0, seat / 2, (0.45, 0.45, seat))
    else:
        put(-0.02, 0, seat - 0.03, (0.45, u(0.4, 0.52), 0.06))
        for i in (-1, 1):
            for j in (-1, 1):
                put(i * 0.2, j * 0.2, seat / 2, (0.035, 0.035, seat))
        if kind < 0.9:
            put(-0.25, 0, seat + u(0.25, 0.4), (0.04, u(0.3, 0.5), u(0.3, 0.6)))
        if kind > 0.85:  # arms, as wheelchairs have them
            for j in (-1, 1):
                put(0, 0.29 * j, seat + 0.2, (0.35, 0.05, 0.04))
                put(0, 0.3 * j, 0.3, (0.5, 0.03, 0.55))


def couch(scene: Scene, at: np.ndarray, yaw: float, rng: np.random.Generator) -> float:
    """A bed or a sofa, on which somebody lies whose head is along x turned by yaw; its height."""
    turn, u = Rotation.from_euler("z", yaw).as_matrix(), rng.uniform
    high, wide, end = u(0.3, 0.75), u(0.75, 1.6), u(0.95, 1.1)

    def put(x, y, z, size):
        scene.box(turn @ [x, y, z] + [*at, 0], size, yaw)

    put(0, 0, high / 2, (2 * end, wide, high))
    if rng.random() < 0.5:  # a pillow
        put(u(0.7, 0.9), 0, high, (0.3, u(0.4, 0.8), u(0.06, 0.24)))
    for x in (-1, 1):  # boards or arms at its ends
        if rng.random() < 0.35:
            more = u(0.05, 0.5)
            put(x * (end + 0.05), 0, (high + more) / 2, (u(0.04, 0.2), wide, high + more))
    for y in (-1, 1):  # a back, rails, a wall
        if rng.random() < 0.25:
            more = u(0.1, 0.5)
            put(0, y * (wide / 2 + 0.08), (high + more) / 2, (2 * end, u(0.04, 0.2), high + more))
    return high


def table(scene: Scene, at: np.ndarray, yaw: float, high: float, rng: np.random.Generator) -> None:
    turn, u = Rotation.from_euler("z", yaw).as_matrix(), rng.uniform
    deep, wide = u(0.5, 0.9), u(0.8, 1.8)
    scene.box((*at, high - 0.02), (deep, wide, 0.04), yaw)
    if rng.random() < 0.4:
        scene.box((*at, high / 2), (0.03, wide, high), yaw)
    for _ in range(rng.integers(0, 4)):
        size = u(0.03, 0.45, 3) * [0.6, 0.8, 1]
        place = turn @ [u(-0.4, 0.4) * deep, u(-0.4, 0.4) * wide, 0] + [*at, high + size[2] / 2]
        scene.box(place, size, yaw)


class People:
    """Postures of the bodies, made some at a time."""

    def __init__(self, bodies: Path, motions: Path, test: bool):
        self.meshes = coarse(bodies)
        self.parts = parts_of(self.meshes)
        self.trunk = np.unique(self.meshes.faces[np.isin(self.parts, [PARTS.index("chest"), PARTS.index("belly")])])
        every = np.arange(len(self.meshes.vertices))
        self.who = every[every % LEFT_OUT == 0] if test else every[every % LEFT_OUT != 0]
        self.clips = [read_clip(path, 1.0, 1) for path in sorted(motions.glob("humanoid3d_*.txt"))]
        self.ready: list[tuple[np.ndarray, np.ndarray, str]] = []

    def one(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, str]:
        """Vertices, joints (its lowest point on the floor, faces x) and kind of somebody."""
        if not self.ready:
            figure = Figure(self.meshes, int(rng.choice(self.who)))
            poses = drawn(rng, POSES, self.clips)
            vertices, joints = figure.posed(poses.clip, np.ones(POSES))
            size = rng.uniform(0.86, 1.06, (POSES, 1, 1)) * np.where(rng.random((POSES, 1, 1)) < 0.08, 0.8, 1.0)
            self.ready = list(zip(vertices * size, joints * size, poses.kind.astype(str)))
        return self.ready.pop()

    def placed(
        self, scene: Scene, rng: np.random.Generator, at: np.ndarray, label: int | None = None
    ) -> tuple[np.ndarray, np.ndarray, str]:
        """Somebody and what belongs to them put at a place; vertices, joints, kind."""
        vertices, joints, kind = self.one(rng)
        yaw, u = rng.uniform(-np.pi, np.pi), rng.uniform
        turn = Rotation.from_euler("z", yaw).as_matrix()
        hips = (joints[JOINTS.index("l_hip")] + joints[JOINTS.index("r_hip")]) / 2
        middle = vertices[:, :2].mean(0) if kind in LIES else hips[:2]
        vertices = (vertices - [*middle, 0]) @ turn.T + [*at, 0]
        joints = (joints - [*middle, 0]) @ turn.T + [*at, 0]
        lift = 0.0
        if kind == "sit":
            seat = vertices[np.linalg.norm(vertices[:, :2] - at, axis=1) < 0.16, 2].min()
            wanted = float(np.clip(seat, 0.3, 0.7))
            lift = wanted - seat
            chair(scene, at, yaw, wanted, rng)
            if rng.random() < 0.4:
                table(scene, at + turn[:2, 0] * u(0.5, 0.75), yaw, wanted + u(0.2, 0.36), rng)
        elif kind in LIES or (kind == "floor" and rng.random() < 0.4):
            along = joints[JOINTS.index("skullbase" if kind in LIES else "l_hip")] - joints[JOINTS.index("l_knee")]
            lift = couch(scene, at, float(np.arctan2(along[1], along[0])), rng) if rng.random() < 0.65 else 0.0
            lift -= vertices[self.trunk, 2].min() + u(0, 0.05 if lift > 0 else 0.02)  # limbs sink in
        vertices, joints = vertices + [0, 0, lift], joints + [0, 0, lift]
        parts = self.parts if label is None else np.full(len(self.parts), label, np.uint8)
        scene.mesh(vertices, self.meshes.faces, parts)
        self._worn(scene, rng, joints, kind, turn, label)
        return vertices, joints, kind

    def _worn(self, scene, rng, joints, kind, turn, label) -> None:
        """Hair, skirt, rucksack, what is carried."""
        u, of = rng.uniform, lambda name: joints[JOINTS.index(name)]
        head, neck, hips = of("skullbase"), of("vc7"), (of("l_hip") + of("r_hip")) / 2
        if rng.random() < 0.3:
            up = head - neck
            scene.ball(head + up * u(0.4, 0.9), u(0.09, 0.13, 3), 0 if label is None else label)
        if kind in ("stand", "walk") and rng.random() < 0.12:
            top, long = hips[2] + u(0, 0.25), u(0.45, 1.0)
            low = max(0.02, top - long)
            scene.tube((*hips[:2], low), u(0.2, 0.4), u(0.14, 0.2), top - low, 2 if label is None else label)
        if kind not in LIES and rng.random() < 0.07:
            across = of("l_shoulder") - of("r_shoulder")
            back = np.cross(neck - hips, across)
            back /= max(float(np.linalg.norm(back)), 1e-6)
            scene.box(
                (neck * 0.7 + hips * 0.3) + back * u(0.2, 0.26), u([0.12, 0.22, 0.3], [0.28, 0.36, 0.5]), turn=turn
            )
        if rng.random() < 0.08:
            hands = (of("l_wrist") + of("r_wrist")) / 2
            scene.box(hands + turn[:, 0] * 0.08, u([0.15, 0.15, 0.12], [0.4, 0.4, 0.45]), turn=turn)


def crops(people: People, rng: np.random.Generator) -> list[Crop]:
    """Those of one scene, as VIEWS sensors see it, each with other furniture about."""
    scene, u = Scene(), rng.uniform
    somebody = rng.random() > 0.12
    joints, kind, target = np.zeros((len(JOINTS), 3)), "nobody", np.array([0, 0, u(0.4, 1.0)])
    vertices = np.zeros((1, 3))
    if somebody:
        vertices, joints, kind = people.placed(scene, rng, np.zeros(2))
        target = vertices.mean(0)
        if rng.random() < 0.2:
            way, far = u(0, 2 * np.pi), u(0.45, 1.2)
            people.placed(scene, rng, far * np.array([np.cos(way), np.sin(way)]), OTHER)
    else:
        furniture(scene, np.zeros(2), rng)
    found = []
    for _ in range(VIEWS):
        found += _view(scene.copy(), rng, target, vertices, joints, kind)
    return [crop for crop in found if crop is not None]


def _view(scene: Scene, rng: np.random.Generator, target, vertices, joints, kind: str) -> list[Crop | None]:
    u, somebody = rng.uniform, kind != "nobody"
    above, way, far = rng.random() < 0.08, u(0, 2 * np.pi), u(1.2, 5.5)
    sensor = np.array([*rng.normal(size=2) * 0.5, u(2.3, 3.4)])
    if not above:
        sensor = np.array([far * np.cos(way), far * np.sin(way), u(0.4, 2.3)])
    spots = _surroundings(scene, rng, sensor, above, vertices, kind)
    points, labels = seen(scene, rng, sensor, target)
    if rng.random() < 0.07:  # a second sensor
        other = np.array([*(sensor[:2] @ Rotation.from_euler("z", u(0.5, 3)).as_matrix()[:2, :2]), u(0.8, 2)])
        more, too = seen(scene, rng, other, target)
        points, labels = np.concatenate([points, more]), np.concatenate([labels, too])
    found = []
    if not somebody or np.sum(labels < BACKGROUND) >= 30:
        found.append(_crop(points, labels, np.zeros(2), joints, sensor, kind, rng))
    free = [s for s in spots if np.linalg.norm(vertices[:, :2] - s, axis=1).min() > 1.0]
    if free and rng.random() < 0.2:
        found.append(_crop(points, labels, free[0], joints * 0, sensor, "nobody", rng))
    return found


def _surroundings(scene, rng, sensor, above, vertices, kind) -> list[np.ndarray]:
    u, spots = rng.uniform, []
    to = sensor[:2] / max(float(np.linalg.norm(sensor[:2])), 1e-6)
    for _ in range(rng.integers(0, 5)):
        way, far = u(0, 2 * np.pi), u(0.55, 2.2)
        at = far * np.array([np.cos(way), np.sin(way)])
        between = not above and at @ to > 0.3 and abs(at @ [-to[1], to[0]]) < 0.6
        if (between and rng.random() < 0.75) or (kind in (*LIES, "crawl") and far < 1.2):
            continue
        furniture(scene, at, rng)
        spots.append(at)
    distance = float(np.linalg.norm(sensor[:2]))
    if not above and distance > 1.9 and rng.random() < 0.12:  # a board or counter between
        high, at = u(0.4, 1.2), to * u(0.45, min(1.2, distance - 1.0))
        scene.box((*at, high / 2), (0.05, u(0.8, 3), high), np.arctan2(to[1], to[0]) + rng.normal() * 0.2)
    if rng.random() < 0.7:
        for way in u(0, 2 * np.pi, 1 if rng.random() < 0.6 else 2):
            ahead = np.array([np.cos(way), np.sin(way)])
            far = max(u(0.35, 3), float((vertices[:, :2] @ ahead).max()) + u(0.01, 0.6))
            if ahead @ sensor[:2] < far - 0.2:
                scene.box((*(ahead * (far + 0.05)), 1.3), (0.1, 9, 2.6), way)
    scene.box((0, 0, -0.05), (16, 16, 0.1))
    return spots


def seen(
    scene: Scene, rng: np.random.Generator, sensor: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Noisy points and their labels, of the rays about a target."""
    u = rng.uniform
    ahead = target + rng.normal(size=3) * 0.1 - sensor
    distance = float(np.linalg.norm(ahead))
    ahead = ahead / distance
    right = np.cross(ahead, [1e-3, 0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(ahead, right), ahead])  # rows, optical frame
    fine = 2 * np.tan(np.radians(u(22, 40))) / rng.choice([160, 224, 320])
    du = dv = max(fine, 0.025 / max(distance, 0.6))
    if rng.random() < 0.12:  # a lidar of rows
        dv, du = np.radians(u(0.4, 2.0)), max(np.radians(0.3), 0.02 / distance)
    half = REACH / max(distance - 0.5, 0.7)
    wide, high = int(2 * min(half, 1.2) / du), int(2 * min(half, 0.95) / dv)
    u0, v0 = -du * wide / 2, -dv * high / 2
    depth, label = np.full((high, wide), 50.0, np.float32), np.full((high, wide), BACKGROUND, np.uint8)
    if scene.points:
        points = (np.concatenate(scene.points) - sensor) @ axes.T
        faces, labels = np.concatenate(scene.faces), np.concatenate(scene.labels)
        render.triangles(points, faces, labels, u0, v0, du, dv, depth, label)
    middle, turned, size = (np.stack(some) for some in zip(*scene.boxes))
    middle, turned = (middle - sensor) @ axes.T, turned @ axes.T
    render.boxes(middle, turned, size, np.full(len(size), BACKGROUND, np.uint8), u0, v0, du, dv, depth, label)
    depth, label, good = _measured(depth, label, rng)
    y, x = np.nonzero(good)
    rays = np.column_stack([u0 + x * du, v0 + y * dv, np.ones(len(x))])
    return (rays * depth[good][:, None]) @ axes + sensor, label[good]


def _measured(depth, label, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth with mixed edges, noise, drop-outs; labels; which pixels are good."""
    u = rng.uniform
    around = np.pad(depth, 1, mode="edge")
    cross = np.stack([depth, around[:-2, 1:-1], around[2:, 1:-1], around[1:-1, :-2], around[1:-1, 2:]])
    near, far = cross.min(0), np.minimum(cross.max(0), 12.0)
    mixed = (far - near > 0.08) & (rng.random(depth.shape, np.float32) < u(0, 0.6))
    out = np.where(mixed, near + rng.random(depth.shape, np.float32) * (far - near), depth)
    label = np.where(mixed & (np.abs(out - depth) > 0.1), BACKGROUND, label)
    out = out + rng.standard_normal(depth.shape, np.float32) * (u(0.001, 0.008) + u(0.0005, 0.004) * out**2)
    if rng.random() < 0.35:  # stereo: errors that neighbours share
        blocks = rng.standard_normal((depth.shape[0] // 6 + 2, depth.shape[1] // 6 + 2)) * u(0.002, 0.02)
        out = out + np.kron(blocks, np.ones((6, 6)))[: depth.shape[0], : depth.shape[1]]
    good = (depth < 40) & (out > 0.3) & (rng.random(depth.shape, np.float32) >= rng.choice([0.01, 0.05, 0.3]))
    return out, label, good


def _crop(points, labels, at, joints, sensor, kind, rng) -> Crop | None:
    rel = points - [*at, 0]
    near = (rel[:, 0] ** 2 + rel[:, 1] ** 2 < REACH**2) & (rel[:, 2] < 2.4) & (rel[:, 2] > -0.15)
    rel, labels = rel[near], labels[near]
    if len(rel) < 40:
        return None
    key = np.floor(rel / THIN).astype(np.int64)
    _, first = np.unique((key[:, 0] * 4096 + key[:, 1]) * 4096 + key[:, 2], return_index=True)
    body = labels[first] < BACKGROUND
    chance = rng.random(len(first)) - 0.5 * body - 1.0 * (rel[first, 2] > 0.06)  # the floor goes first
    first = first[np.argsort(chance)[:KEPT]]
    some, tags = np.zeros((KEPT, 3), np.float16), np.full(KEPT, 255, np.uint8)
    some[: len(first)], tags[: len(first)] = rel[first], labels[first]
    moved = joints - [*at, 0] if kind != "nobody" else joints * 0
    return Crop(some, tags, moved.astype(np.float32), (sensor - [*at, 0]).astype(np.float32), kind != "nobody", kind)


def shard(people: People, seed: int, count: int = SHARD) -> dict[str, np.ndarray]:
    """So many crops of a seed, as arrays."""
    rng, found = np.random.default_rng([seed, 60]), []
    people.ready = []
    while len(found) < count:
        found += crops(people, rng)
    return {name: np.array([getattr(crop, name) for crop in found[:count]]) for name in Crop._fields}


def main(bodies: str, motions: str, folder: str, shards: str, first: str = "0") -> None:
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    for seed in range(int(first), int(first) + int(shards)):
        path = out / f"{'test' if seed < 0 else 'train'}{abs(seed):04d}.npz"
        if path.exists():
            continue
        begin = time.process_time()
        made = shard(People(Path(bodies), Path(motions), test=seed < 0), abs(seed) + (100_000 if seed < 0 else 0))
        np.savez(path, **made)  # pyright: ignore[reportArgumentType]
        print(f"{path.name}: {time.process_time() - begin:.0f} s, people {made['person'].mean():.2f}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
