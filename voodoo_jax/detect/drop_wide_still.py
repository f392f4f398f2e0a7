"""Removes tables, desks and counters in front of a person: objects that never move and are wider than a person. Host
side, NumPy; looks ahead.

Their tops are seen at a flat angle, in rows too far apart to detect a face (drop_planar_furniture). The body would be
fitted to them, so that no point would stay unexplained (drop_unexplained).
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.spatial import KDTree

from voodoo_jax.detect.stage import Target, WindowStage, shows_lying_person
from voodoo_jax.detect.stillness import NOISE, Directions, Stillness, moves, seen_long
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.voxels import components
from voodoo_jax.records.observation import BodyObservation

STRAYS = 5  # percent of a top's points at each of its ends that may be of something else; by hand


class Top(NamedTuple):
    """A level top, as a rectangle."""

    height: float  # metres above the floor
    middle: Float[np.ndarray, "3"]  # on the floor
    axes: Float[np.ndarray, "2 3"]  # unit vectors along its sides
    low: Float[np.ndarray, "2"]  # metres from the middle along them
    high: Float[np.ndarray, "2"]


@dataclass(frozen=True)
class DropWideStill(WindowStage):
    """Removes objects that never move while a person does, with a straight front or a level top wider than a person. It
    keeps the legs of a sitting person, which are in front of the seat. Numbers were chosen by hand."""

    name: ClassVar = "drop_wide_still"

    frames: int = 15  # with points, at least, for a decision
    seconds: float = 1.0  # and so long
    often: float = 0.4  # of these frames: directions with points in so many are tested
    moving: float = 0.1  # of the directions show motion if a person is there, at least
    wide: float = 0.9  # metres, horizontal: shoulders are half as wide, and people who spread their arms move them
    link: float = 0.35  # metres between directions that hang together: rows of a table's top are so far apart
    deep: float = 0.2  # metres, level, of a table's top, at least
    slab: float = 0.1  # metres: height of the slices that are tested for width
    straight: float = 0.05  # metres from a line of the points on a straight front
    # of tops that were seen beside the body:
    dense: float = 0.07  # of the points seen beside the body are on a top, at least
    bare: float = 0.3  # of its points may be above it, at most: otherwise it is a slice of something high
    lowest: float = 0.55  # metres: of a table's top; seats are lower
    highest: float = 1.3  # metres: of a counter's top
    thick: float = 0.03  # metres from its height of the points on it
    margin: float = 0.15  # metres beyond its outline: its edges are seen in part, and together with others

    def change(self, window: list[BodyObservation], target: Target) -> list[BodyObservation]:
        if shows_lying_person(window, target):
            return window  # who lies is as wide as a table, and may move no more than an arm
        finder = target.finder
        return self.without(window, finder.scene.floor, target.stillness, finder.beside())

    def without(
        self,
        frames: list[BodyObservation],
        floor: Plane,
        stillness: Stillness,
        beside: Float32[np.ndarray, "beside 3"] | None = None,
    ) -> list[BodyObservation]:
        """The frames without such objects; the same frames if there are none.

        **Arguments:** `beside` points that were seen beside the body: of a table in front of a person only the middle
        is among the body's points.
        """
        if not seen_long(frames, self.frames, self.seconds):
            return frames
        found = stillness.directions(frames)
        moving = moves(found, self.often)
        if not len(moving) or moving.mean() < self.moving:
            return frames
        still = np.flatnonzero((found.often >= self.often) & (found.ratio >= NOISE))
        place = found.place[still].astype(np.float32)
        tops = self._tops(place, floor)
        tops += [] if beside is None else self._tops(beside, floor, self.dense)
        drop, spared = np.zeros(len(found.ratio), bool), np.zeros(len(found.ratio), bool)
        drop[still], spared[still] = self._wide(place, _origin(frames), floor)
        for top in tops:
            drop[still[self._on(place, top, floor)]] = True
        if drop.any():
            drop = self._and_beside(found, np.flatnonzero(drop)) & ~(spared & ~drop)
        elif not tops:
            return frames
        out = []
        for f, which in zip(frames, found.which):
            keep = ~drop[which]
            for top in tops:
                keep &= ~self._on(f.points, top, floor)
            out.append(f.only(keep))
        return out

    def _wide(
        self, place: Float32[np.ndarray, "some 3"], origin: Float32[np.ndarray, "3"], floor: Plane
    ) -> Bool[np.ndarray, "2 some"]:
        """Which places belong to a wide object, and which are connected with one but do not belong to it: parts in
        front of it towards the sensor at `origin`, such as the legs of a person on a sofa, and narrow components, such
        as a chair with a person on it."""
        wide, spared = np.zeros((2, len(place)), bool)
        if len(place) < 2:
            return np.stack([wide, spared])
        level, label = floor.level(place), components(place, self.link)
        slab = np.floor(floor.height(place) / self.slab).astype(int)
        for k in np.unique(label):
            if _span(level[label == k]) < self.wide:
                continue
            for height in np.unique(slab[label == k]):
                mine = np.flatnonzero((label == k) & (slab == height))
                of_it = self._behind_front(level[mine], floor.level(origin[None])[0])
                wide[mine[of_it]], spared[mine[~of_it]] = True, True
        return np.stack([wide, spared])

    def _behind_front(
        self, level: Float32[np.ndarray, "some 3"], origin: Float32[np.ndarray, "3"]
    ) -> Bool[np.ndarray, " some"]:
        """Which of some places at one height lie on the straight front of a wide object, or behind it."""
        if len(level) < 3 or _span(level) < self.wide:
            return np.zeros(len(level), bool)
        one, other = np.triu_indices(len(level), 1)
        along = level[other] - level[one]
        far = np.linalg.norm(along, axis=1)
        one, along = one[far > self.wide / 2], (along / np.maximum(far, 1e-9)[:, None])[far > self.wide / 2]

        def off_line(k: int | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Positions of points along a line, or several, and their offsets from it."""
            out = level - level[one[k]][..., None, :]
            at = np.sum(out * along[k][..., None, :], -1)
            return at, out - at[..., None] * along[k][..., None, :]

        # all lines of a large thing at once would take gigabytes
        through = np.split(np.arange(len(one)), np.flatnonzero(np.diff(one)) + 1)
        near = [np.sum(np.linalg.norm(off_line(k)[1], axis=-1) < self.straight, 1) for k in through]
        best = int(np.argmax(np.concatenate(near)))
        at, off = off_line(best)
        distance = np.linalg.norm(off, axis=-1)
        on = np.flatnonzero(distance < self.straight)
        on = on[np.argsort(at[on])]
        runs = np.split(on, np.flatnonzero(np.diff(at[on]) > self.link) + 1)
        low, high = max(((at[run[0]], at[run[-1]]) for run in runs), key=lambda ends: ends[1] - ends[0])
        if high - low < self.wide:
            return np.zeros(len(level), bool)
        towards = origin - level[one[best]]
        towards = towards - (towards @ along[best]) * along[best]
        behind = (distance < self.straight) | (off @ towards < 0)
        return behind & (at >= low) & (at <= high)

    def _and_beside(self, found: Directions, things: Int[np.ndarray, " some"]) -> Bool[np.ndarray, " direction"]:
        """Which directions are of these objects, or right beside them, without motion."""
        near = KDTree(found.place[things]).query(found.place, distance_upper_bound=self.margin)[0] < np.inf
        drop = near & ((found.ratio >= NOISE) | (found.often < self.often))
        drop[things] = True
        return drop

    def _tops(self, place: Float32[np.ndarray, "some 3"], floor: Plane, dense: float = 0.0) -> list[Top]:
        """Level tops among some places, each with at least the share `dense` of them; a person in front may hide its
        middle."""
        height, level = floor.height(place), floor.level(place)
        slab = np.abs(height[:, None] - height) < self.thick
        count, high = slab.sum(1), self.highest if dense else np.inf
        asked = np.flatnonzero((count >= max(3, dense * len(place))) & (height > self.lowest) & (height < high))
        found: list[Top] = []
        tried: list[float] = []
        for k in asked[np.argsort(-count[asked], kind="stable")]:
            if any(abs(height[k] - top.height) < 2 * self.thick for top in found):
                continue
            if any(abs(height[k] - other) < self.thick / 4 for other in tried):
                continue  # what lies at one height is one top, or none
            tried.append(float(height[k]))
            mine = level[slab[k]]
            middle = mine.mean(0)
            axes = np.linalg.svd(mine - middle, full_matrices=False)[2][:2]
            along = (mine - middle) @ axes.T
            strays = STRAYS if dense else 0  # places at rest are means of many points
            low, high = np.percentile(along, (strays, 100 - strays), axis=0)
            level_of = np.percentile(height[slab[k]], 80) if dense else height[k]  # its front is in the slab, too
            top = Top(float(level_of), middle, axes, low - self.margin, high + self.margin)
            bare = not dense or self._over(place, top, floor).sum() <= self.bare * len(mine)
            if bare and np.all(high - low >= (self.wide, self.deep)):
                found.append(top)
        return found

    def _on(self, points: Float32[np.ndarray, "point 3"], top: Top, floor: Plane) -> Bool[np.ndarray, " point"]:
        """Which points lie on a level top, even with motion behind it."""
        return self._within(points, top, floor) & (np.abs(floor.height(points) - top.height) < self.thick)

    def _over(self, points: Float32[np.ndarray, "point 3"], top: Top, floor: Plane) -> Bool[np.ndarray, " point"]:
        """Which points are higher than a level top, above it."""
        return self._within(points, top, floor) & (floor.height(points) - top.height > 2 * self.thick)

    def _within(self, points: Float32[np.ndarray, "point 3"], top: Top, floor: Plane) -> Bool[np.ndarray, " point"]:
        """Which points are above or below a level top, at any height."""
        along = (floor.level(points) - top.middle) @ top.axes.T
        return np.all((along > top.low) & (along < top.high), 1)


def _span(level: Float32[np.ndarray, "some 3"]) -> float:
    """Extent of some places in their longest direction, metres."""
    out = level - level.mean(0)
    return float(np.ptp(out @ np.linalg.svd(out, full_matrices=False)[2][0])) if len(level) > 1 else 0.0


def _origin(frames: list[BodyObservation]) -> Float32[np.ndarray, "3"]:
    """Position of the sensor that sees most points."""
    sensors = len(frames[0].origins)
    count = np.sum([np.bincount(f.sensor, minlength=sensors) for f in frames], 0)
    return frames[0].origins[int(np.argmax(count))]
