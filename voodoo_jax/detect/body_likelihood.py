"""Chooses the object that is most likely the body, before it is known. Host side, NumPy."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int

LOOSE = 0.5  # of its height, or more: so high an animal or a machine may be as well
SLIM = 0.6  # of its width at rest: a slimmer object is less likely the body
FEWEST = 50  # points of a thing that may be it
TELLING = 30  # points of a person in a frame, at least: fewer are not informative; by hand
HEAD = (0.15, 0.06)  # the highest part of a body: of its height, and its area, of height times width
NEAR = 4.0  # metres from the sensor: people farther away are less likely the main one
HEADS = 0.6  # of its height: a single object above a body, and higher, is its head; by hand
# likelihood of objects that float, as head and trunk of a person behind something or cut off by the image do; highest
# lower end, as a share of the top's height, and least length, metres; by hand
PART, UPPER, LEAST = 0.3, 0.75, 0.45
SPREAD, SQUAT = 0.8, 0.75  # of its height: a wider and lower object is a counter or a sofa; by hand
TALLEST = 1.35  # of its height: a higher object is not the body; by hand
BROAD = 1.5  # times that area: an object even broader at the top is less likely the body


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
    for k in np.flatnonzero(np.bincount(label) >= FEWEST):
        mine = label == k
        low, top = np.percentile(height[mine], [0.5, 99.5])
        extent = np.ptp(np.percentile(points[mine], [2, 98], axis=0), axis=0)
        own = np.clip(top / body.height, 1 - body.loose, 1 + body.loose)
        high, wide = own * body.height, own * body.width
        tall = least * high <= top <= TALLEST * high
        # as large as the body, or larger: hardly more likely
        likely = areas[k] / (areas[k] + 0.5 * wide * high)
        likely *= min(np.hypot(*np.ptp(places[1:, mine], axis=1)) / (SLIM * wide), 1) ** 2
        likely /= 1 + ((top - high) / (0.15 * high)) ** 2
        head = area[mine & (height > top - HEAD[0] * high)].sum() / (HEAD[1] * wide * high)
        likely /= 1 + max(head / BROAD - 1, 0) ** 2
        likely /= 1 + (np.median(distance[mine]) / NEAR) ** 2
        fits = np.linalg.norm(extent) < max(1.5 * high, np.hypot(wide, high))  # animals are longer than they are high
        if low >= 0.5 * top:
            likely *= PART if low < UPPER * top and top - low > LEAST and not body.loose else 0
        if top < SQUAT * high and np.hypot(*np.ptp(places[1:, mine], axis=1)) > SPREAD * high and not body.loose:
            continue
        if tall and fits and likely > size:
            best, size, highest = int(k), float(likely), float(top)
    return best, highest, size
