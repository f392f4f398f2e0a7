"""What colour cameras see of a dressed mesh in a room: pictures for stereo pairs."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from experiments.people.figure import Figure
from experiments.people.sight import in_camera
from voodoo_jax.simulate.looks import fractal
from voodoo_jax.simulate.room import Room, render_room
from voodoo_jax.simulate.sensor import Camera

try:  # loops over triangles: a hundred times as fast compiled
    from numba import njit  # pyright: ignore[reportMissingImports]
except ImportError:
    njit = lambda f: f  # noqa: E731

FINER = 2  # times as many pixels each way are drawn, then averaged
GREY_NOISE = 2.0  # standard deviation of a pixel, of 255
JPEG = 90  # quality
SEEDS = 2**31  # of patterns, below this number
SKIN = ((120, 150, 190), (90, 120, 165), (60, 80, 115), (150, 175, 215))  # blue, green, red
HAIR = ((25, 30, 35), (40, 60, 90), (90, 130, 160), (130, 130, 130))
ROOMS = ((150, 155, 160), (120, 150, 165), (165, 160, 150), (95, 105, 120))


class Light(NamedTuple):
    """The light in a room."""

    toward: tuple[float, float, float] = (-0.6, 0.4, 0.7)  # from where it comes
    ambient: float = 0.45  # of the light comes from everywhere
    bright: float = 1.0
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)  # blue, green, red


DAY = Light()


@dataclass(frozen=True)
class Rig:
    """Two rectified cameras side by side."""

    width: int
    height: int
    focal: float  # pixels
    baseline: float  # metres
    grey: bool = False

    def cameras(self) -> tuple[Camera, Camera]:
        """The left one and the right one."""
        left = Camera(self.width, self.height, self.focal, self.focal, (self.width - 1) / 2, (self.height - 1) / 2,
                      (0.0, self.baseline / 2, 1.2), 0.05)  # fmt: skip
        return left, replace(left, position=(0.0, -self.baseline / 2, 1.2))


RIGS = {
    "stereo, 640x480": Rig(640, 480, 532.0, 0.11),
    "stereo, 1280x720": Rig(1280, 720, 700.0, 0.12),
    "stereo, 672x376": Rig(672, 376, 265.0, 0.12),
    "grey stereo, 848x480": Rig(848, 480, 420.0, 0.095, grey=True),
}


@njit
def _drawn(points, faces, fx, fy, cx, cy, depth, which, share):  # pragma: no cover  compiled
    """Lowers `depth` [row, column] where a triangle of points (optical frame) is nearer; which one it is, and the share
    that its second and third corner have in what is seen there."""
    height, width = depth.shape
    for t in range(len(faces)):
        a, b, c = points[faces[t, 0]], points[faces[t, 1]], points[faces[t, 2]]
        if min(a[2], b[2], c[2]) < 0.05:
            continue
        ax, ay = a[0] / a[2] * fx + cx, a[1] / a[2] * fy + cy
        bx, by = b[0] / b[2] * fx + cx, b[1] / b[2] * fy + cy
        dx, dy = c[0] / c[2] * fx + cx, c[1] / c[2] * fy + cy
        area = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
        if abs(area) < 1e-12:
            continue
        for y in range(max(0, int(np.ceil(min(ay, by, dy)))), min(height - 1, int(np.floor(max(ay, by, dy)))) + 1):
            for x in range(max(0, int(np.ceil(min(ax, bx, dx)))), min(width - 1, int(np.floor(max(ax, bx, dx)))) + 1):
                first = ((bx - x) * (dy - y) - (by - y) * (dx - x)) / area
                second = ((dx - x) * (ay - y) - (dy - y) * (ax - x)) / area
                third = 1 - first - second
                if first < -1e-9 or second < -1e-9 or third < -1e-9:
                    continue
                z = 1 / (first / a[2] + second / b[2] + third / c[2])
                if z < depth[y, x]:
                    depth[y, x], which[y, x] = z, t
                    share[y, x, 0], share[y, x, 1] = second * z / b[2], third * z / c[2]


def dressed(figure: Figure, rng: np.random.Generator) -> np.ndarray:
    """Colours of the vertices (blue, green, red; 0..255): skin, hair, a shirt, trousers, shoes or none."""
    meshes, rest = figure.meshes, figure.vertices.astype(float)
    main = meshes.skin[np.arange(len(rest)), meshes.weights.argmax(1)]
    of = lambda *names: np.array([name.startswith(names) for name in meshes.bones])[main]  # noqa: E731
    stature = np.ptp(rest[:, 2])
    colours = np.tile(np.array(SKIN[rng.integers(len(SKIN))], float), (len(rest), 1))
    level = {name: float(figure.joints[name][2]) for name in ("l_shoulder", "l_hip", "l_knee", "l_ankle", "skullbase")}
    head = rest[:, 2] > level["skullbase"] - 0.02 * stature
    crown, face = rest[head, 2].max(), np.median(rest[head, 0])
    hair = head & ((rest[:, 2] > crown - 0.035 * stature) | (rest[:, 0] < face - 0.01))
    colours[hair] = HAIR[rng.integers(len(HAIR))]
    hand = of("wrist", "finger", "metacarpal")
    arm = hand | of("upperarm", "lowerarm", "shoulder", "clavicle")
    along = np.where(rest[:, 1] > 0, 1, -1) * rest[:, 1]
    elbow, wrist = abs(figure.joints["l_elbow"][1]), abs(figure.joints["l_wrist"][1])
    sleeve = (0.8 * elbow, elbow, 0.95 * wrist)[rng.integers(3)]
    waist = level["l_hip"] + 0.06 * stature
    shirt = ~head & (rest[:, 2] > waist) & (rest[:, 2] < level["l_shoulder"] + 0.04 * stature) & ~hand
    shirt &= ~arm | (along < sleeve)
    trousers = ~arm & (rest[:, 2] <= waist)
    trousers &= rest[:, 2] > (level["l_knee"] if rng.random() < 0.3 else level["l_ankle"])
    shoes = ~arm & (rest[:, 2] < level["l_ankle"] + 0.01 * stature)
    cloth = lambda dark: rng.uniform(20, dark, 3)  # noqa: E731
    for part, dark in ((shirt, 200), (trousers, 110)):
        weave = fractal(rest[part], 0.3, 0.01, int(rng.integers(SEEDS))) * rng.choice([0.02, 0.05, 0.15])
        if rng.random() < 0.25:
            weave = weave + 0.35 * np.sign(np.sin(rest[part, 2] * 2 * np.pi / rng.uniform(0.03, 0.08)))
        colours[part] = cloth(dark) * np.clip(1 + weave, 0.2, 2)[:, None]
    if rng.random() < 0.7:
        colours[shoes] = cloth(100)
    return colours * np.clip(1 + 0.04 * fractal(rest, 0.1, 0.01, int(rng.integers(SEEDS))), 0.5, 1.5)[:, None]


def painted(room: Room, rig: Rig, rng: np.random.Generator, light: Light = DAY) -> list[tuple[np.ndarray, np.ndarray]]:
    """Depth and picture of the room without anybody, for each camera, FINER: walls, floor and furniture are mottled."""
    seeds, found = rng.integers(SEEDS, size=3), []
    base = [np.array(ROOMS[k], float) * rng.uniform(0.7, 1.2) for k in rng.permutation(len(ROOMS))[:3]]
    mottled = rng.uniform(0.04, 0.12, 3)
    for camera in rig.cameras():
        camera = _finer(camera)
        depth, cosine = render_room(camera, room)
        far = ~np.isfinite(depth)
        points = np.array(camera.position) + camera.rays() * np.where(far, 0, depth).reshape(-1, 1)
        at_wall = points[:, 0] > (room.wall or np.inf) - 1e-6
        which = np.where(points[:, 2] < 1e-6, 0, np.where(at_wall, 1, 2))
        picture = np.zeros((len(points), 3))
        for k in range(3):
            noise = fractal(points, 0.5, 0.008, int(seeds[k]))
            mine = which == k
            picture[mine] = base[k] * (1 + mottled[k] * noise[mine, None])
        picture *= (
            (light.ambient + (1 - light.ambient) * cosine.reshape(-1, 1) ** 0.3) * light.bright * np.array(light.tint)
        )
        found.append((depth, np.clip(picture, 0, 255).reshape(*depth.shape, 3).astype(np.float32)))
    return found


def _finer(camera: Camera) -> Camera:
    k, edge = FINER, (FINER - 1) / 2
    return replace(camera, width=k * camera.width, height=k * camera.height, fx=k * camera.fx, fy=k * camera.fy,
                   cx=k * camera.cx + edge, cy=k * camera.cy + edge)  # fmt: skip


def photographed(
    empty: tuple[np.ndarray, np.ndarray],
    vertices: np.ndarray,
    faces: np.ndarray,
    colours: np.ndarray,
    camera: Camera,
    rng: np.random.Generator,
    grey: bool,
    light: Light = DAY,
) -> tuple[np.ndarray, np.ndarray]:
    """A picture (blue, green, red, or grey) of somebody in a room, noisy; and the true depth, FINER."""
    depth, picture = empty[0].copy(), empty[1].copy()
    fine = _finer(camera)
    points = np.ascontiguousarray(in_camera(vertices, camera), np.float64)
    which, share = np.full(depth.shape, -1), np.zeros((*depth.shape, 2))
    _drawn(points, faces, fine.fx, fine.fy, fine.cx, fine.cy, depth, which, share)
    rows, columns = np.nonzero(which >= 0)
    corners = faces[which[rows, columns]]
    weights = np.concatenate([1 - share[rows, columns].sum(1, keepdims=True), share[rows, columns]], 1)
    toward = np.array(light.toward) / np.linalg.norm(light.toward)
    shade = light.ambient + (1 - light.ambient) * np.maximum(_normals(vertices, faces) @ toward, 0)
    shade = colours * shade[:, None] * light.bright * np.array(light.tint)
    picture[rows, columns] = np.einsum("pk,pkc->pc", weights, shade[corners])
    picture = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    if grey:
        picture = picture @ np.array([0.114, 0.587, 0.299], np.float32)
    picture = picture + GREY_NOISE * rng.standard_normal(picture.shape)
    return np.clip(picture, 0, 255).astype(np.uint8), depth


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    of_faces, found = np.cross(b - a, c - a), np.zeros(vertices.shape)
    for k in range(3):
        for axis in range(3):
            found[:, axis] += np.bincount(faces[:, k], of_faces[:, axis], len(vertices))
    return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)
