"""Finds people lying on the floor, a bed or a sofa: low, long objects no larger than a body. Host side, NumPy.

Carpets, mattresses and dogs fit this, too; tracklets.py checks whether the object moves.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int

from voodoo_jax.detect.body_likelihood import FEWEST
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.records.observation import BodyObservation

LONG = 1.5  # times as long as it is high: a person sitting on the floor with straight legs is shorter; by hand
# of the body's height: length of a lying person, with knees drawn up or arms overhead; by hand
SHORTEST, LONGEST = 0.5, 1.3
HIGHEST = 0.5  # likewise, from the lowest to the highest point: shoulders are a quarter as wide; by hand
# of the square of the body's height: the area that is seen of it; by hand (0.05 to 0.15 in 14 simulated people, the top
# and front of a bed have 0.3 and more)
SMALL, LARGE = 0.03, 0.25
BROAD = 0.35  # of the body's height: the width of the half of the points that is nearest to the length; by hand
LOOKED_AT = 30  # frames, evenly spread; by hand


class Extent(NamedTuple):
    """How some points lie."""

    axis: Float[np.ndarray, "3"]  # level unit vector along which they are longest
    middle: Float[np.ndarray, "3"]  # of them, fixed frame, metres
    length: float  # metres along the axis
    height: float  # metres from the lowest to the highest one
    width: float  # metres, level, of the half of them that is nearest to the axis

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
    aside = away - along[:, None] * axis
    centre = np.median(aside, 0)
    width = 2 * float(np.median(np.linalg.norm(aside - centre, axis=1)))
    middle = level.mean(0) + (first + last) / 2 * axis + centre + np.median(height) * floor.normal
    return Extent(axis, middle, float(last - first), float(high - low), width)


def mostly_lie(frames: list[BodyObservation], floor: Plane) -> bool:
    """Whether the points of most frames are low and long."""
    seen = [f for f in frames if len(f.points) >= FEWEST]
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
    for k in np.flatnonzero(np.bincount(label) >= FEWEST):
        mine = label == k
        found, size = extent(points[mine], floor), float(area[mine].sum())
        long = SHORTEST * height <= found.length <= LONGEST * height
        flat = found.lies and found.height <= HIGHEST * height and found.width <= BROAD * height
        if long and flat and SMALL * height**2 <= size <= LARGE * height**2 and size > largest:
            best, largest = int(k), size
    return best
