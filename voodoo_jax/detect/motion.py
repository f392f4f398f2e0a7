"""Decides whether an object moves unlike furniture, by its points in earlier frames. Host side, NumPy.

An object that comes out from behind another has not moved; one that fills space that was seen as empty has.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float32, Int

from voodoo_jax.detect.body_likelihood import TELLING, extent
from voodoo_jax.detect.drop_motionless import DropMotionless
from voodoo_jax.detect.stillness import NOISE, directions, filled, seen_long
from voodoo_jax.detect.visibility import Nearest
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.point_cloud import fair_share
from voodoo_jax.geometry.voxels import Cells, cells_of, touching
from voodoo_jax.records.observation import BodyObservation, whole
from voodoo_jax.records.recording import Frame

CELL = 0.05  # metres: a point two cells away has moved
MOVED = 0.03  # of a thing's points that are where it was not, and of its places where it is no more: it has moved
SHAKEN = 0.4  # the same for shaking sensors: floor and walls do not determine all rotations
EVERY = 2  # frames between tests
AWAY, EMPTY = 0.4, 0.2  # metres from where it was, its middle, and so much of that empty: it has moved in any case
SLID = 0.7  # metres from where it was, its middle, though low and long, as dogs and carts go; by hand
LEFT = 3.0  # times as much of it may be in new places as is no longer in old ones: arms hang before the trunk
FLICKER = 2.0  # times as much must have moved since the first frame than since the last one: noise comes and goes
ENOUGH = 15  # frames in which it is elsewhere: a thing that moves by itself
LITTLE = 4  # frames in which an object that moves at all is elsewhere, at the end of waiting
# frames: an object seen in fewer is not a person; with about an arm at an empty place in so many, it is one; by hand
BRIEF = 10
ASKS = DropMotionless()  # which directions are tested for motion, and when
# of these: of standing people 80 % move or more, of a cupboard behind a moving person a third (measured)
SWAYING = 0.6
WENT = 0.05  # metres from where it was: a sensor that sees other sides of things
MANY = 20_000  # points of a frame that decide occlusion


@dataclass(frozen=True)
class Sight:
    """Points of an object in a frame."""

    points: Float32[np.ndarray, "point 3"]
    sensor: Int[np.ndarray, " point"]
    cells: Cells
    place: Float32[np.ndarray, "3"]  # its middle
    around: Nearest  # what else was seen
    whole: BodyObservation  # all that was seen, or a fair share

    @classmethod
    def of(cls, seen: BodyObservation, frame: Frame | BodyObservation) -> "Sight":
        """Sight of the object with the points `seen` in a frame."""
        cells = cells_of(seen.points, CELL)
        some = whole(frame).only(fair_share(frame.sensor, MANY))
        others = some.only(~touching(cells_of(some.points, CELL), cells))
        around = Nearest.of(others.points, others.sensor, others.origins)
        return cls(seen.points, seen.sensor, cells, np.median(seen.points, 0), around, some)

    @cached_property
    def everything(self) -> Nearest:
        """Nearest distances of all measurements."""
        return Nearest.of(self.whole.points, self.whole.sensor, self.whole.origins)

    def gone_from(self, before: "Sight") -> float:
        """The share of its earlier place that it has left; hidden places do not count, nor, for a sensor that moves
        round it, those that the sensor does not see through."""
        gone = ~touching(before.cells, self.cells)
        points, sensor = before.points[gone], before.sensor[gone]
        here, there = self.whole.origins, before.whole.origins
        if np.linalg.norm(here - there, axis=1).max() > WENT:
            gone[gone] = self.everything.empty(points, sensor)
        else:
            gone[gone] = ~self.around.hides(points, sensor)
        return float(np.mean(gone))

    def newly_in(self, before: "Sight") -> float:
        """The share of it that is at places that its sensor saw as empty before."""
        new = ~touching(self.cells, before.cells)
        new[new] = before.everything.empty(self.points[new], self.sensor[new])
        return float(np.mean(new))

    def elsewhere(self, before: "Sight") -> float:
        """How much of it is at new places; 0 unless it has also left a place."""
        return min(before.gone_from(self), LEFT * self.gone_from(before))


class Motion:
    """Motion of an object since it was found: numbers of frames in which it was seen, and in which it was elsewhere."""

    def __init__(self) -> None:
        self.seen = 0
        self.moved = 0  # it was where it was not at first, and no longer where it was
        self.went = 0  # of these: its middle was far from where it was
        self.slid = 0  # likewise, low and long: no one lies so
        self.stirred = 0  # it was where nothing was before, if it left no place for that
        self.alive = False  # known by what `sways`
        self._sights: tuple[Sight, Sight] | None = None  # how it was seen at first, and last

    def note(self, seen: BodyObservation, frame: Frame | BodyObservation, alone: bool, lying_on: Plane | None) -> None:
        """Adds the points of a frame.

        **Arguments:** `alone`: no other object touches it; `lying_on`: the floor, if it was found as a lying person.
        """
        if len(seen.points) >= TELLING:
            if self.seen % EVERY == 0:
                self._compare(Sight.of(seen, frame), alone, lying_on)
            self.seen += 1

    def _compare(self, now: Sight, alone: bool, lying_on: Plane | None) -> None:
        """Compares with the sights at its first and its last comparison."""
        first, last = self._sights or (now, now)
        # the centre of an object of which more and more becomes visible moves, too
        away = np.linalg.norm(now.place - first.place) > AWAY and now.gone_from(first) > EMPTY
        least = SHAKEN if now.whole.T_fixed_steady is not None else MOVED
        changed, new = now.elsewhere(first) - least, now.newly_in(first) if alone else 0.0
        if new > least and new > FLICKER * now.newly_in(last):
            self.stirred += EVERY
        if lying_on is not None and np.linalg.norm(now.place - first.place) > SLID:
            self.slid += EVERY * extent(now.points, lying_on).lies
        if changed > 0 and (away or changed > FLICKER * now.elsewhere(last)):
            self.moved += EVERY
            self.went += EVERY * bool(away)
        self._sights = first, now

    @property
    def enough(self) -> bool:
        """Whether it has moved enough to be no furniture."""
        return self.moved >= ENOUGH

    @property
    def is_persons(self) -> bool:
        """Whether it is a person by its motion."""
        return (self.alive or self.enough or self.went >= LITTLE or self.stirred >= BRIEF) and self.seen >= BRIEF

    def sways(self, frames: Sequence[BodyObservation]) -> bool:
        """Whether it moves like a person who stands still, by millimetres: then it is a person from now on. `frames`:
        the last ones."""
        if not self.alive and seen_long(frames, ASKS.frames, ASKS.seconds):
            found = directions(frames)
            asked = filled(found) & (found.often >= ASKS.often)
            self.alive = bool(asked.sum() >= ASKS.fewest and np.mean(found.ratio[asked] < NOISE) > SWAYING)
        return self.is_persons
