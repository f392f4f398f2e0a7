"""Points of one frame: how dense they are, flying pixels, a fair choice. Host side, NumPy."""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float32, Int, UInt8
from scipy.spatial import KDTree

ASKED, FEWER = 2000, 300  # points whose nearest neighbours are looked at, and whose neighbours in all directions
# the golden ratio less 1: shares of its multiples are spread evenly, in every part of a list and from row to row of an
# image (Knuth 1973, The Art of Computer Programming 3, sec. 6.4)
GOLDEN = (5**0.5 - 1) / 2
ROW = 3  # points before and after in a list are looked at first: as many neighbours as no flying pixel has
PAYS = 600  # points without enough of them, of which so many are found in the picture that it takes less time; measured
PICTURE = 1_000_000  # cells of a picture: to fill a larger one takes longer than a search tree; by hand
AROUND = 100  # neighbours of a point among which the nearest in every direction is looked for


def point_spacing(points: Float32[np.ndarray, "point 3"], origin: Float32[np.ndarray, "3"]) -> float:
    """Angle between neighbouring points as seen from the sensor, radians (median)."""
    rays = _directions(points, origin)
    return float(np.median(KDTree(rays).query(rays[:: max(1, len(rays) // ASKED)], k=2)[0][:, 1]))


def point_gap(points: Float32[np.ndarray, "point 3"], origin: Float32[np.ndarray, "3"]) -> float:
    """Angle across which the next point is found in any direction, radians (median; 0 for too few points): of a
    scanner the angle between its rows, however close the points of a row are."""
    if len(points) < AROUND:
        return 0.0
    rays = _directions(points, origin)
    places = rays @ np.linalg.svd(rays.mean(0)[None])[2][1:].T
    distance, index = map(np.asarray, KDTree(places).query(places[:: len(places) // FEWER + 1], k=AROUND))
    apart = places[index[:, 1:]] - places[index[:, :1]]
    line = np.floor(np.arctan2(apart[..., 1], apart[..., 0]) / (np.pi / 4) + 0.5).astype(int) % 4  # four lines
    nearest = np.stack([np.min(np.where(line == k, distance[:, 1:], np.inf), 1) for k in range(4)])
    widest = np.max(nearest, 0)
    return float(np.median(widest[np.isfinite(widest)])) if np.isfinite(widest).any() else 0.0


def without_strays(
    points: Float32[np.ndarray, "point 3"], origin: Float32[np.ndarray, "3"], spacing: float
) -> Bool[np.ndarray, " point"]:
    """False for flying pixels: points with fewer than three others as near as neighbours on a surface are.

    `spacing` is the sensor's, radians. Flying pixels at the edge of a near thing bridge the gap to what is behind it.
    """
    if len(points) < 5:
        return np.zeros(len(points), bool)
    xyz = np.ascontiguousarray(points.T)  # by coordinate: several times as fast to go through
    to = xyz - origin[:, None]
    near = 0.02 + 3 * spacing * _length(to)
    # points come row by row: those before and after in the list are most often neighbours, and spare the search
    others, along = np.zeros(len(points), np.uint8), np.zeros(3, np.float32)
    for step in range(1, ROW + 1):
        apart = xyz[:, step:] - xyz[:, :-step]
        far = _length(apart)
        others[step:] += far < near[step:]
        others[:-step] += far < near[:-step]
        along += apart @ (far < near[step:])
    rest = np.flatnonzero(others < 3)
    if len(rest) >= PAYS:
        others[rest] += _in_next_rows(xyz, to, along, spacing, rest, near)
    kept = others >= 3
    rest = np.flatnonzero(~kept)
    tree = KDTree(points, leafsize=32, balanced_tree=False, compact_nodes=False)  # sooner made than it is asked
    kept[rest] = tree.query(points[rest], k=4, distance_upper_bound=1.01 * float(near.max()))[0][:, 3] < near[rest]
    return kept


# 6 parameters: what without_strays knows of the points by then
def _in_next_rows(
    xyz: Float32[np.ndarray, "3 point"],
    to: Float32[np.ndarray, "3 point"],
    along: Float32[np.ndarray, "3"],
    spacing: float,
    rest: Int[np.ndarray, " rest"],
    near: Float32[np.ndarray, " point"],
) -> UInt8[np.ndarray, " rest"]:
    """How many points that are no neighbours in the list are `near` each of the `rest`, of those that are in the next
    cells of the picture: as many as are found at once, there may be more.

    **Arguments:** `to` the points from their sensor; `along` the way that rows go; `spacing` radians.
    """
    none = np.zeros(len(rest), np.uint8)
    ahead = _unit(np.mean(to, 1))
    row = _unit(along - (along @ ahead) * ahead)
    x, y, depth = np.stack([np.cross(ahead, row), row, ahead]) @ to
    if not row.any() or np.min(depth) <= 0 or spacing <= 0:  # around the sensor there is no picture
        return none
    place = np.stack([x, y]) / (np.float32(spacing) * depth)
    place -= np.min(place, 1, keepdims=True)
    high, wide = (np.ceil(np.max(place, 1)).astype(int) + 3).tolist()  # and an empty cell all around
    if high * wide > PICTURE:
        return none
    number = (place[0].astype(np.int32) + 1) * wide + place[1].astype(np.int32) + 1
    picture = np.full(high * wide, len(to[0]), np.int32)  # no point
    picture[number] = np.arange(len(to[0]), dtype=np.int32)
    beside = picture[number[rest] + np.add.outer((-wide, wide), (-1, 0, 1)).reshape(-1, 1)]
    every = np.append(xyz, np.full((3, 1), np.inf, np.float32), 1)
    apart = _length(np.take(every, beside, 1) - xyz[:, rest][:, None])
    found = (apart < near[rest]) & (np.abs(beside - rest) > ROW)
    return found.sum(0, np.uint8)


def _unit(v: Float32[np.ndarray, "3"]) -> Float32[np.ndarray, "3"]:
    """A vector of length 1 in the same direction; zero where there is none."""
    length = np.float32(np.linalg.norm(v))
    return v / length if length > 0 else v


def _directions(
    points: Float32[np.ndarray, "point 3"], origin: Float32[np.ndarray, "3"]
) -> Float32[np.ndarray, "point 3"]:
    """Unit vectors from the sensor to its points."""
    rays = points - origin
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _length(v: Float32[np.ndarray, "3 *point"]) -> Float32[np.ndarray, " *point"]:
    x, y, z = v
    return np.sqrt(x * x + y * y + z * z)


def along(
    axes: Float32[np.ndarray, "axis 3"], points: Float32[np.ndarray, "point 3"], start: Float32[np.ndarray, " axis"]
) -> Float32[np.ndarray, "axis point"]:
    """How far points are along some axes from where these start, metres.

    A coordinate after the other, which are best so in memory: as a product of matrices, so slim a one is slower, keeps
    several cores busy, and has other last digits with each number of them.
    """
    x, y, z = points.T
    found, part = np.empty((len(axes), len(points)), np.float32), np.empty(len(points), np.float32)
    for (a, b, c), at, out in zip(axes, start, found):  # (a x + b y + c z) - at, without room for each of them
        np.multiply(x, a, out=out)
        for k, other in ((b, y), (c, z)):
            out += np.multiply(other, k, out=part)
        out -= at
    return found


def picked(points: Float32[np.ndarray, "point 3"], index: Int[np.ndarray, " some"]) -> Float32[np.ndarray, "some 3"]:
    """Some of the points, by coordinate in memory: where they are so already, several times as fast as by rows."""
    found = np.empty((3, len(index)), np.float32)
    for coordinate, out in zip(points.T, found):
        np.take(coordinate, index, out=out, mode="clip")  # other modes write elsewhere first
    return found.T


def fair_share(sensor: Int[np.ndarray, " point"], most: int) -> Int[np.ndarray, " kept"]:
    """Indices of about `most` points at most: of each sensor every first, second, ... point, of the densest the fewest.

    `sensor` [point] says which sensor saw each point.
    """
    if len(sensor) <= most:
        return np.arange(len(sensor))
    if not sensor.max():  # one sensor, as mostly: sooner seen than counted
        return np.arange(0, len(sensor), len(sensor) // max(most, 1) + 1)
    counts = np.bincount(sensor)
    room, share = most, 0
    for left, count in zip(range(len(counts), 0, -1), np.sort(counts)):  # what a sensor leaves is for the denser ones
        share = room // left
        room -= min(int(count), share)
    step = [1 if n <= share else int(n) // max(share, 1) + 1 for n in counts]
    return np.sort(np.concatenate([np.flatnonzero(sensor == s)[::k] for s, k in enumerate(step)]))


def even_share(share: float, count: int) -> Int[np.ndarray, " kept"]:
    """Indices of a share of `count` points, spread evenly: unlike every fourth one, of an image they are no columns."""
    found = _even_share(share, 1 << max(count - 1, 1).bit_length())
    return found[: np.searchsorted(found, count)]


@lru_cache(16)
def _even_share(share: float, count: int) -> Int[np.ndarray, " kept"]:
    return np.flatnonzero(np.arange(count) * GOLDEN % 1.0 < share)
