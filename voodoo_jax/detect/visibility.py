"""Occlusion: an object that comes out from behind another one has not moved. Host side, NumPy."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.spatial import KDTree

from voodoo_jax.records.observation import BodyObservation

BIN = 2.0  # degrees: what is seen in a direction is so wide
AZIMUTHS, ELEVATIONS, PER_RADIAN = int(360 / BIN) + 1, int(180 / BIN) + 1, np.float32(180 / np.pi / BIN)
# metres: less than the depth of a chest (0.25 in the mean, ANSUR II) and more than that of a limb; by hand
DEEP = 0.12
# share of the points: measured, at most 0.10 in 12 recordings of single sensors, whose limbs hide each other, and 0.22
# and more where the clouds of two and three sensors, and of the Panoptic studio's, are one
BEHIND, ASKED = 0.15, 100
NEARER = 0.3  # metres: what hides a place is so much nearer to the sensor, and what is seen through it so much farther


class Nearest(NamedTuple):
    """Distance of the nearest point in each direction from each sensor, metres; infinite: none."""

    origins: Float32[np.ndarray, "sensor 3"]
    distance: Float[np.ndarray, " bin"]  # of all sensors, see _directions

    @classmethod
    def of(
        cls,
        points: Float32[np.ndarray, "point 3"],
        sensor: Int[np.ndarray, " point"],
        origins: Float32[np.ndarray, "sensor 3"],
    ) -> "Nearest":
        """From the points that each sensor sees, metres."""
        return cls.shared(points, sensor, origins)(slice(None))

    @classmethod
    def shared(
        cls,
        points: Float32[np.ndarray, "point 3"],
        sensor: Int[np.ndarray, " point"],
        origins: Float32[np.ndarray, "sensor 3"],
    ) -> "Callable[[Bool[np.ndarray, ' point'] | slice], Nearest]":
        """A function of a mask that gives the same for a subset of the points."""
        distance, bins = _directions(points, sensor, origins)

        def of_some(some: Bool[np.ndarray, " point"] | slice) -> Nearest:
            found = np.full(len(origins) * AZIMUTHS * ELEVATIONS, np.inf, np.float32)
            np.minimum.at(found, bins[some], distance[some])
            return cls(origins, found)

        return of_some

    def hides(
        self, points: Float32[np.ndarray, "point 3"], sensor: Int[np.ndarray, " point"], nearer: float = NEARER
    ) -> Bool[np.ndarray, " point"]:
        """Which points are occluded from their sensor, by something that is at least `nearer` metres nearer."""
        distance, bins = _directions(points, sensor, self.origins)
        return self.distance[bins] < distance - nearer

    def empty(
        self, points: Float32[np.ndarray, "point 3"], sensor: Int[np.ndarray, " point"]
    ) -> Bool[np.ndarray, " point"]:
        """Which places their sensor sees as empty."""
        distance, bins = _directions(points, sensor, self.origins)
        return np.isfinite(self.distance[bins]) & (self.distance[bins] > distance + NEARER)


def has_far_sides(frames: Sequence[BodyObservation]) -> bool:
    """Whether points are behind others in the same direction: then the cloud of a `sensor` was merged from several
    sensors at unknown positions."""
    return float(np.median([_behind(f) for f in frames if len(f.points) >= ASKED] or [0.0])) > BEHIND


def _behind(frame: BodyObservation) -> float:
    """Share of the points whose neighbour in direction is at another distance, of the sensor that has most of these."""
    shares = [0.0]
    for k in np.flatnonzero(np.bincount(frame.sensor) >= ASKED):
        to = frame.points[frame.sensor == k] - frame.origins[k]
        distance = np.linalg.norm(to, axis=1)
        rays = to / distance[:, None]
        neighbour = np.asarray(KDTree(rays).query(rays, k=2)[1])[:, 1]
        shares.append(float(np.mean(np.abs(distance - distance[neighbour]) > DEEP)))
    return max(shares)


def _directions(points, sensor, origins):
    """Distances of points from their sensors, and the bins of their directions, numbered through."""
    x, y, z = np.subtract(points.T, origins.T[:, sensor], order="C")  # by coordinate: faster to go through
    level = np.sqrt(x * x + y * y)
    azimuth = ((np.arctan2(y, x) + np.float32(np.pi)) * PER_RADIAN).astype(np.int32)
    elevation = ((np.arctan2(z, level) + np.float32(np.pi / 2)) * PER_RADIAN).astype(np.int32)
    return np.sqrt(level * level + z * z), (sensor * AZIMUTHS + azimuth) * ELEVATIONS + elevation
