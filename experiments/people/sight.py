"""What a depth camera and a detector of face and hands see of a mesh in a room."""

from dataclasses import replace

import numpy as np

from experiments.people.figure import Figure
from voodoo_jax.simulate.room import Box, Room
from voodoo_jax.simulate.sensor import Camera

try:  # loops over triangles: a hundred times as fast compiled
    from numba import njit  # pyright: ignore[reportMissingImports]
except ImportError:
    njit = lambda f: f  # noqa: E731

COARSE = 4  # pixels of the colour camera for one in which it is asked what hides what
SEEN = 0.3  # of its vertices: so much of a face or hand must be in view to be detected
MISSED, FALSE, PIXELS = 0.1, 0.04, 4.0  # share of detections, share of frames, standard deviation


@njit
def draw(points, faces, fx, fy, cx, cy, depth, cosine):  # pragma: no cover  compiled
    """Lowers `depth` [row, column] where a triangle of points (optical frame) is nearer; `cosine` of the incidence."""
    height, width = depth.shape
    for t in range(len(faces)):
        a, b, c = points[faces[t, 0]], points[faces[t, 1]], points[faces[t, 2]]
        if min(a[2], b[2], c[2]) < 0.05:
            continue
        ax, ay = a[0] / a[2] * fx + cx, a[1] / a[2] * fy + cy
        bx, by = b[0] / b[2] * fx + cx, b[1] / b[2] * fy + cy
        dx, dy = c[0] / c[2] * fx + cx, c[1] / c[2] * fy + cy
        area = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
        normal = np.cross(b - a, c - a)
        size = np.sqrt((normal * normal).sum())
        if size < 1e-15 or abs(area) < 1e-12:
            continue
        normal = normal / size
        offset = (normal * a).sum()
        for y in range(max(0, int(np.ceil(min(ay, by, dy)))), min(height - 1, int(np.floor(max(ay, by, dy)))) + 1):
            for x in range(max(0, int(np.ceil(min(ax, bx, dx)))), min(width - 1, int(np.floor(max(ax, bx, dx)))) + 1):
                first = ((bx - x) * (dy - y) - (by - y) * (dx - x)) / area
                second = ((dx - x) * (ay - y) - (dy - y) * (ax - x)) / area
                u, v = (x - cx) / fx, (y - cy) / fy
                slope = normal[0] * u + normal[1] * v + normal[2]
                if first < -1e-9 or second < -1e-9 or first + second > 1 + 1e-9 or abs(slope) < 1e-9:
                    continue
                z = offset / slope
                if 0 < z < depth[y, x]:
                    depth[y, x], cosine[y, x] = z, abs(slope) / np.sqrt(u * u + v * v + 1)


def before(
    empty: tuple[np.ndarray, np.ndarray], vertices: np.ndarray, faces: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and cosine of the incidence, exact, of a mesh (fixed frame) in a room of which those are `empty`."""
    depth, cosine = empty[0].copy(), empty[1].copy()
    points = np.ascontiguousarray(in_camera(vertices, camera), np.float64)
    draw(points, faces, camera.fx, camera.fy, camera.cx, camera.cy, depth, cosine)
    return depth, cosine


def in_camera(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Points of the fixed frame in the optical one, metres."""
    return (points - np.array(camera.position)) @ camera.rotation


def pixels(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Where points (optical frame) are in the picture."""
    focal, middle = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    return points[..., :2] / points[..., 2:] * focal + middle


def beside(room: Room, vertices: np.ndarray, rng: np.random.Generator) -> Room:
    """The room with its boxes where nobody runs into them."""
    points = vertices[:, ::7].reshape(-1, 3)
    for _ in range(300):
        if not any(_touched(points, box) for box in room.boxes):
            break
        moved = (
            replace(box, x=float(rng.uniform(2.4, 4.5)), y=float(rng.choice([-1, 1]) * rng.uniform(0.8, 1.9)))
            for box in room.boxes
        )
        room = replace(room, boxes=tuple(moved))
    return room


def _touched(points: np.ndarray, box: Box) -> bool:
    away = np.abs(points[:, :2] - [box.x, box.y]) - np.array(box.size[:2]) / 2
    return bool(np.any((away < 0.35).all(1) & (points[:, 2] < box.size[2] + 0.2)))


def marked(figure: Figure) -> dict[str, np.ndarray]:
    """The vertices of face and hands."""
    bones, main = figure.meshes.bones, figure.meshes.weights.argmax(1)
    own = figure.meshes.skin[np.arange(len(main)), main]
    head = own >= bones.index("head")
    x, z = figure.vertices[:, 0], figure.vertices[:, 2]
    middle, front, low, high = np.median(x[head]), x[head].max(), z[head].min(), z[head].max()
    face = head & (x > middle + 0.2 * (front - middle))
    face &= (z > low + 0.1 * (high - low)) & (z < low + 0.75 * (high - low))
    hand = {side: np.array([b.endswith(side) and b.startswith(("wrist", "finger", "meta")) for b in bones])
            for side in "LR"}  # fmt: skip
    hands = {"left_hand": np.flatnonzero(hand["L"][own]), "right_hand": np.flatnonzero(hand["R"][own])}
    return {"face": np.flatnonzero(face)} | hands


def detections(
    figure: Figure, vertices: np.ndarray, camera: Camera, where: dict[str, np.ndarray], rng: np.random.Generator
) -> list[tuple[str, float, float]]:
    """Names and pixels of what a detector finds in one frame: noisy, some missed, now and then a wrong one."""
    points = np.ascontiguousarray(in_camera(vertices, camera), np.float64)
    depth = np.full((camera.height // COARSE, camera.width // COARSE), np.inf)
    edge, c = (COARSE - 1) / 2, COARSE
    middle = (camera.cx - edge) / c, (camera.cy - edge) / c
    draw(points, figure.meshes.faces, camera.fx / c, camera.fy / c, *middle, depth, np.ones_like(depth))
    found = []
    for name, index in where.items():
        at = pixels(points[index], camera)
        u, v = np.round((at.T - edge) / c).astype(int)
        there = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
        seen = np.zeros(len(index), bool)
        seen[there] = points[index[there], 2] < depth[v[there], u[there]] + 0.02
        if seen.mean() >= SEEN and rng.random() >= MISSED:
            found.append((name, *(at[seen].mean(0) + PIXELS * rng.standard_normal(2)).tolist()))
    if rng.random() < FALSE:
        found.append((str(rng.choice(list(where))), *(rng.random(2) * [camera.width, camera.height]).tolist()))
    return found
