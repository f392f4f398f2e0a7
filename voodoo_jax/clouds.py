"""Points of one frame: how dense they are, flying pixels, a fair choice. Host side, NumPy."""

import numpy as np
from jaxtyping import Bool, Float32, Int, UInt32
from scipy.spatial import KDTree

from voodoo_jax.cells import cells_of, number_around

CELL = 0.59  # of a radius: three cells next to each other have the area of the circle
BAND = 1.5  # times the smallest radius: so large a one is counted in the same cells
HARDLY, SURELY = 2, 12  # points around, itself among them: with fewer it has no three neighbours, with more it has
PAIRS = 2_000_000  # of points that are compared one by one in less time than a search tree is made
ASKED, FEWER = 2000, 300  # points whose nearest neighbours are looked at, and whose neighbours in all directions
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
    near = 0.02 + 3 * spacing * _length(xyz - origin[:, None])
    around = _number_around(points, near)
    kept = around > SURELY
    open_ = np.flatnonzero((around >= HARDLY) & ~kept)
    if len(open_) * len(points) <= PAIRS:
        kept[open_] = _number_within(xyz, open_, near[open_]) > 3  # itself among them
    else:
        kept[open_] = KDTree(points).query(points[open_], k=4)[0][:, 3] < near[open_]
    return kept


def _number_around(
    points: Float32[np.ndarray, "point 3"], near: Float32[np.ndarray, " point"]
) -> Int[np.ndarray, " point"]:
    """How many points are in a box about as wide as two distances `near` around each of them, by cells of such widths
    that no point's is more than a little off."""
    low, high = float(near.min()), float(near.max())
    bands = 1 + int(np.log(high / low) / np.log(BAND))
    if bands == 1:
        return number_around(cells_of(points, CELL * float(np.sqrt(low * high))))
    around = np.zeros(len(points), np.int32)
    which = np.minimum(np.log(near / low) * (bands / np.log(high / low)), bands - 1).astype(int)
    for band in np.flatnonzero(np.bincount(which)):
        mine = which == band
        cells = cells_of(points, CELL * low * float((high / low) ** ((band + 0.5) / bands)))
        around[mine] = number_around(cells)[mine]
    return around


def _number_within(
    xyz: Float32[np.ndarray, "3 point"], asked: Int[np.ndarray, " asked"], distance: Float32[np.ndarray, " asked"]
) -> UInt32[np.ndarray, " asked"]:
    """How many points are nearer than a distance to each of some of them, by all pairs."""
    xyz = xyz - xyz.mean(1, keepdims=True)  # digits
    square = np.sum(xyz * xyz, 0)
    # |a - b|^2 < d^2 as b^2 - 2 a b < d^2 - a^2: one product of matrices
    left = np.stack([*(-2 * xyz[:, asked]), np.ones(len(asked), np.float32)], 1) @ np.stack([*xyz, square])
    nearer = left < (distance * distance - square[asked])[:, None]
    return nearer.view(np.uint8).sum(1, dtype=np.uint32)  # several times as fast as to count them


def _directions(
    points: Float32[np.ndarray, "point 3"], origin: Float32[np.ndarray, "3"]
) -> Float32[np.ndarray, "point 3"]:
    """Unit vectors from the sensor to its points."""
    rays = points - origin
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _length(v: Float32[np.ndarray, "3 point"]) -> Float32[np.ndarray, " point"]:
    x, y, z = v
    return np.sqrt(x * x + y * y + z * z)


def fair_share(sensor: Int[np.ndarray, " point"], most: int) -> Int[np.ndarray, " kept"]:
    """Indices of about `most` points at most: of each sensor every first, second, ... point, of the densest the fewest.

    `sensor` [point] says which sensor saw each point.
    """
    if len(sensor) <= most:
        return np.arange(len(sensor))
    counts = np.bincount(sensor)
    if len(counts) == 1:
        return np.arange(0, len(sensor), len(sensor) // max(most, 1) + 1)
    room, share = most, 0
    for left, count in zip(range(len(counts), 0, -1), np.sort(counts)):  # what a sensor leaves is for the denser ones
        share = room // left
        room -= min(int(count), share)
    step = [1 if n <= share else int(n) // max(share, 1) + 1 for n in counts]
    return np.sort(np.concatenate([np.flatnonzero(sensor == s)[::k] for s, k in enumerate(step)]))
