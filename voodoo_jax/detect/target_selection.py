"""Which of several things that might be the body is it: the one that moves. Host side, NumPy.

A wardrobe looks like a body to a sensor, and is there before it. Until what is followed has moved, what else might be
the body is followed, too.
"""

from collections.abc import Callable, Iterable, Iterator
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32, Int

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import Build
from voodoo_jax.detect.drop_motionless import DropMotionless
from voodoo_jax.detect.lying import extent
from voodoo_jax.detect.raise_floor import with_beds
from voodoo_jax.detect.segmentation import BodySegmenter, Cleared, near_taken
from voodoo_jax.detect.stillness import Stillness, breathes, seen_long
from voodoo_jax.detect.visibility import Nearest
from voodoo_jax.geometry.point_cloud import fair_share
from voodoo_jax.geometry.voxels import Cells, cells_of, touching
from voodoo_jax.records.observation import BodyObservation, assigned, whole
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene

CELL = 0.05  # metres: what is in the next cell but one has moved
MOVED = 0.03  # of a thing's points that are where it was not, and of its places where it is no more: it has moved
SHAKEN = 0.4  # the same where sensors shake: they may turn as floor and walls do not tell
EVERY = 2  # frames: so often it is asked
AWAY, EMPTY = 0.4, 0.2  # metres from where it was, its middle, and so much of that empty: it has moved in any case
SLID = 0.7  # metres from where it was, its middle, though low and long, as dogs and carts go; by hand
LEFT = 3.0  # times as much of it may be in new places as is no longer in old ones: arms hang before the trunk
FLICKER = 2.0  # times as much must have moved since the first frame than since the last one: noise comes and goes
ENOUGH = 15  # frames in which it is elsewhere: a thing that moves by itself
LITTLE = 4  # frames in which what moves at all is elsewhere, at the end of waiting
FAIR = 6  # times as long another thing must have moved than the likeliest one
LOOK = 10  # frames after which other things are looked for
MOST = 4  # of them
LIKELY = 0.2  # of what is likeliest: what is less likely to be the body than that is not followed
HELD = 300  # frames of points that wait until it is known which thing is the body
PATIENCE = 60  # frames: who may not wait does not take another thing for the body before
LOW = 0.5  # of its height: so low the body may be after all if it moves, where nothing else is like it
WENT = 0.05  # metres from where it was: a sensor that sees other sides of things
MANY = 20_000  # points of a frame by which it is asked what hides what
NONE = np.zeros(0, int)
ASKS = DropMotionless()  # whether something moves


@dataclass(frozen=True)
class Sight:
    """How a thing was seen in a frame."""

    points: Float32[np.ndarray, "point 3"]
    sensor: Int[np.ndarray, " point"]
    cells: Cells
    place: Float32[np.ndarray, "3"]  # its middle
    around: Nearest  # what else was seen
    whole: BodyObservation  # all that was seen, or a fair share

    @classmethod
    def of(cls, seen: BodyObservation, frame: Frame | BodyObservation) -> "Sight":
        """Of the thing with the points that were `seen` in a frame."""
        cells = cells_of(seen.points, CELL)
        some = whole(frame).only(fair_share(frame.sensor, MANY))
        others = some.only(~touching(cells_of(some.points, CELL), cells))
        around = Nearest.of(others.points, others.sensor, others.origins)
        return cls(seen.points, seen.sensor, cells, np.median(seen.points, 0), around, some)

    @cached_property
    def everything(self) -> Nearest:
        """The nearest of all that was seen."""
        return Nearest.of(self.whole.points, self.whole.sensor, self.whole.origins)

    def gone_from(self, before: "Sight") -> float:
        """The share of where it was before in which it is no longer; what something else hides now does not count, nor,
        for a sensor that goes round a thing, what it does not see through."""
        gone = ~touching(before.cells, self.cells)
        points, sensor = before.points[gone], before.sensor[gone]
        here, there = self.whole.origins, before.whole.origins
        if np.linalg.norm(here - there, axis=1).max() > WENT:
            gone[gone] = self.everything.empty(points, sensor)
        else:
            gone[gone] = ~self.around.hides(points, sensor)
        return float(np.mean(gone))

    def newly_in(self, before: "Sight") -> float:
        """The share of it that is where its sensor saw through before."""
        new = ~touching(self.cells, before.cells)
        new[new] = before.everything.empty(self.points[new], self.sensor[new])
        return float(np.mean(new))

    def elsewhere(self, before: "Sight") -> float:
        """How much of it is where it was not before; nothing unless it is no longer in some place where it was."""
        return min(before.gone_from(self), LEFT * self.gone_from(before))


