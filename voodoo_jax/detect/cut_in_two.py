"""Joins an object that a nearer one cuts in two in the image: a person who carries a carton, or stands behind a board
or a rail. Host side, NumPy.

Two pieces are joined if one is below the other, their depths are continuous, and everything between them is hidden.
This is used only in the search for the body, not while it is followed: then it would join furniture that a person
passes (experiments/stress).
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from voodoo_jax.detect.body_likelihood import HEADS, TELLING, Build
from voodoo_jax.detect.clearing import GAPS, USUAL_SPACING, Clearing
from voodoo_jax.detect.heads import APART, CELL
from voodoo_jax.detect.visibility import Nearest
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.voxels import within
from voodoo_jax.records.observation import BodyObservation

WIDE = 0.65  # of the body's height: no legs are spread wider in a step, and no trunk with its arms; by hand
NEARER = 0.1  # metres: what hides the gap is so much nearer; the noise of depth is less; by hand
# of the lower piece is under the upper one, and of the places between them is hidden: flying pixels and holes leave
# some; by hand
MOST = 0.8


def joined(
    seen: BodyObservation, label: Int[np.ndarray, " point"], whole: BodyObservation, clearing: Clearing, body: Build
) -> Int[np.ndarray, " point"]:
    """The labels of objects, joined for pieces of one that is cut in two, and for a head and shoulders near it: a neck
    is thin, and the grid of `components` is coarse. For an animal of unknown size, no width distinguishes furniture
    beside it. Arguments as below."""
    if body.loose:
        return label
    points, count, out, floor = seen.points, np.bincount(label), np.array(label), clearing.scene.floor
    lowest = np.full(len(count), np.inf, np.float32)
    np.minimum.at(lowest, label, floor.height(points))
    for k in np.flatnonzero((lowest > HEADS * body.height) & (count >= TELLING)):
        for j in np.flatnonzero((count > count[k]) & (lowest < lowest[k])):
            if within(points[label == k], points[label == j], clearing.link(seen)).any():
                out[out == out[label == k][0]] = out[label == j][0]
    gap = max(clearing.of_sensors(clearing.gap, seen), default=USUAL_SPACING)
    return joined_labels(seen, out, whole, floor, body.height, gap)


# 6 parameters: what is seen, how it hangs together, and what is known of body and sensor
def joined_labels(
    seen: BodyObservation,
    label: Int[np.ndarray, " point"],
    whole: BodyObservation,
    floor: Plane,
    height: float,
    gap: float,
) -> Int[np.ndarray, " point"]:
    """Labels of objects; the pieces of an object that is cut in two have the same label.

    **Arguments:** `seen` the points off floor and walls, and `label` the piece that each belongs to; `whole` all of the
    frame; `height` of the body, metres; `gap` between neighbouring points, radians.
    """
    out, nearest = np.array(label), None
    above, level = floor.height(seen.points), floor.level(seen.points)
    for upper, lower in _one_under_another(label, above, level, WIDE * height):
        k = int(np.bincount(seen.sensor[upper]).argmax())
        edges = _edges(seen, above, (upper, lower), floor, k, gap)
        if edges is None:
            continue
        nearest = nearest or Nearest.of(whole.points, whole.sensor, whole.origins)
        if _hidden(*edges, nearest, k).mean() >= MOST:
            out[out == out[lower[0]]] = out[upper[0]]
    return out


def _one_under_another(
    label: Int[np.ndarray, " point"],
    above: Float32[np.ndarray, " point"],
    level: Float32[np.ndarray, "point 3"],
    wide: float,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Indices of the points of two pieces, an upper and a lower one, that are no wider together than `wide` metres."""
    pieces = [np.flatnonzero(label == k) for k in np.flatnonzero(np.bincount(label) >= TELLING)]
    pieces = [piece for piece in pieces if _extent(level[piece]) < wide]
    middle = [np.median(level[piece], 0) for piece in pieces]
    rise = [np.median(above[piece]) for piece in pieces]
    for i, upper in enumerate(pieces):
        for j, lower in enumerate(pieces):
            if rise[j] >= rise[i] or np.linalg.norm(middle[i] - middle[j]) > wide:
                continue
            beneath = within(level[lower], level[upper], APART).mean() >= MOST
            if beneath and _extent(level[np.concatenate([upper, lower])]) < wide:
                yield upper, lower


def _extent(level: Float32[np.ndarray, "point 3"]) -> float:
    """Horizontal width of an object, without outliers, metres."""
    return float(np.linalg.norm(np.ptp(np.percentile(level, [2, 98], axis=0), axis=0)))


# 6 parameters: as above, and the sensor
def _edges(
    seen: BodyObservation,
    above: Float32[np.ndarray, " point"],
    pieces: tuple[np.ndarray, np.ndarray],
    floor: Plane,
    sensor: int,
    gap: float,
) -> tuple[Float[np.ndarray, "column 3"], Float[np.ndarray, "column 3"]] | None:
    """Lower end of the upper piece and upper end of the lower one, in each strip of a sensor's image with continuous
    depth; None if there is none."""
    origin = seen.origins[sensor]
    sight = floor.level(np.median(seen.points[pieces[0]], 0)[None])[0] - floor.level(origin[None])[0]
    far = float(np.linalg.norm(sight))
    if far < APART:
        return None
    sight /= far
    side = np.cross(floor.normal, sight)
    strip = max(CELL, GAPS * gap * far)  # from top to bottom
    ends: list[dict[int, int]] = []
    for piece, sign in zip(pieces, (-1, 1)):
        piece = piece[seen.sensor[piece] == sensor]
        to = seen.points[piece] - origin
        along = to @ sight
        piece, to, along = (some[along > APART] for some in (piece, to, along))
        column = np.floor(to @ side / along * far / strip).astype(int)
        order = np.argsort(sign * above[piece], kind="stable")  # the last one of a column is its end
        ends.append(dict(zip(column[order].tolist(), piece[order].tolist())))
    both = [k for k in ends[0] if k in ends[1]]
    if not both:
        return None
    upper, lower = (seen.points[[end[k] for k in both]] for end in ends)
    rise = floor.height(upper) - floor.height(lower)
    apart = np.linalg.norm(floor.level(upper) - floor.level(lower), axis=1)
    good = (rise > 0) & (apart < APART)
    if not good.any():
        return None
    return upper[good].astype(float), lower[good].astype(float)


def _hidden(
    upper: Float[np.ndarray, "column 3"], lower: Float[np.ndarray, "column 3"], nearest: Nearest, sensor: int
) -> Bool[np.ndarray, " place"]:
    """Which places between two edges are hidden from the sensor, and not seen as empty by another one."""
    many = np.maximum(np.linalg.norm(upper - lower, axis=1) / CELL, 1).astype(int)
    places = np.concatenate(
        [a + (b - a) * ((np.arange(n) + 0.5) / n)[:, None] for a, b, n in zip(upper, lower, many)]
    ).astype(np.float32)
    hidden = nearest.hides(places, np.full(len(places), sensor), NEARER)
    for other in range(len(nearest.origins)):
        if other != sensor:
            hidden &= ~nearest.empty(places, np.full(len(places), other))
    return hidden
