"""What somebody carries or pushes and no limb can explain: rucksacks, cartons. Host side, NumPy; looks ahead.

Left in, it is taken for the trunk, or for arms, and the rest follows. It is told by two questions. Where is it: a trunk
is below its head, and what is at its height, far to one side and broad for most of the time is none. Is it: without it
the body explains what is left far better than it did everything.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter1d
from scipy.spatial import KDTree

from voodoo_jax.detect.disk_buffer import spilled
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.records.observation import BodyObservation, assigned
from voodoo_jax.records.segment import Segment
from voodoo_jax.trackers.icp.refine.stage import Stage
from voodoo_jax.trackers.icp.sequence import Whole

CARRIED_NOTE = "Something that is carried was told from the body, and all tracked again without it."
FEW = 30  # points of a frame: fewer have no shape; by hand


@dataclass(frozen=True)
class DropCarried:
    """All tracked anew without what is carried, if that leaves much less unexplained. Lengths are shares of the
    stature; numbers were chosen by hand, on one of two draws of the scenes of experiments/stress."""

    name: ClassVar = "drop_carried"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body", "l_knee", "r_knee"})

    among: tuple[Stage, ...]  # stages that segments go through when they are tracked anew
    doubt: float = 0.0006  # square metres of cost beyond noise, mean of all frames: what fits better carries nothing
    head: float = 0.08  # below the top
    radius: float = 0.06  # level: of a head, which has more points than a hand beside it
    deep: float = 0.03  # the middle of a head lies so far behind what is seen of it
    low: float = 0.48  # the trunk, from here ...
    high: float = 0.84  # ... to here
    wide: float = 0.13  # level, from the middle of the head: here are a trunk's sides
    share: float = 0.3  # of the points at that height that are farther off, at least
    aside: float = 0.09  # level, from the middle of the head to the middle of those points, at least
    mostly: float = 0.6  # of the frames it is so
    smooth: int = 11  # frames over which the side is averaged on which they are
    near: float = 0.1  # along that side from the middle of the head: farther away ...
    below: float = 0.42  # ... and from this height ...
    above: float = 0.88  # ... to this all is taken out
    better: float = 0.5  # times what was unexplained, at most, if it was no part of the body

    def __call__(self, whole: Whole) -> Whole:
        before = _unexplained(whole)
        import os
        if os.environ.get('DBG'): print('   doubt', round(before*1e6), end=' ')
        if not before > self.doubt:
            return whole
        left = self.without(whole.run.people, whole.run.scene.floor)
        if left is None:
            return whole
        other = whole.tracked_anew(spilled(left), self.among)
        if os.environ.get('DBG'): print('   after', round(_unexplained(other)*1e6), end=' ')
        return replace(other, notes=(*whole.notes, CARRIED_NOTE)) if _unexplained(other) < self.better * before else whole

    def without(self, people: list[BodyObservation], floor: Plane) -> Iterator[BodyObservation] | None:
        """The frames without what is carried; None if there is nothing."""
        seen = [k for k, f in enumerate(people) if len(f.points) >= FEW]
        if not seen:
            return None
        tops = np.array([floor.top(people[k].points) for k in seen])
        stature = float(np.percentile(tops, 75))
        if stature <= 0:
            return None
        beside = [self._beside(people[k], floor, top, stature) for k, top in zip(seen, tops)]
        shows = [share > self.share and np.linalg.norm(side) > self.aside for share, side in beside]
        if np.mean(shows) < self.mostly:
            return None
        sides = uniform_filter1d(np.array([share * side for share, side in beside]), self.smooth, 0, mode="nearest")
        sides /= np.maximum(np.linalg.norm(sides, axis=1, keepdims=True), 1e-9)
        side = dict(zip(seen, zip(tops, sides)))
        return (
            f.only(~self._on(f, floor, *side[k], stature) | assigned(f)) if k in side else f
            for k, f in enumerate(people)
        )

    def _beside(self, frame, floor: Plane, top: float, stature: float) -> tuple[float, Float[np.ndarray, "3"]]:
        """Which share of the points at the trunk's height is far from below the head, and where their middle is, from
        there, in statures."""
        height, off = self._from_head(frame, floor, top, stature)
        trunk = (height > self.low) & (height < self.high)
        far = trunk & (np.linalg.norm(off, axis=1) > self.wide)
        return float(far.sum() / max(trunk.sum(), 1)), off[far].mean(0) if far.any() else np.zeros(3)

    def _on(self, frame, floor: Plane, top: float, side: np.ndarray, stature: float) -> Bool[np.ndarray, " point"]:
        height, off = self._from_head(frame, floor, top, stature)
        return (height > self.below) & (height < self.above) & (off @ side > self.near)

    def _from_head(
        self, frame: BodyObservation, floor: Plane, top: float, stature: float
    ) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, "point 3"]]:
        """Height of a frame's points, and how far they are, level, from the middle of the head; in statures."""
        height = floor.height(frame.points).astype(float)
        level = floor.level(frame.points).astype(float)
        top = min(top, stature)  # a hand may be higher
        high = level[(height > top - self.head * stature) & (height < top + self.head * stature / 2)]
        head = high[np.argmax([len(near) for near in KDTree(high).query_ball_point(high, self.radius * stature)])]
        head = np.median(high[np.linalg.norm(high - head, axis=1) < self.radius * stature], 0)
        away = head - floor.level(frame.origins[[np.bincount(frame.sensor).argmax()]])[0]
        head = head + self.deep * stature * away / max(float(np.linalg.norm(away)), 1e-9)
        return height / stature, (level - head) / stature


def _unexplained(whole: Whole) -> float:
    """What poses cost beyond noise, mean of all frames in which there is somebody; square metres."""
    segment: Segment = whole.segment
    there = np.isfinite(segment.residual) & (segment.explained > 0)
    if not there.any():
        return 0.0
    noise = np.array([max(f.noise, 0.018) for f in whole.run.people])
    return float(np.mean((segment.cost - noise**2)[there]))
