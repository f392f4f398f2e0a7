"""Rejects objects that never move: dummies, coat stands, walls. Host side, NumPy; looks ahead."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from voodoo_jax.detect.stage import Target, WindowStage, shows_lying_person
from voodoo_jax.detect.stillness import Stillness, moves, seen_long
from voodoo_jax.records.observation import BodyObservation

NOTE = (
    "An object of a person's height never moves, not even as a person who stands still: it is not tracked (stage "
    "drop_motionless)."
)


@dataclass(frozen=True)
class DropMotionless(WindowStage):
    """Removes all points of an object that never moves. Numbers were chosen by hand:
    noise alone moves 1.4 % of the directions, so that of 40 directions 10 % or more move once in 1000 times; people who
    stand for the first half second of the 18 recordings move in 80 % or more."""

    name: ClassVar = "drop_motionless"

    frames: int = 20  # with points, at least, for a decision
    seconds: float = 2.0  # at least: a person may stand still for a moment
    often: float = 0.8  # of these frames: directions with points in so many are tested
    fewest: int = 12  # such directions
    moving: float = 0.1  # of them show motion if a person is there, at least

    def change(self, window: list[BodyObservation], target: Target) -> list[BodyObservation]:
        if not self.is_thing(window, target.stillness) or shows_lying_person(window, target):
            return window  # a lying person was found by a limb that moved
        scene = target.finder.scene
        if NOTE not in scene.notes:
            target.finder.scene = replace(scene, notes=(*scene.notes, NOTE))
        return [frame.only(np.zeros(0, int)) for frame in window]

    def is_thing(self, frames: list[BodyObservation], stillness: Stillness) -> bool:
        """Whether the points never move; False if there are too few to decide."""
        if not seen_long(frames, self.frames, self.seconds):
            return False
        found = moves(stillness.directions(frames), self.often)
        return len(found) >= self.fewest and bool(found.mean() < self.moving)
