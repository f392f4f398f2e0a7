"""Everybody in view: who is beside the person that is followed, each from when they come until they leave.

Host side, NumPy. Target selection follows one person and knows nothing of this. What is beside them and is of a
body's shape is followed by a finder of its own; once there are two, what is near both goes to the nearer one, by where
they were in the frame before. Who moves is a person; furniture and dummies do not. Who was hidden or away for a while
is known again by height and place.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float32, Int8
from scipy.spatial import KDTree

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.disk_buffer import Spill
from voodoo_jax.detect.drop_motionless import DropMotionless
from voodoo_jax.detect.segmentation import ENOUGH, SPEED, STEP, STILL, TELLING, BodySegmenter, Cleared
from voodoo_jax.detect.stillness import NOISE, Stillness, directions, filled, seen_long
from voodoo_jax.detect.target_selection import LITTLE, LOOK, MOST, NONE, Chooser, Follower, same
from voodoo_jax.detect.visibility import Nearest
from voodoo_jax.geometry.point_cloud import inside, picked, quantile
from voodoo_jax.geometry.voxels import Grid, cells_of, touching, unique_cells
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Frame

PLACED = 300  # points of somebody by which it is told where they are; by hand
SOME, NEAR = 600, 3  # points of somebody by which it is told who is nearer, and cells within their reach; by hand
HIDING = 2000  # points of all together by which it is told who hides whom; by hand
AGAIN = 6  # looks for others, of which one goes through all that is there: about two seconds; by hand
IDLE_NS = 20_000_000_000  # who has not moved for so long is furniture for the time being; by hand
BRIEF = 8  # frames: who is seen in fewer is nobody; by hand
PACE = 2.5  # metres per second, of who is not seen for a while: a quick walk; by hand
AROUND = 0.8  # metres that they may be elsewhere in any case; by hand
LIKELY = 0.06  # of what is likeliest to be a body: a child of 1.1 m is so much less so than an adult; by hand
LIKE = 0.07  # metres of height: who differs by more is somebody else; by hand
CLOSE = 0.15  # metres, and twice that: whose points are so near to each other may be mixed up; by hand
STIRRED = 10  # frames in which an arm or so of them is where nothing was: who moves no more than that; by hand
ASKS = DropMotionless()  # of which directions it is asked whether they move, and when
# of these: of people who stand still 80 % move or more, of a cupboard before which somebody moves a third (measured)
SWAYING = 0.6
MOSTLY = 0.5  # of the frames in which they were seen: who moves in so many is a person, however few they are; by hand
WATCHED = 150  # frames, the last ones, by which it is asked whether somebody sways; five seconds, by hand
HIDDEN = 0.02  # of somebody's points: so much is hidden of who is taken for hidden in part; by hand
WAY = 0.4  # seconds over which it is measured how fast somebody walks; by hand
SLOW = 0.3  # metres per second: who is slower stands; by hand
BLIND = 1.5  # seconds for which somebody whom nobody sees is thought to walk on; by hand
ALL = 6  # people that are followed at once, at most; by hand


@dataclass(eq=False)
class Sighting:
    """Somebody from when they came into view until they left, or were hidden for long."""

    follower: Follower
    first: int  # frame that `frames` begin with
    frames: Spill = field(default_factory=Spill)
    count: int = 0  # of the frames
    last: int = -1  # frame in which they were seen for the last time
    seen: int = 0  # frames in which they were
    now: BodyObservation | None = None  # what was seen of them in the last frame
    tops: list[float] = field(default_factory=list)  # heights above the floor, of each frame in which they were seen
    places: dict[int, np.ndarray] = field(default_factory=dict)  # of the first and last frames: where they were
    born_ns: int = 0
    alive: bool = False  # known by what `sways`
    _way: deque = field(default_factory=deque)  # time in seconds, and place, while nobody hid them

    @property
    def finder(self) -> BodySegmenter:
        return self.follower.finder

    @property
    def is_person(self) -> bool:
        """Whether they have moved as no thing does."""
        f = self.follower
        return (self.alive or f.moves or f.went >= LITTLE or f.stirred >= STIRRED) and self.seen >= BRIEF

    def sways(self) -> bool:
        """Whether they move as who stands still does, by millimetres, or in most of the few frames that there are: then
        they are a person from now on."""
        frames, moved = self.frames.frames()[-WATCHED:], self.follower.moved
        self.alive |= moved >= max(LITTLE, MOSTLY * self.follower.there)
        if seen_long(frames, ASKS.frames, ASKS.seconds):
            found = directions(frames)
            asked = filled(found) & (found.often >= ASKS.often)
            self.alive |= asked.sum() >= ASKS.fewest and float(np.mean(found.ratio[asked] < NOISE)) > SWAYING
        return self.is_person

    @property
    def height(self) -> float:
        """Of who stands upright most of the time, metres."""
        return float(np.percentile(self.tops, 80)) if self.tops else np.nan

    def keep_hidden(self, before: Float32[np.ndarray, "point 3"] | None, others: Nearest, seconds: float) -> None:
        """Takes care that what others hide of them now is known for theirs when it comes out again: where they were
        seen `before`, so many seconds ago, counts on where no sensor sees it."""
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
            # who walks on does so behind somebody, too
            some = some[hidden] + self._velocity() * np.float32(seconds)
            if not finder.unseen:
                some = some[~touching(cells_of(some, STILL), cells_of(finder.last, STILL))]
                finder.last = np.concatenate([finder.last, some])
            elif finder.unseen * seconds < BLIND:
                finder.last = np.concatenate([some, before[:: len(before) // SOME + 1][~hidden]])

    def _velocity(self) -> Float32[np.ndarray, "3"]:
        """Level, when they were wholly seen for the last time; metres per second."""
        if not self._way:
            return np.zeros(3, np.float32)
        (began, first), (ended, last) = self._way[0], self._way[-1]
        speed = (last - first) / max(ended - began, 1e-3)
        walks = SLOW < np.linalg.norm(speed) < SPEED and ended - began > 0.5 * WAY
        return (speed if walks else 0 * speed).astype(np.float32)

    def see(self, frame: Cleared, mine: Bool[np.ndarray, " point"], number: int) -> None:
        """Follows them in the next frame, among the points that may be theirs (`mine`)."""
        if self.is_person:  # and remains one: nothing is compared any more
            self.add(self.finder(frame, mine=mine), number)
        else:
            self.add(self.follower.see(frame, mine), number)

    def add(self, frame: BodyObservation, number: int) -> None:
        """What was seen of them in the next frame."""
        self.frames.append(frame)
        self.now, self.count = frame, self.count + 1
        if len(frame.points) >= TELLING:
            floor = self.finder.scene.floor
            self.last, self.seen = number, self.seen + 1
            self.tops.append(floor.top(frame.points))
            place = quantile(floor.level(frame.points[:: len(frame.points) // PLACED + 1]), 0.5)
            self.places.setdefault(0, place)
            self.places[1] = place
            if not self.finder.hidden:
                self._way.append((frame.time_ns / 1e9, place))
                while self._way[-1][0] - self._way[0][0] > WAY:
                    self._way.popleft()


@dataclass(frozen=True)
class Observed:
    """Somebody in a recording: what was seen of them in each frame, and the scene they are in."""

    finder: BodySegmenter
    settings: DetectSettings
    frames: list[BodyObservation]
    stillness: Stillness = field(default_factory=Stillness)


class People:
    """Follows everybody beside the one whom a chooser follows."""

    def __init__(self, chooser: Chooser, settings: DetectSettings, ahead: bool = True):
        self.chooser, self.settings, self.ahead = chooser, settings, ahead
        self._followed: list[Sighting] = []
        self._left: list[Sighting] = []
        self._things: list[np.ndarray] = []  # points of what has not moved for long
        self._passed = np.zeros((0, 3), np.int32)  # where things are among which nobody was found: see BodySegmenter
        self._recent: deque[tuple[Frame, list[np.ndarray]]] = deque(maxlen=LOOK)  # and who was where
        self._steps = 0  # by so many the share of a frame's points is less that is looked at
        self._origin: Follower | None = None  # of the chooser, whom the first one continues
        self._continued: Sighting | None = None  # that one
        self._before: list[BodyObservation] = []  # what waited of them then
        self._number = self._last_ns = 0  # of the frame
        self._several = False  # whether there are two people, for certain
        self._done = -1  # number of the last frame that was gone through
        chooser.beside = self._of_main

    def watched(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The frames, one by one, for the chooser; it is done with each before the next one is asked for."""
        for frame in frames:
            yield frame
            if self._done < self._number:
                self._see(frame)
            self._number += 1

    def _of_main(self, frame: Frame) -> BodyObservation | None:
        """What is seen of whom the chooser follows, in its place: they need not be looked for twice, once it is certain
        that they are not alone."""
        main = self._continued
        if main is None or not self._several or main not in self._followed or self.chooser.main is not self._origin:
            return None
        self._see(frame)
        self._done = self._number
        finder, own = self.chooser.finder, main.finder
        finder.last, finder.last_ns, finder.unseen = own.last, own.last_ns, own.unseen  # if they are alone again
        return main.now

    # -- frame by frame

    def _see(self, frame: Frame) -> None:
        looks = self._number % LOOK == 0 and len(self._followed) < ALL
        main, known = self.chooser.finder, [s.finder for s in self._followed if s.finder.last is not None]
        clear: Cleared | None = None
        if self._followed or looks:
            share = STEP**self._steps if self._followed else main.share
            wholly = looks or any(finder.surveys(frame.time_ns) for finder in known)
            clear = main.cleared(frame, share, None if wholly else [f.around(frame.time_ns) for f in known])
        if clear is not None and (self._followed or self._left):
            self._follow(clear, looks)
            self._several = self._several or _are_several(self._followed)
        taken = [s.finder.last for s in self._followed if s.finder.last is not None]
        if not self._followed and main.last is not None:
            taken = [main.last]
        self._recent.append((frame, taken))
        if looks and clear is not None and taken:
            self._look(clear, taken)

    def _follow(self, clear: Cleared, looks: bool) -> None:
        """Shares the points out among those who are followed, the nearer ones to the sensors first."""
        self._followed.sort(key=lambda s: s.finder.unseen)
        seen = clear.seen
        owner = _owners(seen, [s.finder for s in self._followed], self.settings.move)
        before = [s.finder.last for s in self._followed]
        seconds, self._last_ns = max(0.0, (seen.time_ns - self._last_ns) / 1e9), seen.time_ns
        for k, sighting in enumerate(self._followed):
            mine = sighting.finder.last
            others = [p for j, p in enumerate(before) if j != k and p is not None]
            # by an arm alone somebody is known who stands still else, unless it may be another one's
            sighting.follower.alone = mine is not None and not sighting.is_person and not _beside(mine, others)
            sighting.see(clear, (owner == k) | (owner < 0), self._number)
            owner[sighting.finder.taken] = k
        owned = np.flatnonzero(owner >= 0)
        owned = owned[:: len(owned) // HIDING + 1]
        whose, points = owner[owned], picked(seen.points, owned)
        nearest = Nearest.shared(points, seen.sensor[owned], seen.origins)
        for k, sighting in enumerate(self._followed):
            sighting.keep_hidden(before[k], nearest(whose != k), seconds)
        # of fewer points it cannot be told who sways
        self._thin(len(seen.origins) == 1 and all(s.is_person for s in self._followed))
        for sighting in list(self._followed):
            others = [s for s in self._followed if s is not sighting and s.seen >= sighting.seen]
            twice = looks and any(same(sighting.follower, s.follower) for s in others)
            if sighting.finder.last is None or twice:
                self._end(sighting)
            elif not sighting.is_person and seen.time_ns - sighting.born_ns > IDLE_NS and not sighting.sways():
                self._things.append(sighting.finder.last[:: max(1, len(sighting.finder.last) // SOME)])
                self._followed.remove(sighting)

    def _thin(self, may: bool) -> None:
        """Sees to it that whoever has fewest points in the next frame has about as many as are kept, or more."""
        counts = [len(s.now.points) for s in self._followed if s.now is not None and len(s.now.points) >= TELLING]
        fewest = min(counts, default=0)
        if may and fewest >= ENOUGH * self.settings.points:
            self._steps += 1
        elif fewest < self.settings.points:
            self._steps = max(0, self._steps - 1)

    def _end(self, sighting: Sighting) -> None:
        self._followed.remove(sighting)
        if sighting.is_person or sighting.sways():
            self._left.append(sighting)

    def _look(self, frame: Cleared, taken: list[np.ndarray]) -> None:
        """Begins to follow somebody else, if there is anybody of a body's shape."""
        if self._number % (AGAIN * LOOK) == 0:
            self._passed = self._passed[:0]
        for _ in range(MOST):
            finder = self.chooser.finder.another(self.settings)
            finder.passed = self._passed
            seen = finder(frame, taken + self._things)
            if len(seen.points) < TELLING or finder.likely < LIKELY * self.chooser.finder.likely:
                self._passed = unique_cells(np.concatenate([self._passed, finder.asked]))[0]
                return
            if not self._followed:
                self._followed.append(self._main(frame))
            self._followed.append(self._found(finder, seen))
            taken.append(seen.points)
            if len(self._followed) >= ALL:
                return

    def _main(self, frame: Cleared) -> Sighting:
        """Whom the chooser follows, from here on together with others."""
        main = self.chooser.main
        self._origin, self._before = main, list(main.frames)
        self._continued = Sighting(main.forked(), self._number + 1, born_ns=frame.time_ns)
        return self._continued

    def _found(self, finder: BodySegmenter, seen: BodyObservation) -> Sighting:
        """Somebody, followed back to when they came into view, which was after the last look."""
        earlier: list[tuple[BodyObservation, Frame]] = []
        if self.ahead:
            back = finder.another(self.settings)
            back.last, back.last_ns = seen.points, seen.time_ns
            for old, taken in list(self._recent)[-2::-1]:
                earlier.append((back(old, taken), old))
                if len(earlier[-1][0].points) < TELLING:
                    earlier.pop()
                    break
        sighting = Sighting(Follower(finder), self._number - len(earlier), born_ns=seen.time_ns)
        for k, (each, old) in enumerate([*earlier[::-1], (seen, self._recent[-1][0])]):
            sighting.follower.note(each, old)
            sighting.add(each, sighting.first + k)
        return sighting

    # -- all of it

    def observed(self, main: list[BodyObservation]) -> list[Observed]:
        """Everybody, who is seen longest first; nobody if there is but one, for whom the chooser has told.

        **Arguments:** `main` the chooser's frames.
        """
        found = [s for s in (*self._left, *self._followed) if s.is_person or s.sways()]
        groups = linked(found, main)
        if len(groups) < 2:
            return []
        people = []
        for group in groups:
            frames = [frame.only(NONE) for frame in main]
            for sighting in group:
                own = sighting.frames.frames()
                if sighting is self._continued and self.chooser.main is self._origin:
                    frames[: sighting.first] = main[: sighting.first]
                elif sighting is self._continued:
                    frames[sighting.first - len(self._before) : sighting.first] = self._before
                frames[sighting.first : sighting.first + len(own)] = own
            people.append(Observed(group[-1].finder, self.settings, frames))
        return sorted(people, key=lambda p: -sum(len(f.points) >= TELLING for f in p.frames))


def _are_several(followed: list[Sighting]) -> bool:
    """Whether two are people, and were seen at one time: they will never be taken for one."""
    people = sorted((s for s in followed if s.is_person), key=lambda s: s.first)
    return any(one.last >= other.first for one, other in zip(people, people[1:]))


def _owners(frame: BodyObservation, finders: list[BodySegmenter], reach: float) -> Int8[np.ndarray, " point"]:
    """Who was nearest to each point in the frame before; -1 where nobody was nearer than about `reach` metres. Who is
    hidden has what is left."""
    points = frame.points
    owner, many = np.full(len(points), -1, np.int8), np.zeros(len(points), np.int8)
    known = [(k, f, f.last[:: len(f.last) // SOME + 1]) for k, f in enumerate(finders) if f.last is not None]
    near = []
    for _, _, some in known:
        index, cell = inside(points, some.min(0) - reach, some.max(0) + reach), reach / NEAR
        grid = Grid(cells_of(picked(points, index), cell), NEAR)
        near.append(index[grid.near(cells_of(some, cell), NEAR)])
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


def _beside(points: Float32[np.ndarray, "point 3"], others: list[np.ndarray]) -> bool:
    """Whether some points are near those of others."""
    cells = cells_of(points, CLOSE)
    return any(touching(cells, cells_of(other, CLOSE)).any() for other in others)


def linked(found: list[Sighting], frames: list[BodyObservation]) -> list[list[Sighting]]:
    """Sightings of the same people, each in order of time: who was away or hidden is known again by height, and by
    where they can have gone meanwhile."""
    groups: list[list[Sighting]] = []
    for sighting in sorted(found, key=lambda s: s.first):
        costs = [_unlike(group[-1], sighting, frames) for group in groups]
        best = int(np.argmin(costs)) if costs else -1
        if best >= 0 and costs[best] < 1:
            groups[best].append(sighting)
        else:
            groups.append([sighting])
    return groups


def _unlike(before: Sighting, after: Sighting, frames: list[BodyObservation]) -> float:
    """How unlike each other the last and the first sight of somebody are: below 1 they may be the same."""
    if before.last >= after.first:
        return np.inf
    seconds = (frames[after.first].time_ns - frames[before.last].time_ns) / 1e9
    away = np.linalg.norm(after.places[0] - before.places[1]) / (AROUND + PACE * seconds)
    return float(max(away, abs(after.height - before.height) / LIKE))
