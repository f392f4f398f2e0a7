"""Occlusion: an object that comes out from behind another one has not moved; points between a sensor and the body may
hide limbs. Host side, NumPy."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.spatial import KDTree

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.point_cloud import even_share, picked
from voodoo_jax.records.observation import BodyObservation

# points of a frame that are looked at first, and those that are kept at most: two in a limb's width; by hand
LOOKED_AT, KEPT = 2500, 400
# of those looked at first: measured, up to 6 where nothing is between, 8 and more where somebody else is 1 m nearer
# than who is 5 m from a camera of 320 x 288 pixels. And of those kept, by hand; fewer may be noise
ANY, FEWEST = 8, 20
ASIDE = 0.6  # metres beside the body's middle that limbs reach, by hand
LOW = 0.05  # metres above the floor: nothing stands behind what is lower; by hand
PER_FRAME = 200  # points of an object in a frame that tell where it is; by hand
BIN = 2.0  # degrees: what is seen in a direction, here and in stillness.py, is so wide
AZIMUTHS, ELEVATIONS, PER_RADIAN = int(360 / BIN) + 1, int(180 / BIN) + 1, np.float32(180 / np.pi / BIN)
# metres: less than the depth of a chest (0.25 in the mean, ANSUR II) and more than that of a limb; by hand
DEEP = 0.12
# share of the points: measured, at most 0.10 in 12 recordings of single sensors, whose limbs hide each other, and 0.22
# and more where the clouds of two and three sensors, and of the Panoptic studio's, are one
BEHIND, ASKED = 0.15, 100
NEARER = 0.3  # metres: what hides a place is so much nearer to the sensor, and what is seen through it so much farther


def in_the_way(
    frame: BodyObservation, own: Int[np.ndarray, " own"], floor: Plane
) -> tuple[Float32[np.ndarray, "some 3"], Int[np.ndarray, " some"]]:
    """Some points of a whole frame that are between a sensor and the body, or where its hidden limbs may be, and which
    sensor saw each.

    **Arguments:** `own` indices of the body's points, which are none of them.
    """
    nothing = np.zeros((0, 3), np.float32), np.zeros(0, np.int8)
    if not len(own):
        return nothing
    middle = np.sort(frame.points[own[:: len(own) // PER_FRAME + 1]], 0)
    middle = middle[len(middle) // 2]
    whole = max(0, (len(frame.points) // LOOKED_AT).bit_length())
    kept = _between(frame, own, floor, middle, whole)
    if len(kept) < ANY:
        return nothing
    if whole and len(kept) < KEPT:  # again, of as many points as it takes
        kept = _between(frame, own, floor, middle, max(0, whole - (KEPT // len(kept)).bit_length()))
    kept = kept[:: len(kept) // KEPT + 1] if len(kept) >= FEWEST else kept[:0]
    return frame.points[kept], frame.sensor[kept].astype(np.int8)


def _between(
    frame: BodyObservation, own: Int[np.ndarray, " own"], floor: Plane, middle: Float32[np.ndarray, "3"], halved: int
) -> Int[np.ndarray, " some"]:
    """Indices of the points between a sensor and the body's `middle`, `halved` that many times."""
    some = even_share(0.5**halved, len(frame.points))  # few shares, for which indices are kept
    points, sensor = picked(frame.points, some), frame.sensor[some]
    up, origins = floor.normal, frame.origins
    way = middle - origins
    way -= (way @ up)[:, None] * up  # on the level
    far = np.linalg.norm(way, axis=1)
    way /= np.maximum(far, ReadSettings.min_range)[:, None]
    kept, height = np.zeros(0, int), floor.height(points)
    for k in np.flatnonzero(far > ReadSettings.min_range):
        (x, y, z), (u, v, w) = way[k], up
        axes = np.array([way[k], (v * z - w * y, w * x - u * z, u * y - v * x)], np.float32)  # along, across: up x way
        along, aside = axes @ points.T - (axes @ origins[k])[:, None]
        between = (along > 0) & (along < far[k]) & (np.abs(aside) * far[k] < ASIDE * along) & (height > LOW)
        if len(origins) > 1:
            between &= sensor == k
        kept = np.concatenate([kept, np.flatnonzero(between)])
    kept, of_body = some[kept], np.zeros(len(frame.points), bool)
    of_body[own] = True
    return kept[~of_body[kept]]


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
