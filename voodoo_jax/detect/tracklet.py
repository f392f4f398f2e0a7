"""A tracklet: one object that may be a body, followed from its appearance until it leaves. Host side, NumPy.

People who were hidden or away for a while are re-identified by height and place.
"""

from collections import deque

import numpy as np
from jaxtyping import Float32

from voodoo_jax.detect.body_likelihood import TELLING
from voodoo_jax.detect.disk_buffer import Spill
from voodoo_jax.detect.motion import Motion
from voodoo_jax.detect.segmentation import SOME, SPEED, STILL, BodySegmenter
from voodoo_jax.detect.visibility import Nearest
from voodoo_jax.geometry.point_cloud import picked, quantile
from voodoo_jax.geometry.voxels import cells_of, touching
from voodoo_jax.records.observation import BodyObservation

LIKE = 0.07  # metres of height by which two sights of one person may differ; by hand
# frames that wait until it is known which thing is the body, and last ones in which swaying is tested; by hand
HELD = 300
HIDDEN = 0.02  # share of hidden points from which a person counts as partly hidden; by hand
BLIND = 1.5  # seconds for which a hidden person is assumed to walk on; by hand
WAY = 0.4  # seconds over which walking speed is measured; by hand


class Tracklet:
    """An object of a body's shape, from its appearance until it left or was hidden for long.

    **Arguments:** `first` number of the first frame; `before` the tracklet that the same finder followed until it was
    lost.
    """

    def __init__(self, finder: BodySegmenter, first: int, before: "Tracklet | None" = None):
        self.finder, self.first, self.before = finder, first, before
        self.motion, self.frames, self._kept = Motion(), Spill(), 0
        self.since = self.last = -1  # frames in which it was seen for the first and the last time
        self.born_ns = 0
        self.now: BodyObservation | None = None  # what was seen of it in the last frame
        self._tops: list[float] = []  # heights above the floor, of each frame in which it was seen
        self.places: list[np.ndarray] = []  # of the first and last of these: where it was
        self._way: deque[tuple[float, np.ndarray]] = deque()  # time in seconds, and place, while nothing hid it

    @property
    def seen(self) -> int:
        """Number of frames in which it was."""
        return len(self._tops)

    @property
    def is_person(self) -> bool:
        return self.motion.is_persons

    @property
    def height(self) -> float:
        """Height of a person who is upright most of the time, metres."""
        return float(np.percentile(self._tops, 80)) if self._tops else np.nan

    def sways(self) -> bool:
        """Whether it sways as a person who stands still."""
        return self.is_person or self.motion.sways(self.frames.frames()[-HELD:])

    def add(self, frame: BodyObservation, number: int) -> None:
        """Adds its points in the next frame."""
        self.frames.append(frame)
        self.now, self._kept = frame, self._kept + 1
        if len(frame.points) < TELLING:
            return
        floor = self.finder.scene.floor
        if not self._tops:
            self.since, self.born_ns = number, frame.time_ns
        self.last = number
        self._tops.append(floor.top(frame.points))
        place = quantile(floor.level(frame.points), 0.5)
        self.places = [*self.places[:1], place]
        if not self.finder.hidden:
            self._way.append((frame.time_ns / 1e9, place))
            while self._way[-1][0] - self._way[0][0] > WAY:
                self._way.popleft()

    def forget(self) -> None:
        """Deletes frames that are no longer needed, once there are many."""
        if self._kept > 2 * HELD:
            frames, self.frames, self.before = self.frames.frames()[-HELD:], Spill(), None
            self.first, self._kept = self.first + self._kept - HELD, HELD
            for frame in frames:
                self.frames.append(frame)

    def keep_hidden(self, before: Float32[np.ndarray, "point 3"] | None, others: Nearest, seconds: float) -> None:
        """Keeps its hidden places, to assign them when they reappear: places where it was seen `before`, that many
        seconds ago, which no sensor sees now."""
        finder = self.finder
        finder.hidden = False
        if before is None or finder.last is None:
            return
        some = before[:: len(before) // SOME + 1]
        hidden = np.ones(len(some), bool)
        for sensor in range(len(others.origins)):
            hidden &= others.hides(some, np.full(len(some), sensor))
        finder.hidden = bool(hidden.mean() > HIDDEN)
        if finder.hidden:
            # a walking person also walks on behind another one
            there = picked(some, hidden.nonzero()[0]) + self._velocity() * np.float32(seconds)
            if not finder.unseen:
                apart = ~touching(cells_of(there, STILL), cells_of(finder.last, STILL))
                finder.last = np.concatenate([finder.last, picked(there, apart.nonzero()[0])])
            elif finder.unseen * seconds < BLIND:
                finder.last = np.concatenate([there, picked(some, (~hidden).nonzero()[0])])

    def _velocity(self) -> Float32[np.ndarray, "3"]:
        """Horizontal velocity when it was last wholly visible, metres per second."""
        if not self._way:
            return np.zeros(3, np.float32)
        (began, first), (ended, last) = self._way[0], self._way[-1]
        speed = (last - first) / max(ended - began, 1e-3)
        walks = np.linalg.norm(speed) < SPEED and ended - began > 0.5 * WAY
        return (speed if walks else 0 * speed).astype(np.float32)


def some_of(points: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, "some 3"]:
    """About SOME of the points, evenly spread."""
    return points[:: max(1, len(points) // SOME)]


def linked(found: list[Tracklet], frames: list[BodyObservation]) -> list[list[Tracklet]]:
    """Tracklets grouped by person, each group in order of time: people who were away or hidden are re-identified by
    height, and by the places that they can have reached meanwhile."""
    groups: list[list[Tracklet]] = []
    for tracklet in sorted(found, key=lambda t: t.since):
        costs = [_unlike(group[-1], tracklet, frames) for group in groups]
        best = int(np.argmin(costs)) if costs else -1
        if best >= 0 and costs[best] < 1:
            groups[best].append(tracklet)
        else:
            groups.append([tracklet])
    return groups


def _unlike(before: Tracklet, after: Tracklet, frames: list[BodyObservation]) -> float:
    """Dissimilarity of the last and the first sight of two tracklets: below 1 they may be the same person."""
    if before.last >= after.since:
        return np.inf
    seconds = (frames[after.since].time_ns - frames[before.last].time_ns) / 1e9
    away = np.linalg.norm(after.places[0] - before.places[-1]) / (before.finder.settings.reach + SPEED * seconds)
    return float(max(away, abs(after.height - before.height) / LIKE))
