"""Static points while a body is followed: in the same direction from a sensor, at the same distance, in many frames.
Their mean is accurate to some millimetres, however noisy the sensor. Host side, NumPy; looks ahead."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from voodoo_jax.detect.body_likelihood import TELLING
from voodoo_jax.geometry.point_cloud import point_spacing
from voodoo_jax.records.observation import BodyObservation, that_differ

FRAMES = 90  # are looked at, evenly spread
OFTEN, FEWEST = 0.25, 8  # of them in which a thing at rest is seen, and how many at least
WIDE, NARROW = 4.5, 0.04  # times the noise, and metres at least, within which its distances lie
FINE = 4  # cells for each angle between a sensor's points: one for every pixel
UNIT, BITS = 2.5e-4, 18  # metres, and bits of a distance that is counted in them


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
    there = np.array(there[:: len(there) // FRAMES + 1], int)
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
