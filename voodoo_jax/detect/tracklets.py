"""Tracklets: all objects that may be a body, each followed from its appearance until it leaves. The main one is chosen
once one has moved unlike furniture; at the end it is decided which ones are people. Host side, NumPy.

A wardrobe looks like a body, and may be seen before it. Points near two people are assigned to the nearer one, by their
places in the previous frame. People who were hidden or away for a while are re-identified by height and place.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float32, Int8
from scipy.spatial import KDTree

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import TELLING, Build
from voodoo_jax.detect.clearing import Cleared
from voodoo_jax.detect.motion import LITTLE
from voodoo_jax.detect.raise_floor import with_beds
from voodoo_jax.detect.segmentation import ENOUGH, SOME, STEP, BodySegmenter
from voodoo_jax.detect.stillness import Stillness
from voodoo_jax.detect.tracklet import HELD, Tracklet, linked, some_of
from voodoo_jax.detect.visibility import Nearest
from voodoo_jax.geometry.point_cloud import inside, picked
from voodoo_jax.geometry.voxels import about_within, unique_cells
from voodoo_jax.records.observation import BodyObservation, assigned, whole
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene

FAIR = 6  # times as long another thing must have moved than the likeliest one
LOOK = 10  # frames after which other things are looked for
MOST = 4  # of them
# frames: online, another thing is not taken for the body before; and so often other people are looked for in all that
# is there; by hand
PATIENCE = 60
# of its height: so low the body may be after all if it moves, where nothing else is like it; and so high a bed, for a
# person sits down on it first
LOW = 0.5
IDLE_NS = 20_000_000_000  # who has not moved for so long is furniture for the time being; by hand
LIKELY = 0.06  # of what is likeliest to be a body: a child of 1.1 m is so much less so than an adult; by hand
ALL = 6  # things that are followed at once, at most; by hand
NONE = np.zeros(0, int)


@dataclass(frozen=True)
class Observed:
    """A person in a recording: the points in each frame, and the scene."""

    finder: BodySegmenter
    settings: DetectSettings
    frames: list[BodyObservation]
    stillness: Stillness = field(default_factory=Stillness)


class Tracklets:
    """Follows all objects that may be a body, and yields the main one's points frame by frame.

    `ahead`: frames wait (at most HELD of them) until the main one is known; otherwise each is yielded at once, with the
    points of the likeliest. `several`: others are searched for and followed after that, too. `keeps`: `people` will be
    called.
    """

    # 6 parameters: what is looked for, and how
    def __init__(
        self, scene: Scene, body: Build, settings: DetectSettings, ahead: bool = True, several: bool = False,
        keeps: bool = True,
    ):  # fmt: skip
        self.settings, self.ahead, self.several, self.keeps = settings, ahead, several, keeps
        self.stillness = Stillness()
        self.main = Tracklet(BodySegmenter(scene, body, settings), 0)  # what is taken for the main one by now
        self.followed, self._ended = [self.main], list[Tracklet]()
        self.known = False  # which one is the main one
        self._number = self._last_ns = 0  # of the frame
        self._waiting: list[BodyObservation] = []  # frames that were not given yet, without points
        self._given: BodySegmenter | None = None  # of what was last given
        self._things: list[np.ndarray] = []  # points of what has not moved for long
        self._passed = np.zeros((0, 3), np.int32)  # places of objects that are no person: see BodySegmenter
        self._recent: deque[tuple[Frame, list[np.ndarray]]] = deque(maxlen=LOOK)  # and the places of all people
        self._steps = 0  # exponent of STEP: the share of points that is used

    @property
    def finder(self) -> BodySegmenter:
        """The segmenter of the present main one."""
        return self.main.finder

    def near_only(self, time_ns: int) -> Float32[np.ndarray, "point 3"] | None:
        """As that of the segmenter; also None while other objects are compared with the main one."""
        return self.finder.near_only(time_ns) if self.known else None

    def __call__(self, frames: Iterable[Frame]) -> Iterator[BodyObservation]:
        for frame in frames:
            self._see(frame)
            self._waiting.append(whole(frame).only(NONE))
            full = len(self._waiting) >= HELD
            if not self.known:
                self._decide(bool(assigned(frame).any()), full)
            self._number += 1
            if self.known or full or not self.ahead:
                yield from self._release()
        if not self.known:
            self._decide(full=True)
        yield from self._release()

    # -- frame by frame

    def _see(self, frame: Frame) -> None:
        main, alone = self.main, len(self.followed) == 1
        settled = alone and self.known
        looks = self._number % LOOK == 0 and (self.several or not self.known) and len(self.followed) < ALL
        if settled:
            # of several sensors one may have few points
            main.finder.thins = len(frame.origins) == 1
            main.add(main.finder(frame, self._things if main.finder.last is None else ()), self._number)
        if looks or not settled:
            finders = [t.finder for t in self.followed]
            wholly = looks or any(f.last is None or f.surveys(frame.time_ns) for f in finders)
            boxes = None if wholly else [f.around(frame.time_ns) for f in finders]
            share = main.finder.share if alone else STEP**self._steps
            clear = main.finder.clearing.cleared(frame, share, boxes)
            if not settled:
                self._follow(clear)
        self._recent.append((frame, [t.finder.last for t in self.followed if t.finder.last is not None]))
        if looks and (self._recent[-1][1] or not self.known):
            self._look(frame, clear, list(self._recent[-1][1]))
        self._renew()

    def _follow(self, clear: Cleared) -> None:
        """Assigns the points to the tracklets, those nearer to the sensors first."""
        self.followed.sort(key=lambda t: t.finder.unseen)
        seen, seconds = clear.seen, max(0.0, (clear.time_ns - self._last_ns) / 1e9)
        self._last_ns = clear.time_ns
        alone = len(self.followed) == 1
        before = [t.finder.last for t in self.followed]
        nobody = np.full(len(seen.points), -1, np.int8)
        owner = nobody if alone else _owners(seen, [t.finder for t in self.followed], self.settings.move)
        for k, tracklet in enumerate(self.followed):
            finder = tracklet.finder
            tracklet.add(found := finder(clear, mine=None if alone else (owner == k) | (owner < 0)), self._number)
            owner[finder.taken] = k
            if not self.known or (tracklet is not self.main and not tracklet.is_person):
                apart = not alone and before[k] is not None  # a person standing still is recognised by an arm
                tracklet.motion.note(found, clear.frame, apart, finder.scene.floor if finder.lies else None)
        if not alone:
            self._hide(seen, owner, before, seconds)
        self._leave(clear.time_ns)
        people = all(t.is_person for t in self.followed)
        # of fewer points it cannot be told who sways
        self._thin(len(seen.origins) == 1 and people and len(self.followed) > 1)

    def _hide(
        self, seen: BodyObservation, owner: Int8[np.ndarray, " point"], before: Sequence[np.ndarray | None],
        seconds: float,
    ) -> None:  # fmt: skip
        """Updates the hidden places of all tracklets."""
        owned = np.flatnonzero(owner >= 0)
        owned = owned[:: len(owned) // (SOME * len(before)) + 1]
        whose, points = owner[owned], picked(seen.points, owned)
        nearest = Nearest.shared(points, seen.sensor[owned], seen.origins)
        for k, tracklet in enumerate(self.followed):
            tracklet.keep_hidden(before[k], nearest(whose != k), seconds)

    def _leave(self, time_ns: int) -> None:
        """Ends tracklets that are lost or have not moved for long."""
        for tracklet in list(self.followed):
            if tracklet is not self.main and tracklet.finder.last is None:
                self._end(tracklet)
            elif tracklet is self.main or tracklet.is_person or time_ns - tracklet.born_ns <= IDLE_NS:
                continue
            elif (last := tracklet.finder.last) is not None and not tracklet.sways():
                self._things.append(some_of(last))
                self.followed.remove(tracklet)

    def _end(self, tracklet: Tracklet) -> None:
        self.followed.remove(tracklet)
        if tracklet.seen and (tracklet.is_person or tracklet.sways()):
            self._ended.append(tracklet)

    def _renew(self) -> None:
        """If the main one is lost, replaces it by another that has moved as much, or searches again."""
        main = self.main
        if main in self.followed and (main.finder.last is not None or not main.seen):
            return
        if main in self.followed:
            self._end(main)
        others = [t for t in self.followed if t.finder.last is not None and (t.is_person or not self.known)]
        best = max(others, key=lambda t: t.motion.moved, default=None)
        if best is not None and best.motion.moved >= max(main.motion.moved, LITTLE):
            self.main = best
        else:
            self.main = Tracklet(main.finder, self._number + 1, main)
            self.followed.append(self.main)

    def _thin(self, may: bool) -> None:
        """Sets the share of points such that the person with the fewest has at least about as many as are kept."""
        counts = [len(t.now.points) for t in self.followed if t.now is not None and len(t.now.points) >= TELLING]
        fewest = min(counts, default=0)
        if may and fewest >= ENOUGH * self.settings.points:
            self._steps += 1
        elif fewest < self.settings.points or not may:
            self._steps = max(0, self._steps - 1)
        for tracklet in self.followed:
            tracklet.finder.thins = False

    # -- what else may be a body

    def _look(self, frame: Frame, clear: Cleared, taken: list[np.ndarray]) -> None:
        """Begins to follow another object of a body's shape, if there is one; a small one only if there is no other."""
        if self._number % PATIENCE == 0:
            self._passed = self._passed[:0]
        s, main = self.settings, self.finder
        if main.last is None:
            s = replace(s, min_height=min(s.min_height, LOW))
        for _ in range(MOST):
            if len(self.followed) >= ALL:
                return
            finder = main.another(s)
            finder.passed = self._passed
            seen = finder(clear, taken + self._things)
            if len(seen.points) < TELLING or finder.likely < LIKELY * main.likely:
                self._passed = unique_cells(np.concatenate([self._passed, finder.asked]))[0]
                if self.known or (lying := self._lying(frame, clear, taken)) is None:
                    return
                finder, seen = lying
            self.followed.append(self._found(finder, seen))
            taken.append(seen.points)

    def _lying(
        self, frame: Frame, clear: Cleared, taken: list[np.ndarray]
    ) -> tuple[BodySegmenter, BodyObservation] | None:
        """A candidate lying on the floor or on a bed; None without one, or if one is followed already."""
        if any(t.finder.lies for t in self.followed):
            return None
        for scene in with_beds(frame, self.finder.scene, LOW * self.finder.body.height):
            finder = self.finder.lying(self.settings, scene)
            seen = finder(clear, taken)
            if len(seen.points) >= TELLING and finder.likely == 1.0:  # not of an upright person
                return finder, seen
        return None

    def _found(self, finder: BodySegmenter, seen: BodyObservation) -> Tracklet:
        """A new tracklet, followed back to its appearance after the last search."""
        earlier: list[tuple[BodyObservation, Frame]] = []
        if self.ahead and not finder.lies:
            back = finder.another(self.settings)
            back.last, back.last_ns = seen.points, seen.time_ns
            for old, taken in list(self._recent)[-2::-1]:
                earlier.append((back(old, taken), old))
                if len(earlier[-1][0].points) < TELLING:
                    earlier.pop()
                    break
        tracklet = Tracklet(finder, self._number - len(earlier))
        for k, (each, old) in enumerate([*earlier[::-1], (seen, self._recent[-1][0])]):
            tracklet.motion.note(each, old, False, finder.scene.floor if finder.lies else None)
            tracklet.add(each, tracklet.first + k)
        return tracklet

    # -- which one it is

    def _decide(self, assigned: bool = False, full: bool = False) -> None:
        """Selects the likeliest as the main one if it has moved, else another one that has.

        `assigned`: parts are assigned by the user; `full`: frames can wait no longer."""
        main, ahead = self.main, self.ahead
        others = [t for t in (*self.followed, *self._ended) if t is not main and t.motion.slid < LITTLE]
        best = max(others, key=lambda t: t.motion.moved, default=None)
        moved, most = main.motion.moved, best.motion.moved if best is not None else 0
        if assigned or main.motion.enough and FAIR * moved >= most:
            self.known = True
        elif best is not None and most > FAIR * moved:
            waited = main.motion.seen >= PATIENCE or not main.motion.seen
            self.known = ahead and full and most >= LITTLE or not ahead and most >= PATIENCE // 2 and waited
            # who has left is looked for from the next frame on
            here = best if best in self.followed else Tracklet(best.finder, self._number + 1, best)
            self.main = here if self.known else main
        if self.known and not self.several:
            for other in self.followed:
                if other is not self.main and (last := other.finder.last) is not None:
                    self._things.append(some_of(last))
            self.followed = [self.main]
        elif self.main not in self.followed:
            self.followed.append(self.main)

    def _release(self) -> Iterator[BodyObservation]:
        """The frames that waited, of the present main one."""
        frames, self._waiting = self._waiting, []
        begin, tracklet = self._number - len(frames), self.main
        if len(frames) == 1 and tracklet.now is not None and tracklet.now.time_ns == frames[0].time_ns:
            frames[0], tracklet = tracklet.now, None
        done = len(frames)  # from here on they have their points
        while tracklet is not None and done > 0:
            first = max(tracklet.first - begin, 0)
            own = tracklet.frames.frames() if first < done else []
            for k in range(first, done):
                if (at := begin + k - tracklet.first) < len(own):
                    frames[k] = own[at]
            done, tracklet = min(done, first), tracklet.before
        if frames and self._given not in (None, self.finder):
            frames[0] = replace(frames[0], other=True)
        self._given = self.finder
        if self.known and not self.keeps:
            self._ended.clear()
            for tracklet in self.followed:
                tracklet.forget()
        yield from frames

    def people(self, main: list[BodyObservation]) -> list[Observed]:
        """All people, those seen longest first; empty if there is only one, whose points are in `main`.

        **Arguments:** `main` the frames that were yielded.
        """
        found = [t for t in (*self._ended, *self.followed) if t.seen and (t.is_person or t.sways())]
        groups = linked(found, main)
        if len(groups) < 2:
            return []
        people = []
        for group in groups:
            frames = [frame.only(NONE) for frame in main]
            for tracklet in group:
                own = tracklet.frames.frames()
                frames[tracklet.first : tracklet.first + len(own)] = own
            people.append(Observed(group[-1].finder, self.settings, frames))
        return sorted(people, key=lambda p: -sum(len(f.points) >= TELLING for f in p.frames))


def _owners(frame: BodyObservation, finders: list[BodySegmenter], reach: float) -> Int8[np.ndarray, " point"]:
    """The nearest tracklet to each point in the previous frame; -1 if none was nearer than about `reach` metres. A
    hidden one gets the rest."""
    points = frame.points
    owner, many = np.full(len(points), -1, np.int8), np.zeros(len(points), np.int8)
    known = [(k, f, f.last[:: len(f.last) // SOME + 1]) for k, f in enumerate(finders) if f.last is not None]
    near = []
    for _, _, some in known:
        index = inside(points, some.min(0) - reach, some.max(0) + reach)
        near.append(index[about_within(picked(points, index), some, reach)])
        many[near[-1]] += 1
    nearest = np.full(len(points), np.inf) if (many > 1).any() else None
    for (k, finder, some), index in zip(known, near):
        together = many[index] > 1
        owner[index[~together]] = k  # how near does not matter
        index = index[together]
        if finder.unseen:
            index = index[owner[index] < 0]
        if nearest is None or not len(index):
            continue
        distance = KDTree(some).query(picked(points, index), distance_upper_bound=reach)[0]
        mine = distance < nearest[index]
        owner[index[mine]], nearest[index[mine]] = k, distance[mine]
    return owner
