"""Which of several things that might be the body is it: the one that moves. Host side, NumPy.

A wardrobe looks like a body to a sensor, and is there before it. Until what is followed has moved, what else might be
the body is followed, too.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from voodoo_jax.cells import Cells, cells_of, touching
from voodoo_jax.person import PersonFinder
from voodoo_jax.person_frame import PersonFrame, assigned, whole
from voodoo_jax.recording import Frame
from voodoo_jax.scene import Scene
from voodoo_jax.settings import PersonSettings

CELL = 0.08  # metres: what is in the next cell but one has moved
MOVED = 0.03  # of a thing's points that are where it was not, and of its places where it is no more: it has moved
FLICKER = 1.3  # times as much must have moved since the first frame than since the last one: noise comes and goes
ENOUGH = 15  # frames in which it is elsewhere: a thing that moves by itself
FAIR = 3  # times as long another thing must have moved than the likeliest one
LOOK = 5  # frames after which other things are looked for
MOST = 2  # of them
LIKELY = 0.2  # of what is likeliest: what is less likely to be the body than that is not followed
HELD = 300  # frames of points that wait until it is known which thing is the body
PATIENCE = 60  # frames: who may not wait does not take another thing for the body before
BESIDE = 0.12  # metres: what is nearer to something that is followed is not another thing
NONE = np.zeros(0, int)


class Follower:
    """One thing that might be the body, and what was seen of it since the last release."""

    def __init__(self, finder: PersonFinder, before: Iterable[PersonFrame] = ()):
        self.finder = finder
        self.frames = [frame.only(NONE) for frame in before]  # in which nobody knew of it
        self.moved = 0  # frames
        self._first: Cells = np.zeros((0, 3), np.int64)  # where it was at first
        self._last = self._first

    def __call__(self, frame: Frame | PersonFrame) -> PersonFrame:
        anew = self.finder.last is None
        seen = self.finder(frame)
        self.frames.append(seen)
        if len(seen.points) >= 30:
            now = cells_of(seen.points, CELL)
            if anew:
                self.moved, self._first = 0, now
            elif _apart(now, self._first) > MOVED + FLICKER * _apart(now, self._last):
                self.moved += 1
            self._last = now
        return seen

    @property
    def moves(self) -> bool:
        return self.moved >= ENOUGH


def _apart(cells: Cells, others: Cells) -> float:
    """How much of a thing is where it was not, and was where it is not, the smaller share of both."""
    return float(min(np.mean(~touching(cells, others)), np.mean(~touching(others, cells))))


class Chooser:
    """The body's points frame by frame, of the thing that turns out to be the body.

    `settings.ahead`: frames wait until that is known (HELD of them at most); else each is given at once, by what is
    likeliest then.
    """

    def __init__(self, scene: Scene, body_height: float, settings: PersonSettings, body_width: float = 0.0):
        self._finder = lambda: PersonFinder(scene, body_height, settings, body_width)
        self.settings = settings
        self._main = Follower(self._finder())
        self._others: list[Follower] = []
        self._known = False
        self._seen = 0  # frames

    @property
    def finder(self) -> PersonFinder:
        """That of what is taken for the body by now."""
        return self._main.finder

    def __call__(self, frames: Iterable[Frame]) -> Iterator[PersonFrame]:
        for frame in frames:
            if self._known:
                yield self.finder(frame)
                continue
            self._follow(frame)
            full = len(self._main.frames) >= HELD
            self._decide(assigned=bool(assigned(frame).any()), full=full)
            if self._known or full or not self.settings.ahead:
                yield from self._release()
        self._decide(full=True)
        yield from self._release()

    def _follow(self, frame: Frame) -> None:
        self._main(frame)
        for other in self._others:
            other(frame)
        self._others = [o for o in self._others if o.moves or o.finder.last is not None]
        if self._seen % LOOK == 0 and len(self._others) < MOST and self.finder.last is not None:
            self._look(frame)
        self._seen += 1

    def _look(self, frame: Frame) -> None:
        """Begins to follow another thing, if there is one."""
        rest, place = whole(frame), cells_of(frame.points, BESIDE)
        taken = [f.finder.last for f in (self._main, *self._others)]
        taken = np.concatenate([points for points in taken if points is not None])
        rest = rest.only(~touching(place, cells_of(taken, BESIDE)))
        other = Follower(self._finder(), self._main.frames[:-1])
        if len(other(rest).points) >= 30 and other.finder.likely >= LIKELY * self.finder.likely:
            self._others.append(other)

    def _decide(self, assigned: bool = False, full: bool = False) -> None:
        """Takes the likeliest for the body if it has moved, or another thing that has, and the likeliest has not.

        `assigned`: somebody has said what is the body; `full`: frames can wait no longer."""
        best = max(self._others, key=lambda other: other.moved, default=None)
        if assigned or self._main.moves and (best is None or FAIR * self._main.moved >= best.moved):
            self._known = True
        elif best is not None and best.moves and best.moved > FAIR * self._main.moved:
            if full and self.settings.ahead or self._seen >= PATIENCE and best.moved >= PATIENCE // 2:
                self._main, self._known = best, True

    def _release(self) -> Iterator[PersonFrame]:
        """The frames that waited, of what is the body as far as one knows."""
        frames, self._main.frames = self._main.frames, []
        for other in self._others:
            other.frames = []
        if self._known:
            self._others = []
        yield from frames
