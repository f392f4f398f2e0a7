"""Heads separate people who touch each other. Host side, NumPy.

A connected component may be several people who stand shoulder to shoulder, hold hands or embrace. Seen from above,
heads are local maxima of height with lower points between them; below a head there is a body, unlike below a raised
hand.
"""

import numpy as np
from jaxtyping import Float32, Int

from voodoo_jax.detect.body_likelihood import HEADS, LONGEST, TELLING, Build
from voodoo_jax.detect.clearing import Clearing
from voodoo_jax.geometry.voxels import cells_of, spread, touching

CELL = 0.05  # metres, of the map of heights, and of strips in cut_in_two: as wide as a hand, two in a limb; by hand
BRIDGED = 2  # cells: ground that is no farther from other ground hangs together with it; by hand
# of the body's height: so much lower is the ground between two heads. Shoulders are 0.18 below the top of the head (in
# ANSUR II), arms around shoulders are in between; by hand
DROP = 0.07
# metres, level, at least, between two heads, and at most between the edges of what hangs together in depth: a chest is
# 0.25 deep (ANSUR II), and people lean; by hand
APART = 0.28
LOWEST, FILLED = 0.45, 0.85  # of its top, and share of the bands from there up: how much of a body is there; by hand
MOST = 4.5  # metres: what is wider is a room; by hand


def each_person(
    points: Float32[np.ndarray, "point 3"], label: Int[np.ndarray, " point"], clearing: Clearing, body: Build
) -> Int[np.ndarray, " point"]:
    """The labels of objects, with one for each of several connected people."""
    out = np.array(label)
    if body.loose:
        return out
    height, *level = clearing.places(points)
    level, flat = np.stack(level), clearing.scene.floor.level
    for k in np.flatnonzero(np.bincount(label) >= 2 * TELLING):
        mine = np.flatnonzero(label == k)
        if not APART <= np.hypot(*np.ptp(level[:, mine], axis=1)) <= MOST:
            continue
        # a head hangs together with its body by a neck that may not be seen
        high = (label != k) & (height > HEADS * body.height)
        above = np.flatnonzero(high)[touching(*(cells_of(flat(points[some]), BRIDGED * CELL) for some in (high, mine)))]
        both = np.concatenate([mine, above])
        who = parted(height[both], level[:, both], body, clearing.settings.min_height)
        out[both[who > 0]] = out.max() + who[who > 0]
    return out


def parted(
    height: Float32[np.ndarray, " point"], level: Float32[np.ndarray, "2 point"], body: Build, least: float
) -> Int[np.ndarray, " point"]:
    """Number of the person that each point of an object belongs to: all 0 unless there are several heads.

    **Arguments:** `height` above the floor and `level` coordinates, metres; `least` the lowest top of a person, as a
    share of the body's height.
    """
    heads = [spot for spot in summits(height, level, DROP * body.height) if _has_body(height, level, spot, body, least)]
    far: list[np.ndarray] = []
    for spot in heads:  # the highest first
        if all(np.linalg.norm(spot[:2] - other[:2]) >= APART for other in far):
            far.append(spot)
    if len(far) < 2:
        return np.zeros(len(height), int)
    off = np.stack([np.hypot(*(level - spot[:2, None])) for spot in far])
    return np.argmin(off, 0)


def summits(
    height: Float32[np.ndarray, " point"], level: Float32[np.ndarray, "2 point"], drop: float
) -> list[Float32[np.ndarray, "3"]]:
    """Local maxima (level coordinates and height, metres) whose prominence is at least `drop`, the highest first."""
    corner = np.floor(level.min(1) / CELL).astype(int) - BRIDGED
    row, column = np.floor(level / CELL).astype(int) - corner[:, None]
    shape = (row.max() + BRIDGED + 1, column.max() + BRIDGED + 1)
    top = np.full(shape, -np.inf, np.float32)
    np.maximum.at(top, (row, column), height)
    found, left = [], top.copy()
    while np.isfinite(left).any():
        at = np.unravel_index(np.argmax(left), shape)
        peak = float(left[at])
        reached = _reached(top, at, peak - drop)
        if float(np.max(top[reached])) <= peak:
            middle = (np.argwhere(reached).mean(0) + corner + 0.5) * CELL
            found.append(np.array([*middle, peak], np.float32))
        left[reached] = -np.inf
    return found


def _reached(top: np.ndarray, start: tuple, least: float) -> np.ndarray:
    """The cells connected with one over cells not lower than `least`."""
    ground, reached = (top >= least).ravel(), np.zeros(top.shape, bool)
    reached[start] = True
    while True:
        wider = spread(reached.ravel(), (top.shape[1], 1), BRIDGED) & ground
        if wider.sum() == reached.sum():
            return reached
        reached = wider.reshape(top.shape)


def _has_body(height: np.ndarray, level: np.ndarray, spot: np.ndarray, body: Build, least: float) -> bool:
    """Whether a head is as high as a person's may be, with a body below it."""
    top = float(spot[2])
    if not least * body.height <= top <= LONGEST * body.height:
        return False
    under = height[np.hypot(*(level - spot[:2, None])) < APART / 2]  # what is under it
    low = max(LOWEST * top, float(np.min(height)))
    high = BRIDGED * CELL
    bands = np.arange(low, top - high / 2, high)
    if len(bands) < 3:
        return False
    return bool(np.mean(np.histogram(under, [*bands, top + high])[0] > 0) >= FILLED)
