"""Detects even small motion, in each direction from a sensor, by the change of distances with time; and static points.
Host side, NumPy; looks ahead.

Distances of a static object differ from frame to frame as much as from frames long before, since noise is uncorrelated:
the ratio of von Neumann 1941 (doi:10.1214/aoms/1177731677) is about 1, and less with motion. It needs no model of the
sensor's noise. A person who stands still sways by some millimetres within some seconds. The mean of points in the same
direction at the same distance in many frames is accurate to some millimetres, however noisy the sensor.
"""

from collections.abc import Sequence
from typing import NamedTuple
from weakref import ref

import numpy as np
from jaxtyping import Bool, Float, Int

from voodoo_jax.detect.body_likelihood import LOOKED_AT, TELLING
from voodoo_jax.detect.visibility import BIN
from voodoo_jax.geometry.point_cloud import point_spacing
from voodoo_jax.geometry.voxels import numbered
from voodoo_jax.records.observation import BodyObservation, assigned, that_differ

OFTEN, FEWEST = 0.25, 8  # of the frames that are looked at in which a thing at rest is seen, and how many at least
WIDE, NARROW = 4.5, 0.04  # times the noise, and metres at least, within which its distances lie
FINE = 4  # cells for each angle between a sensor's points: one for every pixel
UNIT, BITS = 2.5e-4, 18  # metres, and bits of a distance that is counted in them
NOISE = 0.6  # measured: of von Neumann's ratio: noise alone is below in 1.4 % of the directions of 30 frames
RARELY, ALIKE = 0.1, 0.8  # of the frames, and of the usual count of points: an edge is there; by hand


class Resting(NamedTuple):
    """Static points, each the mean of the measurements there, and the frames in which it was seen."""

    points: Float[np.ndarray, "rest 3"]  # fixed frame, metres
    direction: Float[np.ndarray, "rest 3"]  # from their sensor, unit vectors
    pixel: Float[np.ndarray, " rest"]  # metres between neighbours
    frame: Int[np.ndarray, " sight"]
    which: Int[np.ndarray, " sight"]  # of the points was seen in that frame


NOTHING = Resting(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, int), np.zeros(0, int))


