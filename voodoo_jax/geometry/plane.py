"""A plane, and the one with most points on it (RANSAC, then least squares). Host side."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, UInt32

from voodoo_jax.geometry.point_cloud import quantile

MANY, SUBSET = 30_000, 2000  # points among which a floor is looked for, and by which planes are compared
# preemptive RANSAC (Nister 2003, doi:10.1109/ICCV.2003.1238341): points by which most planes are left out, and how many
# planes remain; by hand
FIRST, FINAL = 400, 40


@dataclass(frozen=True)
class Plane:
    """Points p with normal . p = offset."""

    normal: Float32[np.ndarray, "3"]  # unit
    offset: float  # metres
    noise: float = 0.0  # metres: nearly all points on it seem to be nearer to it; 0: not known

    def height(self, points: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, " point"]:
        """Signed distance of points, metres."""
        return points @ self.normal - np.float32(self.offset)

    def top(self, points: Float32[np.ndarray, "point 3"]) -> float:
        """Height of the top of a thing with these points, but for single ones; metres."""
        return float(quantile(self.height(points), 0.98))

    def level(self, points: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, "point 3"]:
        """The places on the plane under some points."""
        return points - self.height(points)[:, None] * self.normal


def _counts(
    normals: Float32[np.ndarray, "plane 3"],
    offsets: Float32[np.ndarray, " plane"],
    points: Float32[np.ndarray, "point 3"],
    tolerance: float,
) -> UInt32[np.ndarray, " plane"]:
    """How many points are on each plane."""
    off = normals @ points.T
    off -= offsets[:, None]
    return (np.abs(off, out=off) < tolerance).view(np.uint8).sum(1, dtype=np.uint32)


def fit_plane(
    points: Float32[np.ndarray, "point 3"], normals_ok, rng: np.random.Generator, tolerance: float, trials: int = 300
) -> tuple[Plane, Bool[np.ndarray, " point"]] | None:
    """The plane with the most points within `tolerance` metres (random samples of three, then least squares).

    `normals_ok(normals [trial, 3]) -> bool [trial]` says which directions are wanted. None where none was found.
    """
    if len(points) < 50:
        return None
    sample = points[rng.integers(0, len(points), (trials, 3))]
    normals = np.cross(sample[:, 1] - sample[:, 0], sample[:, 2] - sample[:, 0])
    length = np.linalg.norm(normals, axis=1)
    good = length > 1e-3
    normals = normals[good] / length[good, None]
    keep = normals_ok(normals)
    normals, at = normals[keep], sample[good][keep][:, 0]
    if not len(normals):
        return None
    subset = points[rng.integers(0, len(points), SUBSET)] if len(points) > SUBSET else points
    offsets = np.sum(normals * at, 1)
    if len(normals) > FINAL and len(subset) > FIRST:  # most planes are out of the question by a part of the points
        counts = _counts(normals, offsets, subset[:: len(subset) // FIRST], tolerance)
        chosen = np.sort(np.argsort(-counts.astype(int), kind="stable")[:FINAL])
        normals, at, offsets = normals[chosen], at[chosen], offsets[chosen]
    best = int(np.argmax(_counts(normals, offsets, subset, tolerance)))
    normal, offset = normals[best], float(normals[best] @ at[best])
    for _ in range(3):
        inside = points[np.abs(points @ normal - offset) < tolerance]
        if len(inside) < 20:
            return None
        middle = inside.mean(0)
        off = (inside - middle).astype(float)
        across = np.linalg.eigh(off.T @ off)[1][:, 0].astype(np.float32)
        normal = across * np.sign(across @ normal or 1.0)
        offset = float(normal @ middle)
    plane = Plane(normal.astype(np.float32), offset)
    return plane, np.abs(plane.height(points)) < tolerance
