"""Rejects objects that never move: dummies, coat stands, walls; and a person in the last frames of a sensor that is
frozen but for its noise. Host side, NumPy; looks ahead."""

from bisect import bisect_left
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from voodoo_jax.detect.body_likelihood import TELLING
from voodoo_jax.detect.stage import Target, WindowStage, shows_lying_person
from voodoo_jax.detect.stillness import Stillness, moves, seen_long
from voodoo_jax.records.observation import BodyObservation

NOTE = (
    "An object of a person's height never moves, not even as a person who stands still: it is not tracked (stage "
    "drop_motionless)."
)
FROZEN = (
    "For the last {:.1f} s the person moves no more, not even as one who stands still: the sensor seems frozen, and "
    "these frames are not tracked (stage drop_motionless)."
)


@dataclass(frozen=True)
class DropMotionless(WindowStage):
    """Removes all points of an object that never moves, or from the frame on from which it moves no more. Numbers were
    chosen by hand: noise alone moves 1.4 % of the directions, so that of 40 directions 10 % or more move once in 1000
    times; people who stand for the first half second of the 18 recordings move in 80 % or more, in the last seconds of
    real ones in 58 % or more."""

    name: ClassVar = "drop_motionless"

    frames: int = 20  # with points, at least, for a decision
    seconds: float = 2.0  # at least: a person may stand still for a moment
    often: float = 0.8  # of these frames: directions with points in so many are tested
    fewest: int = 12  # such directions
    moving: float = 0.1  # of them show motion if a person is there, at least

    def change(self, window: list[BodyObservation], target: Target) -> list[BodyObservation]:
        first = 0 if self.is_thing(window, target.stillness) else self.frozen_from(window)
        if first == len(window) or shows_lying_person(window, target):
            return window  # a lying person was found by a limb that moved
        scene = target.finder.scene
        note = FROZEN.format((window[-1].time_ns - window[first].time_ns) / 1e9) if first else NOTE
        if note not in scene.notes:
            target.finder.scene = replace(scene, notes=(*scene.notes, note))
        return [*window[:first], *(frame.only(np.zeros(0, int)) for frame in window[first:])]

    def frozen_from(self, window: list[BodyObservation]) -> int:
        """The frame from which on the points of one who moved before never move; their number if they do."""
        there = [k for k, frame in enumerate(window) if len(frame.points) >= TELLING]
        if len(there) <= self.frames:
            return len(window)
        long = bisect_left(there, window[there[-1]].time_ns - self.seconds * 1e9, key=lambda k: window[k].time_ns)
        last = there[min(len(there) - self.frames, max(long - 1, 0))]
        still = lambda k: self.is_thing(window[k:], Stillness())  # noqa: E731
        return bisect_left(range(last), True, key=still) if still(last) else len(window)

    def is_thing(self, frames: list[BodyObservation], stillness: Stillness) -> bool:
        """Whether the points never move; False if there are too few to decide."""
        if not seen_long(frames, self.frames, self.seconds):
            return False
        found = moves(stillness.directions(frames), self.often)
        return len(found) >= self.fewest and bool(found.mean() < self.moving)
