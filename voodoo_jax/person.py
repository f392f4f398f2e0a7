"""Tells the body's points apart from floor, walls and furniture. Host side, NumPy; one frame at a time, no look ahead.

Nothing here knows what the body looks like but its height at rest.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from jaxtyping import Bool, Float32
from scipy.spatial import KDTree

from voodoo_jax.clouds import cells_of, components, fair_share, point_spacing, unique_cells, without_strays
from voodoo_jax.person_frame import PersonFrame, assigned, whole
from voodoo_jax.recording import Frame
from voodoo_jax.scene import Scene
from voodoo_jax.settings import PersonSettings

STILL = 0.06  # metres from one frame's points to those of the frame before, of things that do not move
GONE = 0.6  # of its height before: what is lower from one frame to the next is not the body any more
CELL = 0.08  # metres, of the grid in which the background is kept
LONG = 10  # frames: what was seen apart from the body so often is a thing of its own


class PersonFinder:
    """Follows one thing of a body's height through the frames: first the best candidate, then what hangs together with
    where it was. Places where other things were seen several times count as background from then on.

    Points that are assigned already pass all tests; what they touch is the body, of whatever height.
    """

    def __init__(self, scene: Scene, body_height: float, settings: PersonSettings):
        self.scene, self.settings, self.body_height = scene, settings, body_height
        self.last: np.ndarray | None = None  # the body's points in the last frame that had some
        self.others = np.zeros((0, 3), np.float32)  # what was near it in the last frame, and not taken
        self.unseen = 0
        self._spacing: dict[int, float] = {}  # of each sensor
        self._background: dict[tuple[int, int, int], float] = {}  # how often seen
        self._left: Counter[tuple[int, int, int]] = Counter()  # what remained where the body was, since it is gone

    def __call__(self, frame: Frame) -> PersonFrame:
        s = self.settings
        points, floor = frame.points, self.scene.floor
        known = assigned(frame)
        sure = points[known]
        if self.last is not None and len(sure):
            if np.median(KDTree(self.last).query(sure)[0]) > s.move:
                self.last = None  # the body is somewhere else than thought
        keep = (floor.height(points) > s.floor_margin) & ~known
        for wall in self.scene.walls:
            keep &= np.abs(wall.height(points)) > 0.06
        index = np.flatnonzero(keep)
        if self.last is not None:
            # flat distance only: somebody who sits down or jumps is still here
            away = points[index] - np.median(self.last, 0)
            away -= np.outer(away @ floor.normal, floor.normal)
            index = index[np.linalg.norm(away, axis=1) < s.reach * self.body_height / 1.75]
        index = self._without_strays(frame, index[fair_share(frame.sensor[index], 20_000)])
        if len(index):
            index = index[~self._known(points[index])]
        chosen = self._choose(points[index], sure)
        if not len(sure) and self._gone(points[index][chosen]):
            self._left.update(set(map(tuple, cells_of(points[index][chosen], CELL).tolist())))
            chosen[:] = False
        self.others = points[index][~chosen]
        self._learn(self.others, np.concatenate([points[index][chosen], sure]))
        # the points of a limb or two do not tell where the others are
        tells = chosen.sum() >= 30 or self._of_body(frame).sum() >= 30
        index = np.sort(np.concatenate([index[chosen], np.flatnonzero(known)]))
        if tells:
            self.last, self.unseen = points[index], 0
            self._left.clear()
        else:
            self.unseen += 1
            if self.unseen > s.forget:
                self.last = None  # gone: look everywhere again
                self._background.update((cell, LONG) for cell, times in self._left.items() if times > self.unseen / 3)
                self._left.clear()
        return whole(frame).only(index)

    def _without_strays(self, frame: Frame, index: np.ndarray) -> np.ndarray:
        """The indices without those of flying pixels: each sensor's points are compared among themselves."""
        kept = []
        for sensor in np.unique(frame.sensor[index]).tolist():
            mine = index[frame.sensor[index] == sensor]
            points, origin = frame.points[mine], frame.origins[sensor]
            spacing = self._spacing.get(sensor) or (point_spacing(points, origin) if len(points) > 4 else 0.0)
            if len(points) > 100:
                self._spacing[sensor] = spacing
            kept.append(mine[without_strays(points, origin, spacing)])
        return np.sort(np.concatenate([index[:0], *kept]))

    def _of_body(self, frame: Frame) -> Bool[np.ndarray, " point"]:
        """Which points are assigned to the body as a whole, or to one of so many limbs that it makes no difference."""
        if frame.part is None:
            return np.zeros(len(frame.points), bool)
        present = np.unique(frame.part[frame.part >= 0])
        if len(present) >= 4:
            return frame.part >= 0
        return (frame.part >= 0) & np.array([*(name == "body" for name in frame.parts), False])[frame.part]

    def _choose(self, points, sure) -> Bool[np.ndarray, " point"]:
        """Which points belong to the body. `sure`: those that are known to be on it."""
        if len(points) < 30:
            return np.zeros(len(points), bool)
        label = components(points, self.settings.link)
        count = np.bincount(label)
        most = np.zeros(len(count), bool)
        if len(sure):
            touched = KDTree(sure).query(points, distance_upper_bound=self.settings.link)[0] < np.inf
            touched = np.bincount(label, touched) * (count >= 30)
            most[np.argmax(touched)] = touched.any()
        if self.last is None:
            return most[label] if most.any() else label == self._candidate(points, label, count)
        moved = KDTree(self.last).query(points, distance_upper_bound=self.settings.move)[0]
        touching = np.bincount(label, moved < np.inf)
        taken = touching > np.maximum(5, 0.3 * count)
        # what stood apart from the body and stays where it is remains apart, however near: a chair;
        # not what is small: a foot rests while the other one steps; nor the body itself, if it is where it was
        main = int(np.argmax(touching))
        doubtful = taken & (count >= 0.1 * len(self.last))
        doubtful[main] &= np.bincount(label, moved < STILL)[main] < 0.5 * count[main]
        for k in np.flatnonzero(doubtful):
            doubtful[k] = k == main or not self._is_head(points[label == k], points[label == main])
        if len(self.others) and doubtful.any():
            asked = doubtful[label]
            still = KDTree(self.others).query(points[asked], distance_upper_bound=STILL)[0] < np.inf
            taken &= ~doubtful | (np.bincount(label[asked], still, len(count)) < 0.6 * count)
        return (most | taken)[label]

    def _gone(self, taken) -> bool:
        """Whether what is left was never the body: at once less, and far lower. A chair remains."""
        if self.last is None or len(taken) < 30 or len(taken) > 0.8 * len(self.last):
            return False
        top, before = (np.percentile(self.scene.floor.height(p), 98) for p in (taken, self.last))
        return bool(top < GONE * before)

    def _is_head(self, thing, body) -> bool:
        """Whether a thing is right above a body: a head whose neck is hidden or narrow, not a chair."""
        floor = self.scene.floor
        apart = np.median(thing, 0) - np.median(body, 0)
        apart -= (apart @ floor.normal) * floor.normal
        return floor.height(thing).min() > 0.6 * self.body_height and bool(np.linalg.norm(apart) < 0.3)

    def _candidate(self, points, label, count) -> int:
        """Label of the thing that is about as high as the body and not much wider, the largest of several; things of
        another height count less. -1 where there is none."""
        height, body = self.scene.floor.height(points), self.body_height
        best, size = -1, 0.0
        for k in np.flatnonzero(count >= 50):
            mine = label == k
            low, top = np.percentile(height[mine], [0.5, 99.5])
            spread = np.ptp(np.percentile(points[mine], [2, 98], axis=0), axis=0)
            tall = self.settings.min_height * body <= top <= 1.35 * body
            likely = count[k] / (1 + ((top - body) / (0.15 * body)) ** 2)
            if tall and low < 0.5 * top and np.linalg.norm(spread) < 1.5 * body and likely > size:
                best, size = int(k), likely
        return best

    def _known(self, points) -> Bool[np.ndarray, " point"]:
        """Whether points lie where something else than the body was seen before."""
        if not self._background:
            return np.zeros(len(points), bool)
        unique, inverse = unique_cells(cells_of(points, CELL))
        known = np.array([self._background.get(tuple(c), 0) >= 3 for c in unique.tolist()])
        return known[inverse]

    def apart(self) -> Callable[[Float32[np.ndarray, "point 3"]], Bool[np.ndarray, " point"]]:
        """Says of points whether they lie where something was seen apart from the body for some time, up to now."""
        cells = [cell for cell, times in self._background.items() if times >= LONG]
        tree = KDTree((np.array(cells).reshape(-1, 3) + 0.5) * CELL)
        return lambda points: tree.query(points, distance_upper_bound=1.2 * CELL)[0] < np.inf

    def _learn(self, others, mine) -> None:
        if self.last is None and not len(mine):
            # nobody there: the room, or somebody who is not told from it yet, so it takes most of a second
            far, times = np.ones(len(others), bool), 0.15
        elif self.last is None or not len(others) or not len(mine):
            return
        else:
            far, times = KDTree(mine).query(others, distance_upper_bound=0.25)[0] == np.inf, 1.0
        for cell in set(map(tuple, cells_of(others[far], CELL).tolist())):
            self._background[cell] = self._background.get(cell, 0.0) + times


def person_frames(frames: Iterable[Frame], finder: PersonFinder) -> Iterator[PersonFrame]:
    """The body's points frame by frame; empty frames where nothing was found."""
    return (finder(frame) for frame in frames)
