"""A room for a camera's rays: floor, wall and boxes.

Frames: fixed frame `base`, on the floor below the camera, z up, x forward, y left. Host side, NumPy.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from voodoo_jax.simulate.sensor import Camera


@dataclass(frozen=True)
class Box:
    """A piece of furniture on the floor, metres and radians."""

    x: float
    y: float
    size: tuple[float, float, float]
    yaw: float = 0.0


@dataclass(frozen=True)
class Room:
    """The surroundings of the body: the floor z = 0, a back wall at x = wall and boxes. None: without."""

    floor: bool = True
    wall: float | None = 5.0
    boxes: tuple[Box, ...] = (Box(2.9, 0.95, (0.5, 0.45, 0.75), 0.3),)


def render_room(
    camera: Camera, room: Room | None
) -> tuple[Float64[np.ndarray, "row column"], Float64[np.ndarray, "row column"]]:
    """As render, of an empty room."""
    rays, origin = camera.rays(), np.array(camera.position)
    depth, cosine, every = np.full(len(rays), np.inf), np.ones(len(rays)), np.arange(len(rays))
    planes = [] if room is None else [(2, 0.0)] * room.floor + ([] if room.wall is None else [(0, room.wall)])
    with np.errstate(divide="ignore", invalid="ignore"):
        length = np.linalg.norm(rays, axis=1)
        for axis, at in planes:
            keep_nearest(depth, cosine, every, (at - origin[axis]) / rays[:, axis], np.abs(rays[:, axis]) / length)
        for box in room.boxes if room else ():
            keep_nearest(depth, cosine, every, *hit_box(box, origin, rays))
    return depth.reshape(camera.height, camera.width), cosine.reshape(camera.height, camera.width)


def keep_nearest(depth, cosine, index, t, c) -> None:
    with np.errstate(invalid="ignore"):
        closer = (t > 0) & (t < depth[index])
    depth[index[closer]], cosine[index[closer]] = t[closer], c[closer]


def hit_box(box: Box, origin, rays) -> tuple[np.ndarray, np.ndarray]:
    """First hit t [ray] (inf: none) of origin + t ray with a box, and |cos| there; one origin, or each ray's own."""
    turn = Rotation.from_euler("z", box.yaw).as_matrix()
    half = np.array(box.size) / 2
    o, d = (origin - [box.x, box.y, half[2]]) @ turn, rays @ turn
    ends = np.sort(np.stack([(-half - o) / d, (half - o) / d]), 0)
    axis = ends[0].argmax(1)
    enter = ends[0].max(1)
    cosine = np.abs(d[np.arange(len(d)), axis]) / np.linalg.norm(d, axis=1)
    return np.where(enter < ends[1].min(1), enter, np.inf), cosine
