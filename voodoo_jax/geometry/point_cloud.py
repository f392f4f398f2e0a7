"""Points of one frame: how dense they are, flying pixels, a fair choice. Host side, NumPy."""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt16
from scipy.spatial import KDTree

ASKED, FEWER = 2000, 300  # points whose nearest neighbours are looked at, and whose neighbours in all directions
# the golden ratio less 1: shares of its multiples are spread evenly, in every part of a list and from row to row of an
# image (Knuth 1973, The Art of Computer Programming 3, sec. 6.4)
GOLDEN = (5**0.5 - 1) / 2
ROW = 3  # points before and after in a list are looked at first: as many neighbours as no flying pixel has
PAYS = 600  # points: for fewer a search tree takes less time than a picture; measured
CUBE = np.float32((4 / 3 * np.pi) ** (1 / 3) / 3)  # of a radius: a cube of 27 cells so wide is as large as its ball
PER_POINT = 150  # cells for each point: to go through more takes longer than a search tree; measured
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
    to = np.subtract(points.T, origin[:, None], order="C")  # by coordinate: several times as fast to go through
    near = 0.02 + 3 * spacing * _length(to)
    together = _together(to, near, spacing) if spacing > 0 and len(points) >= PAYS else None
    if together is not None:
        return together >= 4
    # points come row by row: those before and after in the list are most often neighbours, and spare the search
    others = np.zeros(len(points), np.uint8)
    for step in range(1, ROW + 1):
        close = _length(to[:, step:] - to[:, :-step]) < near[step:]
        others[step:] += close
        others[:-step] += close
    kept = others >= 3
    rest = np.flatnonzero(~kept)
    tree = KDTree(points, leafsize=32, balanced_tree=False, compact_nodes=False)  # sooner made than it is asked
    kept[rest] = tree.query(points[rest], k=4, distance_upper_bound=1.01 * float(near.max()))[0][:, 3] < near[rest]
    return kept


def _together(
    to: Float32[np.ndarray, "3 point"], near: Float32[np.ndarray, " point"], spacing: float
) -> UInt16[np.ndarray, " point"] | None:
    """How many points are in each one's cell or one that touches it, of cells in the picture and in depth that are so
    large that those together are as large as a ball of the radius `near`; None where cells would be too many for that,
    or there is no picture, around the sensor.

    **Arguments:** `to` the points from their sensor; `near` metres; `spacing` radians.
    """
    ahead = _unit(np.mean(to, 1))
    beside = np.zeros(3, np.float32)
    beside[np.argmin(np.abs(ahead))] = 1
    beside = _unit(beside - (beside @ ahead) * ahead)
    across = np.array([ahead[k - 2] * beside[k - 1] - ahead[k - 1] * beside[k - 2] for k in range(3)])
    x, y, depth = np.einsum("ij,jn->in", np.array([beside, across, ahead], np.float32), to)
    if np.min(depth) <= 0:
        return None
    wide = CUBE * quantile(near / depth, 0.5)
    depth *= wide
    x /= depth
    y /= depth
    # so each step in depth is as many cells as it is times `near`
    cells = np.array([x, y, np.log(near) / (3 * np.float32(spacing) * CUBE)])
    cells -= np.min(cells, 1, keepdims=True) - 1
    if np.prod(np.max(cells, 1) + 2) > PER_POINT * len(near):
        return None
    cells = cells.astype(np.int32)
    columns, layers = (np.max(cells[1:], 1) + 2).tolist()
    number = (cells[0] * columns + cells[1]) * layers + cells[2]
    count = np.bincount(number, minlength=int(np.max(number)) + columns * layers + layers + 2).astype(np.uint16)
    for step in (columns * layers, layers, 1):
        wider = count.copy()
        wider[step:] += count[:-step]
        wider[:-step] += count[step:]
        count = wider
    return count[number]


def quantile(values: Float[np.ndarray, "some *each"], share: float) -> Float[np.ndarray, "*each"]:
    """The one of some values, or in each column, that a share of the others is below: not between two, as NumPy's,
    which takes ten times as long for a thousand."""
    at = round(share * (len(values) - 1))
    return np.asarray(np.partition(values, at, axis=0)[at])


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
        coordinate.take(index, out=out, mode="clip")  # other modes write elsewhere first
    return found.T


def inside(
    points: Float32[np.ndarray, "point 3"],
    low: Float32[np.ndarray, "3"],
    high: Float32[np.ndarray, "3"],
    among: Int[np.ndarray, " some"] | None = None,
) -> Int[np.ndarray, " kept"]:
    """Indices of the points, `among` some of them (None: all), that are in a box."""
    for coordinate, least, most in zip(points.T, low, high):
        place = coordinate if among is None else coordinate.take(among)
        kept = ((place >= least) & (place <= most)).nonzero()[0]
        among = kept if among is None else among.take(kept)
    assert among is not None
    return among


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
