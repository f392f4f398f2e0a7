"""A grid of cells in space: which of them are taken, touch each other, hang together. Host side, NumPy.

Where all cells fit into a box of moderate size, a cell is looked up in an array of the whole box; else by sorting.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

SMALL = 300_000  # cells of a box: to go through all of it takes less time than to number what is near the taken ones
MODERATE = 1_000_000  # cells of a box: to fill a larger array takes longer than to sort the cells that are taken
LARGE = 8_000_000  # the same of an array of which only what is near the taken ones is looked at
# of a cell and the 26 around it those that come later in order: each pair once
LATER = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)[14:]

Cells = Int[np.ndarray, "cell 3"]  # fastest by coordinate in memory


class Box(NamedTuple):
    """A box of cells that are numbered through."""

    low: Int[np.ndarray, "3 1"]
    span: tuple[int, int, int]
    steps: Int[np.ndarray, "3"]  # from a cell's number to that of the next one along each axis

    @classmethod
    def around(cls, cells: Cells, margin: int) -> "Box":
        """The box of some cells, enlarged by a number of cells on every side."""
        by_axis = cells.T
        low, high = by_axis.min(1), by_axis.max(1)
        x, y, z = (high - low + (2 * margin + 1)).tolist()
        return cls((low - margin)[:, None], (x, y, z), np.array([y * z, z, 1]))

    @property
    def size(self) -> int:
        return self.span[0] * self.span[1] * self.span[2]

    def numbers(self, cells: Cells) -> Int[np.ndarray, " cell"]:
        return self._numbers(cells.T - self.low)

    def inner_numbers(self, cells: Cells) -> Int[np.ndarray, " cell"]:
        """The numbers of the cells, of those outside that of the nearest one which is not at the box's sides."""
        place = np.maximum(cells.T - self.low, 1)
        return self._numbers(np.minimum(place, np.array(self.span, place.dtype)[:, None] - 2, out=place))

    def _numbers(self, place: Int[np.ndarray, "3 cell"]) -> Int[np.ndarray, " cell"]:
        x, y, z = place if self.size < 2**31 else place.astype(np.int64)
        return (x * self.span[1] + y) * self.span[2] + z


def cells_of(points: Float32[np.ndarray, "point 3"], size: float) -> Int[np.ndarray, "point 3"]:
    """Which cell of a grid each point is in; cells are `size` metres wide."""
    # by coordinate in memory: several times as fast to go through
    place = np.divide(points.T, np.float32(size), order="C")
    return np.floor(place, out=place).astype(np.int32).T


def numbered(
    keys: Int[np.ndarray, " entry"], size: int | None = None
) -> tuple[Int[np.ndarray, " unique"], Int[np.ndarray, " entry"]]:
    """The keys that occur, in order, and which of them each entry is. Keys are 0 or more, and less than `size`."""
    size = int(keys.max(initial=-1)) + 1 if size is None else size
    if size > max(MODERATE, 4 * len(keys)):
        return np.unique(keys, return_inverse=True)
    taken = np.zeros(size, bool)
    taken[keys] = True
    found = np.flatnonzero(taken)
    place = np.empty(size, np.int64)  # of each key among those found
    place[found] = np.arange(len(found))
    return found, place[keys]


def unique_cells(cells: Cells) -> tuple[Int[np.ndarray, "unique 3"], Int[np.ndarray, " cell"]]:
    """The cells that occur, in order, and which of them each entry is."""
    if not len(cells):
        return cells, np.zeros(0, np.int64)
    box = Box.around(cells, 0)
    if box.size > 2**62:
        unique, inverse = np.unique(cells, axis=0, return_inverse=True)
        return unique, inverse.ravel()
    number = box.numbers(cells)
    found, inverse = numbered(number, box.size)
    return (np.stack(np.unravel_index(found, box.span)) + box.low).T, inverse


class Grid:
    """The cells that contain points, numbered once for all queries."""

    def __init__(self, cells: Cells, reach: int = 1):
        self.cells, self.reach = cells, reach  # as far as `near` may be asked for
        if len(cells):
            self.box = Box.around(cells, reach + 2)  # so what is beyond its sides is farther off than that
            self.number = self.box.numbers(cells)

    def near(self, others: Int[np.ndarray, "other 3"], reach: int = 1) -> Bool[np.ndarray, " cell"]:
        """Which cells have another cell within a number of cells along any axis."""
        if not len(self.cells) or not len(others):
            return np.zeros(len(self.cells), bool)
        box, other = self.box, self.box.inner_numbers(others)
        if box.size > LARGE:
            return np.isin(self.number, np.unique(other)[:, None] + self._around(reach))
        taken = np.zeros(box.size, bool)
        taken[other] = True
        if box.size > SMALL:
            marked = np.zeros(box.size, bool)
            marked[(np.flatnonzero(taken)[:, None] + self._around(reach)) % box.size] = True  # as below at the sides
            return marked[self.number]
        taken = spread(taken, box.steps.tolist(), reach)  # cells at the box's sides get some of the other side
        return taken[self.number]

    def _around(self, reach: int) -> Int[np.ndarray, " other"]:
        """What is to be added to a cell's number for all that are so near."""
        along = np.arange(-reach, reach + 1)
        x, y, z = (step * along for step in self.box.steps)
        return np.add.outer(np.add.outer(x, y), z).ravel()

    def labels(self) -> Int[np.ndarray, " cell"]:
        """The thing that each cell belongs to: those that touch hang together."""
        if not len(self.cells):
            return np.zeros(0, np.int32)
        box, inner = self.box, (slice(self.reach + 1, -self.reach - 1),) * 3
        if box.size <= MODERATE:
            taken, label = np.zeros(box.span, bool), np.zeros(box.span, np.int32)
            taken.ravel()[self.number] = True
            ndimage.label(taken[inner], np.ones((3, 3, 3), bool), output=label[inner])
            return label.ravel()[self.number] - 1
        cells, inverse = unique_cells(self.cells)
        number = box.numbers(cells)  # in order
        wanted = number[:, None] + LATER @ box.steps
        place = np.minimum(np.searchsorted(number, wanted), len(number) - 1)
        there = number[place] == wanted
        ends = np.concatenate([[0], np.cumsum(there.sum(1))])
        graph = csr_array((np.ones(ends[-1]), place[there], ends), shape=(len(number),) * 2)
        return connected_components(graph, directed=False)[1][inverse]