def resting(frames: list[BodyObservation]) -> Resting:
    """Static points of the frames, for each sensor; none for a moving sensor."""
    there = that_differ(frames, TELLING)
    there = np.array(there[:: len(there) // LOOKED_AT + 1], int)
    if len(there) < FEWEST / OFTEN / 2:
        return NOTHING
    noise = float(np.median([frames[k].noise for k in there]))
    found, count = [NOTHING], 0
    for sensor in range(len(frames[there[0]].origins)):
        mine = [frames[k].points[frames[k].sensor == sensor] for k in there]
        most = mine[int(np.argmax([len(m) for m in mine]))]
        if len(most) < TELLING:
            continue
        origin = frames[there[0]].origins[sensor].astype(float)
        some = _of_sensor(mine, there, origin, point_spacing(most, frames[there[0]].origins[sensor]), noise)
        found.append(some._replace(which=some.which + count))
        count += len(some.points)
    return Resting(*map(np.concatenate, zip(*found)))


def _of_sensor(
    clouds: list[np.ndarray], there: Int[np.ndarray, " frame"], origin: np.ndarray, spacing: float, noise: float
) -> Resting:
    ray = np.concatenate(clouds).astype(float) - origin
    distance = np.linalg.norm(ray, axis=1)
    ray /= np.maximum(distance, 1e-6)[:, None]
    frame = np.repeat(there, [len(cloud) for cloud in clouds])
    size = max(spacing / FINE, 2e-5)
    x, y, z = np.floor((np.ascontiguousarray(ray.T) + 1) / size).astype(np.int64)
    across = int(2 / size) + 2
    key = ((x * across + y) * across + z) << BITS | np.minimum(distance / UNIT, 2**BITS - 1).astype(np.int64)
    order = np.argsort(key)
    key, frame, distance = key[order], frame[order], distance[order]
    wide = int(max(NARROW, WIDE * noise) / UNIT)
    count = np.searchsorted(key, key + wide) - np.arange(len(key))  # of those that are hardly farther away
    first = np.flatnonzero(np.diff(key >> BITS, prepend=-1))  # of each direction
    best = np.maximum.reduceat(count * len(key) + np.arange(len(key)), first) % len(key)
    best = best[count[best] >= max(FEWEST, OFTEN * len(there))]
    count = count[best]
    total = np.concatenate([[0.0], np.cumsum(distance)])
    mean = (total[best + count] - total[best]) / np.maximum(count, 1)
    which = np.repeat(np.arange(len(best)), count)
    entry = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + best[which]
    direction = ray[order[best]]
    return Resting(origin + direction * mean[:, None], direction, mean * spacing, frame[entry], which)


class Directions(NamedTuple):
    """Directions with measurements."""

    which: list[Int[np.ndarray, " point"]]  # of each frame's points: the direction that it is in
    ratio: Float[np.ndarray, " direction"]  # half of von Neumann's ratio
    often: Float[np.ndarray, " direction"]  # share of the frames with points in which something is seen there
    place: Float[np.ndarray, "direction 3"]  # mean of the points, fixed frame, metres


def seen_long(frames: Sequence[BodyObservation], count: int, seconds: float) -> bool:
    """Whether enough frames over enough seconds have points of static sensors, without assigned parts: stillness is
    informative then."""
    there = [frames[k] for k in that_differ(frames, TELLING)]
    if len(there) < count or (there[-1].time_ns - there[0].time_ns) / 1e9 < seconds:
        return False
    moved = any(f.T_fixed_steady is not None or np.any(f.origins != there[0].origins) for f in there)
    return not moved and not any(assigned(f).any() for f in there)


class Stillness:
    """Motion in the frames of a recording, computed once for successive stages with the same frames, and kept as long
    as these."""

    def __init__(self):
        self._last: tuple[list[ref[BodyObservation]], Directions] | None = None  # of which frames, and what was found

    def directions(self, frames: Sequence[BodyObservation]) -> Directions:
        """As the function `directions`, cached for the last frames."""
        known = self._last
        if known is not None and len(known[0]) == len(frames) and all(a() is b for a, b in zip(known[0], frames)):
            return known[1]
        found = directions(frames)
        self._last = [ref(frame) for frame in frames], found
        return found


def directions(frames: Sequence[BodyObservation]) -> Directions:
    """The directions of all points, and the changes of their distances."""
    sizes = [len(f.points) for f in frames]
    which, count, mean = _means(frames)
    there = count > 0
    whole = there & _as_usual(count)
    both = whole[:, 1:] & whole[:, :-1]
    step = np.sum(np.where(both, np.diff(mean, axis=1), 0) ** 2, 1) / np.maximum(both.sum(1), 1)
    seen = np.maximum(whole.sum(1), 1)
    middle = np.where(whole, mean, 0.0).sum(1) / seen
    spread = np.sum(np.where(whole, mean - middle[:, None], 0) ** 2, 1) / seen
    ratio = np.where(spread > 0, step / np.maximum(2 * spread, 1e-18), 1.0)
    points = (np.concatenate([f.points[:, axis] for f in frames]) for axis in range(3))
    place = np.stack([np.bincount(which, along, len(count)) for along in points], 1) / count.sum(1)[:, None]
    telling = np.array([size >= TELLING for size in sizes])
    often = there[:, telling].sum(1) / max(int(telling.sum()), 1)
    return Directions(np.split(which, np.cumsum(sizes)[:-1]), ratio, often, place)


def _means(
    frames: Sequence[BodyObservation],
) -> tuple[
    Int[np.ndarray, " point"], Int[np.ndarray, "direction frame"], Float[np.ndarray, "direction frame"]
]:  # fmt: skip
    """The direction of each point of all frames, how many are in each direction, and their mean distance, metres."""
    # frame by frame: all at once are many times as much as the processor's caches hold
    numbers, far = map(np.concatenate, zip(*map(_seen, frames)))
    names, which = numbered(numbers)
    at = which * len(frames) + np.repeat(np.arange(len(frames)), [len(f.points) for f in frames])
    shape = (len(names), len(frames))
    count = np.bincount(at, minlength=shape[0] * shape[1]).reshape(shape)
    total = np.bincount(at, far, shape[0] * shape[1]).reshape(shape)
    return which, count, np.where(count > 0, total / np.maximum(count, 1), 0.0)


def _as_usual(count: Int[np.ndarray, "direction frame"]) -> Bool[np.ndarray, "direction frame"]:
    """Frames with about the usual number of points in a direction: otherwise a passing object hides some of them, and
    changes their mean."""
    usual = np.median(count, axis=1, keepdims=True)
    return (count >= ALIKE * usual) & (ALIKE * count <= usual)


def _seen(frame: BodyObservation) -> tuple[Int[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    """The direction of each point and its distance from its sensor, metres."""
    ray = np.ascontiguousarray((frame.points - frame.origins[frame.sensor]).T, float)
    x, y, z = ray
    return _direction(ray, frame.sensor), np.sqrt(x * x + y * y + z * z)


def _direction(ray: Float[np.ndarray, "3 point"], sensor: Int[np.ndarray, " point"]) -> Int[np.ndarray, " point"]:
    """A number for each direction from each sensor."""
    x, y, z = ray
    cells = [np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))]
    azimuth, elevation = (np.floor(cell / np.radians(BIN)).astype(int) + 500 for cell in cells)
    return (sensor.astype(int) * 1000 + azimuth) * 1000 + elevation


def filled(found: Directions) -> Bool[np.ndarray, " direction"]:
    """Directions with a nearly constant number of points: there is no edge of the object or of one moving in front of
    it."""
    count = np.array([np.bincount(which, minlength=len(found.ratio)) for which in found.which])
    least, usual, most = np.quantile(count, [RARELY, 0.5, 1 - RARELY], axis=0)
    return (least >= ALIKE * usual) & (ALIKE * most <= usual)


def moves(found: Directions, often: float) -> Bool[np.ndarray, " direction"]:
    """Which of the often seen directions show motion."""
    return found.ratio[found.often >= often] < NOISE