class Follower:
    """One thing that might be the body, and what was seen of it since the last release."""

    alone = False  # whether it is known that no other thing touches it now

    def __init__(self, finder: BodySegmenter, before: Iterable[BodyObservation] = ()):
        self.finder = finder
        self.frames = [frame.only(NONE) for frame in before]  # in which nobody knew of it
        self.moved = self.there = 0  # frames since it was found: in which it was elsewhere, and all
        self.earlier = 0  # of the thing that was followed before: frames in which it was elsewhere
        self.went = 0  # of these: its middle was far from where it was
        self.slid = 0  # likewise, low and long: no one lies so
        self.stirred = 0  # frames in which it was where nothing was before, if it left no place for that
        self._sights: tuple[Sight, Sight] | None = None  # how it was seen at first, and last

    def __call__(self, frame: Frame | Cleared) -> BodyObservation:
        seen = self.see(frame)
        self.frames.append(seen)
        return seen

    def see(self, frame: Frame | Cleared, mine: Bool[np.ndarray, " point"] | None = None) -> BodyObservation:
        """What is seen of it in a frame, among the points that are not another one's (`mine`, None: all)."""
        anew = self.finder.last is None
        seen = self.finder(frame) if mine is None else self.finder(frame, mine=mine)
        self.note(seen, frame.frame if isinstance(frame, Cleared) else frame, anew)
        return seen

    def note(self, seen: BodyObservation, frame: Frame | BodyObservation, anew: bool = False) -> None:
        """Looks whether it has moved, by what was seen of it in a frame; `anew`: in which it was found."""
        if len(seen.points) >= 30:
            if anew:
                self.earlier, self.moved, self.there, self._sights = self.moved, 0, 0, None
            if self.there % EVERY == 0:
                self._compare(Sight.of(seen, frame))
            self.there += 1

    def forked(self) -> "Follower":
        """One that goes on from here by itself."""
        other = copy(self)
        other.finder, other.frames = self.finder.forked(), []
        return other

    def _compare(self, now: Sight) -> None:
        """With how it was seen when it was found, and when it was compared before."""
        first, last = self._sights or (now, now)
        # of what is known of more and more of it the middle moves, too
        away = np.linalg.norm(now.place - first.place) > AWAY and now.gone_from(first) > EMPTY
        shaken = now.whole.T_fixed_steady is not None
        changed = now.elsewhere(first) - (SHAKEN if shaken else MOVED)
        new = now.newly_in(first) if self.alone else 0.0
        if new > (SHAKEN if shaken else MOVED) and new > FLICKER * now.newly_in(last):
            self.stirred += EVERY
        if self.finder.lies and np.linalg.norm(now.place - first.place) > SLID:
            self.slid += EVERY * extent(now.points, self.finder.scene.floor).lies
        if changed > 0 and (away or changed > FLICKER * now.elsewhere(last)):
            self.moved += EVERY
            self.went += EVERY * bool(away)
        self._sights = first, now

    @property
    def moves(self) -> bool:
        return self.moved >= ENOUGH


def same(one: Follower, other: Follower) -> bool:
    """Whether two are at the same thing by now."""
    if one.finder.last is None or other.finder.last is None:
        return False
    mine, theirs = one.finder.last, other.finder.last
    if (mine.min(0) > theirs.max(0) + 2 * CELL).any() or (theirs.min(0) > mine.max(0) + 2 * CELL).any():
        return False  # far apart, as most are
    cells = cells_of(mine, CELL), cells_of(theirs, CELL)
    return bool(touching(*cells).mean() > 0.5)