def spread(taken: Bool[np.ndarray, " cell"], steps: Sequence[int], reach: int) -> Bool[np.ndarray, " cell"]:
    """Which cells, by number, are taken or within a given number of cells of a taken one, along any axis; `steps` from
    a cell's number to that of the next one along each axis. Cells at the borders also get some of the opposite border.
    """
    for step in steps:
        done = 0
        while done < reach:
            by = step * min(done + 1, reach - done)
            near = taken.copy()
            near[by:] |= taken[:-by]
            near[:-by] |= taken[by:]
            taken, done = near, done + by // step
    return taken


def touching(cells: Cells, others: Int[np.ndarray, "other 3"]) -> Bool[np.ndarray, " cell"]:
    """Which cells are among the others, or next to one of them, across a corner too."""
    return Grid(cells).near(others)


def within(
    points: Float32[np.ndarray, "point 3"], others: Float32[np.ndarray, "other 3"], distance: float
) -> Bool[np.ndarray, " point"]:
    """Which points have one of the others nearer than `distance` metres."""
    if not len(points) or not len(others):
        return np.zeros(len(points), bool)
    near = touching(cells_of(points, distance / 3.47), cells_of(others, distance / 3.47))  # most are settled so
    rest = np.flatnonzero(~near)
    near[rest] = KDTree(others).query(points[rest], distance_upper_bound=distance)[0] < np.inf
    return near


def about_within(
    points: Float32[np.ndarray, "point 3"], others: Float32[np.ndarray, "other 3"], distance: float
) -> Bool[np.ndarray, " point"]:
    """As `within`, by cells a third as wide: up to 1.33 times as far along each axis, in less time."""
    return Grid(cells_of(points, distance / 3), 3).near(cells_of(others, distance / 3), 3)


def components(points: Float32[np.ndarray, "point 3"], link: float) -> Int[np.ndarray, " point"]:
    """Labels of connected things: points in touching cells of half of `link` metres belong together."""
    # the 26 cells around: a distance between half and the whole of `link`
    return Grid(cells_of(points, link / 2)).labels()


class Counted:
    """How often something was seen in each cell of an endless grid."""

    def __init__(self, size: float):
        self.size = size  # of a cell, metres
        self._code = np.zeros(0, np.int64)  # of the cells that were ever seen, in order
        self._times = np.zeros(0)

    def __len__(self) -> int:
        return len(self._code)

    def add(self, cells: Cells, times: float | Float32[np.ndarray, " cell"]) -> None:
        """Adds `times` to the count of each cell that occurs."""
        code, first = np.unique(_codes(cells), return_index=True)
        times = np.broadcast_to(times, len(cells))[first]
        at = np.searchsorted(self._code, code)
        known = at < len(self._code)
        known[known] = self._code[at[known]] == code[known]
        self._times[at[known]] += times[known]
        self._code = np.insert(self._code, at[~known], code[~known])
        self._times = np.insert(self._times, at[~known], times[~known])

    def at(self, points: Float32[np.ndarray, "point 3"]) -> np.ndarray:
        """How often something was seen in the cell of each point."""
        if not len(self):
            return np.zeros(len(points))
        code = _codes(cells_of(points, self.size))
        at = np.minimum(np.searchsorted(self._code, code), len(self) - 1)
        return np.where(self._code[at] == code, self._times[at], 0.0)

    def cells(self, least: float) -> Cells:
        """The cells in which something was seen so often."""
        code = self._code[self._times >= least]
        return np.stack([code >> 42, code >> 21 & MASK, code & MASK], 1) - HALF

    def clear(self) -> None:
        self._code, self._times = self._code[:0], self._times[:0]


HALF, MASK = 1 << 20, (1 << 21) - 1  # three coordinates in one number; beyond a million cells they repeat


def _codes(cells: Cells) -> Int[np.ndarray, " cell"]:
    x, y, z = (cells.T + HALF & MASK).astype(np.int64)
    return x << 42 | y << 21 | z
