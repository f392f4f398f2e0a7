"""Things before a depth camera of fixed directions that stand still, sway or walk, with noise that has no memory."""

import numpy as np

from voodoo_jax.records.observation import BodyObservation

ORIGIN = np.array([[0.0, 0.0, 1.2]], np.float32)
RATE, NOISE, PIXEL = 10, 0.015, 0.006  # frames per second, metres, radians


def block(width: float, low: float, high: float, far: float = 3.0, middle: float = 0.0) -> np.ndarray:
    """[point, 3] The front of a thing as the camera's pixels see it, metres; it is curved as people are."""
    across = np.arange(-width / 2, width / 2, PIXEL * far)
    up = np.arange(low, high, PIXEL * far)
    y, z = (grid.ravel() for grid in np.meshgrid(across, up))
    return np.stack([far + 0.3 * y**2, y + middle, z], 1)


def table(width: float, height: float = 0.75, near: float = 2.3, far: float = 2.8) -> np.ndarray:
    """[point, 3] The top of a table as the camera's pixels see it, in rows that are far apart; metres."""
    fall = np.arange(np.arctan2(1.2 - height, far), np.arctan2(1.2 - height, near), PIXEL)
    x = (1.2 - height) / np.tan(fall)
    across = np.arange(-width / 2, width / 2, PIXEL * near)
    x, y = (grid.ravel() for grid in np.meshgrid(x, across))
    return np.stack([x, y, np.full(len(x), height)], 1)


def watched(
    rng: np.random.Generator, things: list[tuple[np.ndarray, np.ndarray]], frames: int = 40
) -> list[BodyObservation]:
    """Frames of some things, each with its shift [frame, 3] in metres."""
    out = []
    for k in range(frames):
        points = np.concatenate([thing + shift[k] for thing, shift in things])
        ray = points - ORIGIN
        distance = np.linalg.norm(ray, axis=1, keepdims=True)
        points = ORIGIN + ray * (1 + rng.normal(0, NOISE, distance.shape) / distance)
        sensor = np.zeros(len(points), np.int32)
        out.append(BodyObservation(k * 1_000_000_000 // RATE, points.astype(np.float32), sensor, ORIGIN, noise=NOISE))
    return out


def sway(size: float, frames: int = 40) -> np.ndarray:
    """[frame, 3] Shifts to and from the camera once in three seconds, metres."""
    out = np.zeros((frames, 3))
    out[:, 0] = size * np.sin(2 * np.pi * np.arange(frames) / RATE / 3)
    return out