class Chooser:
    """The body's points frame by frame, of the thing that turns out to be the body.

    `ahead`: frames wait until that is known (HELD of them at most); else each is given at once, by what is
    likeliest then.
    """

    def __init__(self, scene: Scene, body: Build, settings: DetectSettings, ahead: bool = True):
        self.settings, self.ahead, self.stillness = settings, ahead, Stillness()
        self._main = Follower(BodySegmenter(scene, body, settings))
        self._others: list[Follower] = []
        self._known = False
        self._seen = 0  # frames
        self._given: Follower | None = None  # what was last given as the body
        # says what is seen of the body where others follow it, too; else None
        self.beside: Callable[[Frame], BodyObservation | None] = lambda frame: None

    @property
    def main(self) -> Follower:
        """What is taken for the body by now."""
        return self._main

    @property
    def finder(self) -> BodySegmenter:
        """That of what is taken for the body by now."""
        return self._main.finder

    def near_only(self, time_ns: int) -> Float32[np.ndarray, "point 3"] | None:
        """As that of the segmenter; None too for as long as other things are compared with the body."""
        return self.finder.near_only(time_ns) if self._known else None

    def __call__(self, frames: Iterable[Frame]) -> Iterator[BodyObservation]:
        for frame in frames:
            if self._known:
                # nothing else is compared with it any more; of several sensors one may have few points
                self.finder.thins = len(frame.origins) == 1
                seen = self.beside(frame)
                yield self.finder(frame) if seen is None else seen
                continue
            self._follow(frame)
            full = len(self._main.frames) >= HELD
            self._decide(assigned=bool(assigned(frame).any()), full=full)
            if self._known or full or not self.ahead:
                yield from self._release()
        self._decide(full=True)
        yield from self._release()

    def _follow(self, frame: Frame) -> None:
        looks = self._seen % LOOK == 0 and len(self._others) < MOST
        clear: Frame | Cleared = frame
        if self._others or looks or self.finder.last is None:
            finders = [self.finder, *(other.finder for other in self._others)]
            wholly = looks or any(f.last is None or f.surveys(frame.time_ns) for f in finders)
            clear = self.finder.cleared(frame, boxes=None if wholly else [f.around(frame.time_ns) for f in finders])
        self._main(clear)
        for other in self._others:
            other(clear)
        main = self._main  # what it has just found may be followed already
        known = (f for f in self._others if main.there == 1 < f.there and f.moved >= main.earlier and same(f, main))
        self._main = next(known, main)
        kept = [self._main]
        for other in self._others:
            # who passes a cupboard may be mixed up with it
            if other is self._main:
                continue
            if other.moves or (other.finder.last is not None and not any(same(other, one) for one in kept)):
                kept.append(other)
        self._others = kept[1:]
        if looks and len(self._others) < MOST:
            self._look(frame, clear)
        self._seen += 1

    def _look(self, frame: Frame, clear: Frame | Cleared) -> None:
        """Begins to follow another thing, if there is one: a small one only where there is no other."""
        s = self.settings
        taken = [f.finder.last for f in (self._main, *self._others) if f.finder.last is not None]
        if self.finder.last is None:
            s = replace(s, min_height=min(s.min_height, LOW))
        finder = self.finder.another(s)
        seen = finder(clear, taken)
        if len(seen.points) < 30 or finder.likely < LIKELY * self.finder.likely:
            finder, seen = self._lying(frame, clear, taken)
        if len(seen.points) >= 30:
            other = Follower(finder, self._main.frames[:-1])
            rest = whole(frame)
            if taken:
                rest = rest.only(~near_taken(rest.points, taken))
            other.note(seen, rest, anew=True)
            other.frames.append(seen)
            self._others.append(other)

    def _lying(
        self, frame: Frame, clear: Frame | Cleared, taken: list[np.ndarray]
    ) -> tuple[BodySegmenter, BodyObservation]:
        """Who may lie on the floor or on a bed; without points where there is nobody, or one is followed already."""
        nobody = self.finder, whole(frame).only(NONE)
        if any(other.finder.lies for other in self._others):
            return nobody
        found = ((finder, finder(clear, taken)) for finder in map(self._lies_on, with_beds(frame, self.finder.scene)))
        return next((one for one in found if len(one[1].points) >= 30), nobody)

    def _lies_on(self, scene: Scene) -> BodySegmenter:
        return self.finder.lying(self.settings, scene)

    def _asleep(self) -> Follower | None:
        """Who lies and moves no more than by breathing, while nothing else does; None if nobody does."""
        main, lying = self._main, [f for f in self._others if f.finder.lies and f.slid < LITTLE]
        if main.moved or (main.there and not ASKS.is_thing(main.frames, Stillness())):
            return None
        asked = (f for f in lying if seen_long(f.frames, ASKS.frames, ASKS.seconds))
        return next((f for f in asked if breathes(f.frames, ASKS.often)), None)

    def _decide(self, assigned: bool = False, full: bool = False) -> None:
        """Takes the likeliest for the body if it has moved, or another thing that has, and the likeliest has not.

        `assigned`: somebody has said what is the body; `full`: frames can wait no longer."""
        main, ahead = self._main, self.ahead
        others = (other for other in self._others if other.slid < LITTLE)
        best = max(others, key=lambda other: other.moved, default=None)
        if assigned or main.moves and (best is None or FAIR * main.moved >= best.moved):
            self._known = True
        elif best is not None and best.moved > FAIR * main.moved:
            if ahead and full and best.moved >= LITTLE:
                self._main, self._known = best, True
            elif not ahead and best.moved >= PATIENCE // 2 and (main.there >= PATIENCE or not main.there):
                self._main, self._known = best, True
        if full and ahead and not self._known and (asleep := self._asleep()) is not None:
            self._main, self._known = asleep, True

    def _release(self) -> Iterator[BodyObservation]:
        """The frames that waited, of what is the body as far as one knows."""
        frames, self._main.frames = self._main.frames, []
        for other in self._others:
            other.frames = []
        if self._known:
            self._others = []
        if frames and self._given not in (None, self._main):
            frames[0] = replace(frames[0], other=True)
        self._given = self._main
        yield from frames
