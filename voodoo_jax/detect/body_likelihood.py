"""Chooses the object that is most likely the body, before it is known; and finds people lying on the floor, a bed or a
sofa: low, long objects no larger than a body. Host side, NumPy.

Carpets, mattresses and dogs fit this, too; tracklets.py checks whether the object moves.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int

from voodoo_jax.geometry.plane import Plane
from voodoo_jax.records.observation import BodyObservation

LONG = 1.5  # times as long as it is high: a person sitting on the floor with straight legs is shorter; by hand
# of the body's height: least length of a lying person, with knees drawn up; greatest one, with arms overhead, which is
# also the greatest height of a standing one; by hand
SHORTEST, LONGEST = 0.5, 1.35
# of the square of the body's height: the area that is seen of it; by hand (0.05 to 0.15 in 14 simulated people, the top
# and front of a bed have 0.3 and more)
SMALL, LARGE = 0.03, 0.25
LOOKED_AT = 90  # frames, evenly spread; by hand
LOOSE = 0.5  # of its height, or more: so high an animal or a machine may be as well
SLIM = 0.6  # of its width at rest: a slimmer object is less likely the body
TELLING = 30  # points of a person in a frame, or of a thing that may be one: fewer are not informative; by hand
HEAD = (0.15, 0.06)  # the highest part of a body: of its height, and its area, of height times width
NEAR = 4.0  # metres from the sensor: people farther away are less likely the main one
HEADS = 0.6  # of its height: a single object above a body, and higher, is its head; by hand
# likelihood of objects that float, as head and trunk of a person behind something or cut off by the image do; least
# length, metres; by hand
PART, LEAST = 0.3, 0.45
SPREAD, SQUAT = 0.8, 0.75  # of its height: a wider and lower object is a counter or a sofa; by hand
BROAD = 1.5  # times that area: an object even broader at the top is less likely the body


class Extent(NamedTuple):
    """How some points lie."""

    axis: Float[np.ndarray, "3"]  # level unit vector along which they are longest
    middle: Float[np.ndarray, "3"]  # of them, fixed frame, metres
    length: float  # metres along the axis
    height: float  # metres from the lowest to the highest one

    @property
    def lies(self) -> bool:
        """Whether the points are low and long."""
        return self.length > LONG * self.height


def extent(points: Float32[np.ndarray, "point 3"], floor: Plane) -> Extent:
    """Extent of some points, without outliers."""
    level, height = floor.level(points).astype(float), floor.height(points).astype(float)
    away = level - level.mean(0)
    axis = np.linalg.eigh(away.T @ away)[1][:, -1]
    along = away @ axis
    first, last = np.percentile(along, [1, 99])
    low, high = np.percentile(height, [1, 99])
    centre = np.median(away - along[:, None] * axis, 0)
    middle = level.mean(0) + (first + last) / 2 * axis + centre + np.median(height) * floor.normal
    return Extent(axis, middle, float(last - first), float(high - low))


def mostly_lie(frames: list[BodyObservation], floor: Plane) -> bool:
    """Whether the points of most frames are low and long."""
    seen = [f for f in frames if len(f.points) >= TELLING]
    return bool(np.mean([extent(f.points, floor).lies for f in seen[:: len(seen) // LOOKED_AT + 1]] or [False]) > 0.5)


def find_lying(
    points: Float32[np.ndarray, "point 3"],
    label: Int[np.ndarray, " point"],
    area: Float[np.ndarray, " point"],
    floor: Plane,
    height: float,
) -> int:
    """Label of the largest object that may be a lying body; -1 if there is none.

    **Arguments:** as for `candidate`; `height` of the body, metres.
    """
    best, largest = -1, 0.0
    for k in np.flatnonzero(np.bincount(label) >= TELLING):
        mine = label == k
        found, size = extent(points[mine], floor), float(area[mine].sum())
        long = SHORTEST * height <= found.length <= LONGEST * height
        if long and found.lies and SMALL * height**2 <= size <= LARGE * height**2 and size > largest:
            best, largest = int(k), size
    return best


class Build(NamedTuple):
    """Size of the body in its rest pose."""

    height: float  # metres
    width: float  # horizontal, from end to end, metres
    loose: float = 0.0  # uncertainty of its size, as a share

    @property
    def reach(self) -> float:
        """The larger of its height and width at the largest plausible size, metres."""
        return max(self.height, self.width) * (1 + self.loose)


# 7 parameters: what is measured of a thing, each once
def candidate(
    points: Float32[np.ndarray, "point 3"],
    label: Int[np.ndarray, " point"],
    area: Float[np.ndarray, " point"],
    distance: Float[np.ndarray, " point"],
    places: Float32[np.ndarray, "3 point"],
    body: Build,
    least: float,
) -> tuple[int, float, float]:
    """Label of the object that is most like the body, the height of its top, and its likelihood, 0..1. It is about as
    high as the body and not much wider; the largest of several. Objects of another height, poles, and objects as broad
    at the top as below are less likely. -1 if there is none.

    **Arguments:** `label` of each point's object; `area` that each point stands for, square metres (near objects have
    more points); `distance` from its sensor, metres; `places` heights above the floor and level coordinates, metres;
    `least` the lowest top, as a share of the body's height.
    """
    height, areas = places[0], np.bincount(label, area)
    best, size, highest = -1, 0.0, 0.0
    for k in np.flatnonzero(np.bincount(label) >= TELLING):
        mine = label == k
        low, top = np.percentile(height[mine], [0.5, 99.5])
        extent = np.ptp(np.percentile(points[mine], [2, 98], axis=0), axis=0)
        own = np.clip(top / body.height, 1 - body.loose, 1 + body.loose)
        high, wide = own * body.height, own * body.width
        tall = least * high <= top <= LONGEST * high
        # as large as the body, or larger: hardly more likely
        likely = areas[k] / (areas[k] + 0.5 * wide * high)
        likely *= min(np.hypot(*np.ptp(places[1:, mine], axis=1)) / (SLIM * wide), 1) ** 2
        likely /= 1 + ((top - high) / (0.15 * high)) ** 2
        head = area[mine & (height > top - HEAD[0] * high)].sum() / (HEAD[1] * wide * high)
        likely /= 1 + max(head / BROAD - 1, 0) ** 2
        likely /= 1 + (np.median(distance[mine]) / NEAR) ** 2
        fits = np.linalg.norm(extent) < max(1.5 * high, np.hypot(wide, high))  # animals are longer than they are high
        if low >= 0.5 * top:
            likely *= PART if top - low > LEAST and not body.loose else 0
        if top < SQUAT * high and np.hypot(*np.ptp(places[1:, mine], axis=1)) > SPREAD * high and not body.loose:
            continue
        if tall and fits and likely > size:
            best, size, highest = int(k), float(likely), float(top)
    return best, highest, size
