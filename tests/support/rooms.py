"""Rooms and people made of a few hundred points, as one sensor sees them."""

import numpy as np

from voodoo_jax.detect.body_likelihood import Build
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.records.recording import Frame

ORIGIN = np.array([[0.0, 0.0, 1.2]], np.float32)
FLOOR = Plane(np.array([0, 0, 1], np.float32), 0.0)


def build_of(height: float = 1.75) -> Build:
    """As high and as wide as people are."""
    return Build(height, 0.26 * height)


def frame(points, i: int = 0) -> Frame:
    points = np.asarray(points, np.float32)
    return Frame(10**18 + i * 33_000_000, points, np.zeros(len(points), np.int32), ORIGIN)


def grid(u, v, step: float = 0.02) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(*u, step), np.arange(*v, step), indexing="ij"), -1).reshape(-1, 2)


def figure(x: float, y: float, height: float = 1.75, radius: float = 0.18) -> np.ndarray:
    """The side of an upright cylinder that the sensor sees."""
    a = grid((-1.4, 1.4), (0, height), 0.025)
    return np.stack([x - radius * np.cos(a[:, 0]), y + radius * np.sin(a[:, 0]), a[:, 1]], -1)


def box(x: float, y: float, wide: float, height: float) -> np.ndarray:
    """The front of a box, towards the sensor."""
    a = grid((-wide / 2, wide / 2), (0, height))
    return np.stack([np.full(len(a), x), y + a[:, 0], a[:, 1]], -1)


def room(rng, wall: float = 4.5, noise: float = 0.006) -> np.ndarray:
    floor, back = grid((0.8, wall), (-1.6, 1.6), 0.04), grid((-1.6, 1.6), (0, 2.4), 0.04)
    points = np.concatenate([
        np.column_stack([floor, np.zeros(len(floor))]), np.column_stack([np.full(len(back), wall), back])
    ])  # fmt: skip
    return points + rng.normal(0, noise, points.shape)
