"""Removes objects that a person carries or pushes: rucksacks, cartons, walkers. Host side, NumPy; looks ahead.

If they were left in, they would be taken for the trunk or for arms, and other limbs would follow. Two criteria detect
them. Place: a trunk is below its head, so points at the trunk's height, but far to one side and broad, for most of the
time, may not be part of it. Fit: without them, the body explains the remaining points far better than it explained all.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter1d
from scipy.spatial import KDTree

from voodoo_jax.detect.body_likelihood import mostly_lie
from voodoo_jax.detect.disk_buffer import spilled
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.records.notes import remark
from voodoo_jax.records.observation import BodyObservation, assigned
from voodoo_jax.trackers.icp.sequence import Whole
from voodoo_jax.trackers.icp.stage import Stage
from voodoo_jax.trackers.icp.start.hypothesis import BADLY, USUAL
from voodoo_jax.trackers.shared.runner import FEW_POINTS

CARRIED_NOTE = remark("The person carries or pushes something: its points were removed, and the log tracked again.")


@dataclass(frozen=True)
class DropCarried:
    """Tracks the recording again without the points of carried or pushed objects, if far less is then unexplained.
    Lengths are shares of the stature. Numbers were chosen by hand, on one of three draws of such scenes
    (experiments/stress)."""

    name: ClassVar = "drop_carried"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body", "neck", "l_shoulder", "l_knee"})  # people

    among: tuple[Stage, ...]  # stages that segments go through when they are tracked anew
    better: float = 0.5  # times what was unexplained is left without what is carried, at most
    head: float = 0.08  # so far from the top down there is nothing but the head, and hands
    radius: float = 0.06  # level: of a head, which has more points than a hand
    deep: float = 0.03  # the middle of a head lies so far behind what is seen of it
    trunk: tuple[float, float] = (0.48, 0.84)  # heights
    wide: float = 0.13  # level, from the middle of the head: so far a trunk reaches to its sides
    share: float = 0.3  # of the points at the trunk's height that are farther off, at least
    aside: float = 0.09  # level, from the middle of the head to the middle of those points, at least
    mostly: float = 0.6  # of the frames it is so
    smooth: int = 11  # frames over which the direction to those points is averaged
    near: float = 0.115  # in that direction from the middle of the head: all that is farther off is taken out
    stride: float = 0.2  # likewise below the trunk: so far legs reach
    legs: float = 0.42  # height below which they do
    neck: float = 0.88  # height above which nothing is taken out

    def __call__(self, whole: Whole) -> Whole:
        before = unexplained(whole)
        if before <= BADLY * whole.run.settings.start.sure:
            return whole
        left = self.without(whole.run.people, whole.run.scene.floor)
        if left is None:
            return whole
        other = whole.tracked_anew(self.among, spilled(left))
        if unexplained(other) > self.better * before:
            return whole
        return replace(other, notes=(*whole.notes, CARRIED_NOTE))

    def without(self, people: list[BodyObservation], floor: Plane) -> Iterator[BodyObservation] | None:
        """The frames without carried objects; None if there are none."""
        seen = [k for k, f in enumerate(people) if len(f.points) >= 3 * FEW_POINTS]
        tops = np.array([floor.top(people[k].points) for k in seen])
        stature = float(np.percentile(tops, 75)) if seen else 0.0
        if stature <= 0 or mostly_lie(people, floor):
            return None
        beside = [self._beside(*self._from_head(people[k], floor, top, stature)) for k, top in zip(seen, tops)]
        shows = np.array([share > self.share and np.linalg.norm(off) > self.aside for share, off in beside], bool)
        if np.mean(shows) < self.mostly:
            return None
        way = uniform_filter1d(np.array([share * off for share, off in beside]), self.smooth, axis=0, mode="nearest")
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
        return self._dropped(people, floor, stature, dict(zip(seen, zip(tops.tolist(), way))))

    def _dropped(
        self, people: list[BodyObservation], floor: Plane, stature: float, ways: dict[int, tuple[float, np.ndarray]]
    ) -> Iterator[BodyObservation]:
        """The frames without the points far from the head in a given direction; `ways` by frame: height of the top, and
        a horizontal unit vector."""
        for k, frame in enumerate(people):
            if k in ways:
                top, way = ways[k]
                height, off = self._from_head(frame, floor, top, stature)
                reach = np.where(height > self.legs, self.near, self.stride)
                frame = frame.only(~((height < self.neck) & (off @ way > reach)) | assigned(frame))
            yield frame

    def _beside(
        self, height: Float[np.ndarray, " point"], off: Float[np.ndarray, "point 3"]
    ) -> tuple[float, Float[np.ndarray, "3"]]:
        """Which share of the points at the trunk's height is far from below the head, and where their middle is."""
        trunk: Bool[np.ndarray, " point"] = (height > self.trunk[0]) & (height < self.trunk[1])
        far = trunk & (np.linalg.norm(off, axis=1) > self.wide)
        return float(far.sum() / max(trunk.sum(), 1)), off[far].mean(0) if far.any() else np.zeros(3)

    def _from_head(
        self, frame: BodyObservation, floor: Plane, top: float, stature: float
    ) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, "point 3"]]:
        """Height of a frame's points, and how far they are, level, from the middle of the head; in statures."""
        height, level = floor.height(frame.points).astype(float), floor.level(frame.points).astype(float)
        top, reach = min(top, stature), self.radius * stature  # a hand may be higher
        high = level[np.abs(height - top) < self.head * stature]
        densest = high[np.argmax([len(near) for near in KDTree(high).query_ball_point(high, reach)])]
        head = np.median(high[np.linalg.norm(high - densest, axis=1) < reach], 0)
        away = head - floor.level(frame.origins[[np.bincount(frame.sensor).argmax()]])[0]
        head = head + self.deep * stature * away / max(float(np.linalg.norm(away)), 1e-9)
        return height / stature, (level - head) / stature


def unexplained(whole: Whole) -> float:
    """Cost of a recording's poses beyond noise, median of the frames with a cost; square metres.

    A carried object is there in most frames. A mean would also be high where some frames are tracked wrongly, as behind
    another person."""
    segment = whole.segment
    there = np.isfinite(segment.residual) & (segment.explained > 0)
    noise = np.maximum([f.noise for f in whole.run.people], USUAL)
    return float(np.median((segment.cost - noise**2)[there])) if there.any() else 0.0
