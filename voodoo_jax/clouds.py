"""Points of one frame: cells, things that hang together, flying pixels, a fair choice. Host side, NumPy."""

import numpy as np
from jaxtyping import Bool, Float32, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree


def cells_of(points: Float32[np.ndarray, "point 3"], size: float) -> Int[np.ndarray, "point 3"]:
    """Which cell of a grid each point is in; cells are `size` metres wide."""
    return np.floor(points / np.float32(size)).astype(np.int64)


def unique_cells(cells: Int[np.ndarray, "point 3"]) -> tuple[Int[np.ndarray, "cell 3"], Int[np.ndarray, " point"]]:
    """The cells that occur, in order, and which of them each entry is: np.unique by one number for each cell, which is
    several times as fast as by rows."""
    if not len(cells):
        return cells, np.zeros(0, np.int64)
    low = cells.min(0)
    span = cells.max(0) - low + 1
    if np.prod(span.astype(float)) > 2**62:
        unique, inverse = np.unique(cells, axis=0, return_inverse=True)
        return unique, inverse.ravel()
    x, y, z = (cells - low).T
    key, inverse = np.unique((x * span[1] + y) * span[2] + z, return_inverse=True)
    return np.stack([key // (span[1] * span[2]), key // span[2] % span[1], key % span[2]], 1) + low, inverse


def components(points: Float32[np.ndarray, "point 3"], link: float) -> Int[np.ndarray, " point"]:
    """Labels of connected things: points in touching cells of half of `link` metres belong together."""
    middle, inverse = unique_cells(cells_of(points, link / 2))
    # the 26 cells around: a distance between half and the whole of `link`
    pairs = KDTree(middle).query_pairs(1.8, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(middle),) * 2)
    return connected_components(graph, directed=False)[1][inverse]


def point_spacing(points: Float32[np.ndarray, "point 3"], origin: Float32[np.ndarray, "3"]) -> float:
    """Angle between neighbouring points as seen from the sensor, radians (median)."""
    rays = points - origin
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return float(np.median(KDTree(rays).query(rays[:: max(1, len(rays) // 2000)], k=2)[0][:, 1]))


def without_strays(
    points: Float32[np.ndarray, "point 3"], origin: Float32[np.ndarray, "3"], spacing: float
) -> Bool[np.ndarray, " point"]:
    """False for flying pixels: points with fewer than three others as near as neighbours on a surface are.

    `spacing` is the sensor's, radians. Flying pixels at the edge of a near thing bridge the gap to what is behind it.
    """
    if len(points) < 5:
        return np.zeros(len(points), bool)
    near = 0.02 + 3 * spacing * np.linalg.norm(points - origin, axis=1)
    # points come row by row: those before and after in the list are most often neighbours, and spare the search
    others = np.zeros(len(points), int)
    for step in (1, 2, 3):
        apart = np.linalg.norm(points[step:] - points[:-step], axis=1)
        others[step:] += apart < near[step:]
        others[:-step] += apart < near[:-step]
    kept = others >= 3
    rest = np.flatnonzero(~kept)
    tree = KDTree(points, balanced_tree=False, compact_nodes=False)  # faster to make than it is to ask
    kept[rest] = tree.query(points[rest], k=4, distance_upper_bound=1.01 * float(near.max()))[0][:, 3] < near[rest]
    return kept


def fair_share(sensor: Int[np.ndarray, " point"], most: int) -> Int[np.ndarray, " kept"]:
    """Indices of about `most` points at most: of each sensor every first, second, ... point, of the densest the fewest.

    `sensor` [point] says which sensor saw each point.
    """
    counts = np.bincount(sensor)
    if len(sensor) <= most:
        return np.arange(len(sensor))
    room, share = most, 0
    for left, count in zip(range(len(counts), 0, -1), np.sort(counts)):  # what a sensor leaves is for the denser ones
        share = room // left
        room -= min(int(count), share)
    step = [1 if n <= share else int(n) // max(share, 1) + 1 for n in counts]
    return np.sort(np.concatenate([np.flatnonzero(sensor == s)[::k] for s, k in enumerate(step)]))
