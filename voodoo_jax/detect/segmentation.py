"""Separates the body's points from floor, walls and furniture. Host side, NumPy; one frame at a time, no look ahead.

It uses only the height and width of the body at rest.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float32, Int
from scipy.spatial import KDTree

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import HEADS, TELLING, Build, candidate, find_lying
from voodoo_jax.detect.clearing import Cleared, Clearing, distances
from voodoo_jax.detect.cut_in_two import joined
from voodoo_jax.detect.heads import each_person
from voodoo_jax.detect.visibility import PER_FRAME, in_the_way
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.point_cloud import even_share, fair_share, inside, picked
from voodoo_jax.geometry.voxels import Counted, Grid, about_within, cells_of, touching, within
from voodoo_jax.records.observation import BodyObservation, assigned, whole
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene

STILL = 0.06  # metres from one frame's points to those of the frame before, of things that do not move
APART = 0.6  # of a thing's points: so many where something was apart from the body make it that
GONE = 0.6  # of its height before: what is lower from one frame to the next is not the body any more
CELL = 0.08  # metres, of the grid in which the background is kept
LOW = 0.2  # of its points: so much a thing counts that is lower than half the body, where it is asked what is the body
ASIDE = 0.3  # metres, level: a low thing so far from the rest of the body is not its leg
WHOLE = 0.8  # of its height at rest: who is lower over a floor that nobody sees is not wholly in the picture
CUT_OFF = 0.5  # of its height: so much must be in the picture then
LONG = 10  # frames: what was seen apart from the body so often is a thing of its own
SPEED = 3.0  # metres per second: so fast the body may be where it was not seen for a moment ...
FARTHEST = 1.5  # metres, but not farther
ALIKE = 0.4  # of its points and of its height before: what it must have left there
BESIDE = 0.12  # metres: what is nearer to something that is followed is not another thing
# times the points that are kept: down to that a body is thinned first, if it has more by a step (STEP) or so; by hand
ENOUGH = 1.5
STEP = 0.5**0.5  # by which the share of them changes that is looked at: by hand, less than ENOUGH is above 1
# a thing is a part of the body if more points of it than this share of the body's are near where the body was, or than
# these: of a sparse sensor a hand that hides its arm has no more; by hand
FEW, SPECK = 0.012, (2.0, 5.0)
SOME = 600  # points of a person, or of what is beside the body, that tell where either is; by hand
SURVEY_NS = 490_000_000  # after which the whole room is looked at, not only what is near the body


class BodySegmenter:
    """Follows one object of a body's height and width: first the best candidate, then the component connected with its
    last place. Places where other objects were seen several times become background.

    If the floor is unknown, it is assumed the body's height below its top; `scene` is the present state.

    Points with an assigned part pass all tests; whatever they touch is the body, of any height.
    """

    def __init__(self, scene: Scene, body: Build, settings: DetectSettings):
        self.settings, self.body, self._given = settings, body, scene
        self.clearing = Clearing(scene, settings)
        self.last: np.ndarray | None = None  # the body's points in the last frame that had some
        self.others = np.zeros((0, 3), np.float32)  # what was near it in the last frame, and not taken
        self.unseen = self.last_ns = 0
        self.hidden = False  # in part, by somebody else: what seems to be apart from the body, or left by it, may be it
        self.taken = np.zeros(0, int)  # indices of the points taken from the last frame
        self.thins = False  # whether points may be left out where the body has many more than are kept (detect.points)
        self._steps = 0  # then: exponent of STEP, the share of them that is used
        self._surveyed_ns: int | None = None
        self.likely = 0.0  # to be the body: the last thing that was taken for it
        self.lies = False  # whether what is low and long may be it, see `lying`
        # where things are among which a body is looked for, and where earlier looks have found none: where hardly
        # anything else is seen there is still none
        self.asked = self.passed = np.zeros((0, 3), np.int32)
        self._background = Counted(CELL)
        self._learns = False  # in this frame, from what is beside the body: in every other one
        self._left = Counted(CELL)  # what remained where the body was, since it is gone
        self._beside: list[np.ndarray] = []  # some points of what was first seen beside the body

    @property
    def scene(self) -> Scene:
        """Floor and walls as far as they are known by now."""
        return self.clearing.scene

    @scene.setter
    def scene(self, scene: Scene) -> None:
        self.clearing.scene = scene

    def __call__(
        self,
        frame: Frame | BodyObservation | Cleared,
        taken: Sequence[Float32[np.ndarray, "_ 3"]] = (),
        mine: Bool[np.ndarray, " point"] | None = None,
    ) -> BodyObservation:
        """The body's points in a frame, except for those near points `taken` by others; `mine`: candidates, None:
        all."""
        clear = frame if isinstance(frame, Cleared) else self.cleared_near(frame)
        known, sure, index = self._own(clear, taken, mine)
        if self.last is not None and len(sure) and np.median(KDTree(self.last).query(sure)[0]) > self.settings.move:
            self.last = None  # the body is somewhere else than thought
            clear = frame if isinstance(frame, Cleared) else self.cleared_near(frame)
            known, sure, index = self._own(clear, taken, mine)
        index, distant = self._near(clear, index)
        index = index[fair_share(clear.seen.sensor[index], 20_000)] if len(index) > 20_000 else index
        seen = clear.seen.only(index)
        # not where something else than the body was seen before
        new = (self._background.at(seen.points) < 3).nonzero()[0]
        if len(new) < len(index):
            index, seen = index[new], seen.only(new)
        if self.last is None:
            self.asked = cells_of(seen.points, CELL)
            if len(self.passed) and not len(sure) and np.sum(~touching(self.asked, self.passed)) < TELLING:
                self.taken = index[:0]
                return seen.only(self.taken)
        found, chosen = seen.points, self._choose(seen, sure, clear.seen)
        if not chosen.all():
            on = chosen.nonzero()[0]
            index, seen = index[on], seen.only(on)
        self.others = picked(found, (~chosen).nonzero()[0])
        if not len(sure) and self._gone(seen.points):
            self._left.add(cells_of(seen.points, CELL), 1.0)
            index, seen, self.others = index[:0], seen.only(index[:0]), found
        self._learn(distant, seen.points, sure)
        # the points of a limb or two do not tell where the others are
        tells = len(seen.points) >= TELLING or self._of_body(clear.seen, known) >= TELLING
        if len(sure):
            index = np.sort(np.concatenate([index, known]))
            seen = clear.seen.only(index)
        if tells:
            self.last, self.last_ns, self.unseen = seen.points, frame.time_ns, 0
            self._left.clear()
            self._thin()
        else:
            self.unseen += 1
            if self.unseen > self.settings.forget:
                self.last, self._steps = None, 0  # gone: look everywhere again
                if self.lies:
                    self.clearing.take(self._given)
                self._background.add(self._left.cells(self.unseen / 3), LONG)
                self._left.clear()
        self.taken = index
        before, sensor = in_the_way(whole(clear.frame), clear.index[index], self.scene.floor)
        return replace(seen, before=before, before_sensor=sensor) if len(before) else seen

    def cleared_near(self, frame: Frame | BodyObservation) -> Cleared:
        """The cleared points of a frame near this body."""
        wholly = self.last is None or self.surveys(frame.time_ns)
        return self.clearing.cleared(frame, self.share, None if wholly else [self.around(frame.time_ns)])

    def _own(
        self, clear: Cleared, taken: Sequence[np.ndarray], mine: Bool[np.ndarray, " point"] | None
    ) -> tuple[Int[np.ndarray, " known"], Float32[np.ndarray, "known 3"], Int[np.ndarray, " free"]]:
        """Indices of the points of a cleared frame with assigned parts, these points, and indices of the candidates."""
        seen = clear.seen
        own = np.ones(len(seen.points), bool) if mine is None else mine
        if len(taken):
            own = own & ~near_taken(seen.points, taken)
        known = own & assigned(seen)
        own = own & ~known if clear.scene is self.scene else own & ~known & self.clearing.off_planes(seen.points)
        return known.nonzero()[0], seen.points[known], own.nonzero()[0]

    def _near(
        self, clear: Cleared, index: Int[np.ndarray, " free"]
    ) -> tuple[Int[np.ndarray, " near"], Float32[np.ndarray, "far 3"]]:
        """Indices of points near the body's last place; and, when the whole room is searched, the farther points."""
        points, now = clear.seen.points, clear.time_ns
        if self.last is None:
            return index, points[:0]
        near, survey = inside(points, *self.around(now), index), self.surveys(now)
        self._surveyed_ns = now if survey or self._surveyed_ns is None else self._surveyed_ns
        return near, picked(points, np.setdiff1d(index, near, True)) if survey else points[:0]

    def around(self, time_ns: int) -> tuple[Float32[np.ndarray, "3"], Float32[np.ndarray, "3"]]:
        """The box of the body at that time, with a margin; lowest and highest corner."""
        assert self.last is not None
        reach = np.float32(self.settings.reach + self._gone_by(time_ns))
        return self.last.min(0) - reach, self.last.max(0) + reach

    def surveys(self, time_ns: int) -> bool:
        """Whether it is time to search the whole room, not only near the body."""
        if self.last is None or self._surveyed_ns is None:
            return False
        return time_ns - self._surveyed_ns >= SURVEY_NS

    def near_only(self, time_ns: int) -> Float32[np.ndarray, "point 3"] | None:
        """The body's last points, if a frame of that time is searched only near them; None: the whole room is
        searched."""
        if self.last is None or self.unseen or self._surveyed_ns is None:
            return None
        return None if self.surveys(time_ns) else self.last

    @property
    def share(self) -> float:
        """The share of a frame's points that is used."""
        return STEP**self._steps if self.thins and self.last is not None else 1.0

    def _thin(self) -> None:
        """Sets the share of points such that the next frame has at least about as many points on the body as are
        kept."""
        assert self.last is not None
        count, kept = len(self.last), self.settings.points
        if self.thins and count >= (ENOUGH if self._steps else ENOUGH / STEP) * kept:
            steps = 1
            while count * STEP**steps >= ENOUGH * kept:
                steps += 1
            self._steps, self.last = self._steps + steps, picked(self.last, even_share(STEP**steps, count))
        elif count < kept:
            self._steps = max(0, self._steps - 1)

    def another(self, settings: DetectSettings) -> "BodySegmenter":
        """A segmenter without a body, for the same sensors."""
        other = BodySegmenter(self._given, self.body, settings)
        other.clearing = self.clearing.another(self._given, settings)
        return other

    def lying(self, settings: DetectSettings, scene: Scene) -> "BodySegmenter":
        """A segmenter that searches for a person lying on the floor of a scene, or on a surface in its place."""
        other = self.another(settings)
        other.lies = True
        other.clearing.take(scene)
        return other

    def _of_body(self, frame: BodyObservation, known: Int[np.ndarray, " known"]) -> int:
        """Number of the `known` points assigned to the whole body; all of them if they are on four limbs or more."""
        if frame.part is None:
            return 0
        part = frame.part[known]
        if len(np.unique(part)) >= 4:
            return len(known)
        return int(np.sum(np.array([name == "body" for name in frame.parts])[part]))

    def _choose(self, seen: BodyObservation, sure, frame: BodyObservation) -> Bool[np.ndarray, " point"]:
        """Which of the points `seen` in a frame belong to the body. `sure`: those with assigned parts."""
        points = seen.points
        if len(points) < TELLING:
            return np.zeros(len(points), bool)
        cell = self.clearing.link(seen) / 2
        reach = max(1, round(self.settings.move / cell - 1))  # cells, from frame to frame
        grid = Grid(cells_of(points, cell), reach)
        near = None if self.last is None else grid.near(cells_of(self.last, cell), reach)
        label = grid.labels()
        count = np.bincount(label)
        most = np.zeros(len(count), bool)
        if len(sure):
            touched = KDTree(sure).query(points, distance_upper_bound=self.settings.link)[0] < np.inf
            touched = np.bincount(label, touched) * (count >= TELLING)
            most[np.argmax(touched)] = touched.any()
        if near is None or self.last is None:
            if most.any():
                return most[label]
            label = each_person(points, label, self.clearing, self.body)
            label = joined(seen, label, frame, self.clearing, self.body)
            return label == self._candidate(seen, label)
        beside = np.bincount(label, grid.near(cells_of(self.others, cell)))
        taken = most | self._followed(points, label, (count, np.bincount(label, near), beside), self.last)
        far = self._gone_by(seen.time_ns)
        if far > 0 and np.sum(count[taken]) < ALIKE * len(self.last):
            taken |= self._elsewhere(points, label, count, self.last, self.settings.move + far)
        return taken[label]

    def _gone_by(self, time_ns: int) -> float:
        """Additional distance that the body may have moved since it was last seen, metres."""
        return min(max(SPEED * (time_ns - self.last_ns) / 1e9 - self.settings.move, 0.0), FARTHEST)

    def _elsewhere(self, points, label, count, last, far: float) -> Bool[np.ndarray, " thing"]:
        """The object nearest to the body's last place that is like it, and was not there before."""
        floor, best = self.scene.floor, np.zeros(len(count), bool)
        near = np.bincount(label, within(points, last, far))
        for k in np.argsort(-near):
            if near[k] <= 0.3 * count[k] or count[k] < ALIKE * len(last):
                continue
            mine = points[label == k]
            known = len(self.others) > 0 and within(mine, self.others, STILL).mean() >= APART
            if not known and floor.top(mine) > ALIKE * floor.top(last):
                best[k] = True
                break
        return best

    def _followed(self, points, label, counts, last) -> Bool[np.ndarray, " thing"]:
        """Which objects are connected with the body's last place, by the `counts` of their points, of those near it,
        and of those next to objects seen apart from it."""
        count, near, beside = counts
        taken = near > np.maximum(np.clip(FEW * len(last), *SPECK), 0.3 * count)
        # what stood apart from the body and stays where it is remains apart, however near: a chair;
        # not what is small: a foot rests while the other one steps; nor the body itself, if it is where it was
        doubtful = taken & (count >= 0.1 * len(last))
        large = np.flatnonzero(doubtful)
        if self.hidden or (len(large) < 2 and not (beside[large] >= APART * count[large]).any()):
            return taken
        some = {k: points[label == k] for k in large if len(large) > 1}
        low = {k: mine for k, mine in some.items() if self.scene.floor.top(mine) < 0.5 * self.body.height}
        near[list(low)] *= LOW  # a box may have more points than the body
        main = int(np.argmax(near))
        for k, mine in low.items():
            if k != main and self._is_left(mine, points[label == main], last):
                taken[k] = doubtful[k] = False
                self._background.add(cells_of(mine, CELL), LONG)  # so it was all the time
        for k in np.flatnonzero(doubtful & (beside >= APART * count)):
            mine = points[label == k]
            apart = (
                within(mine, last, STILL).sum() < 0.5 * len(mine)
                if k == main
                else not self._is_head(mine, points[label == main])
            )
            taken[k] = not (apart and within(mine, self.others, STILL).sum() >= APART * len(mine))
        return taken

    def _is_left(self, thing, body, last) -> bool:
        """Whether a low thing is still, and beside the body: furniture that it has left."""
        return stands_aside(thing, body, self.scene.floor) and bool(within(thing, last, STILL).mean() > APART)

    def _gone(self, taken) -> bool:
        """Whether the remaining points were never the body: suddenly fewer and far lower, such as a chair."""
        if self.last is None or self.hidden or len(taken) < TELLING or len(taken) > 0.8 * len(self.last):
            return False
        floor = self.scene.floor
        return floor.top(taken) < GONE * floor.top(self.last)

    def _is_head(self, thing, body) -> bool:
        """Whether an object is right above a body: a head whose neck is hidden or narrow, not a chair."""
        floor = self.scene.floor
        apart = np.median(thing, 0) - np.median(body, 0)
        apart -= (apart @ floor.normal) * floor.normal
        return bool(floor.height(thing).min() > HEADS * self.body.height and np.linalg.norm(apart) < 0.3)

    def _candidate(self, seen: BodyObservation, label) -> int:
        """Label of the likeliest object to be the body, or -1; determines the floor, too, if it is unknown."""
        points, sensor = seen.points, seen.sensor
        angle = np.array(self.clearing.of_sensors(self.clearing.spacing, seen))[sensor]
        distance = distances(seen)
        area = (distance * angle) ** 2
        least = CUT_OFF if self.scene.floor_open else self.settings.min_height
        places = self.clearing.places(points)

        if self.lies:
            best = find_lying(points, label, area, self.scene.floor, self.body.height)
            self.likely = float(best >= 0)
            if best >= 0 or self.scene is not self._given:
                return best
        best, top, self.likely = candidate(points, label, area, distance, places, self.body, least)
        if self.scene.floor_open and 0 < top < WHOLE * self.body.height:
            # the feet of who seems so small are not in the picture
            floor = self.scene.floor
            floor = replace(floor, offset=floor.offset - (self.body.height - top))
            self.clearing.take(replace(self.scene, floor=floor, floor_open=False))
        return best

    def apart(self) -> Callable[[Float32[np.ndarray, "point 3"]], Bool[np.ndarray, " point"]]:
        """A function of points: whether they are at places where an object was seen apart from the body for some
        time."""
        cells = self._background.cells(LONG)
        if not len(cells):
            return lambda points: np.zeros(len(points), bool)
        tree = KDTree((cells + 0.5) * CELL)
        low, high = (((cells.min(0) - 1) * CELL).astype(np.float32), ((cells.max(0) + 2) * CELL).astype(np.float32))

        def among_these(points):
            found = np.zeros(len(points), bool)
            asked = inside(points, low, high)  # the others are too far off, and most of these
            asked = asked[touching(cells_of(picked(points, asked), CELL), cells)]
            found[asked] = tree.query(points[asked], distance_upper_bound=1.2 * CELL)[0] < np.inf
            return found

        return among_these

    def _learn(self, distant, body, sure) -> None:
        """Counts the places of other objects: those near the body, and those that are `distant`."""
        if self.last is None and not len(body) and not len(sure):
            # nobody there: the room, or somebody who is not told from it yet, so it takes most of a second
            apart, times = self.others, 0.15
        else:
            nothing = not len(self.others) + len(distant) or not len(body) + len(sure)
            if self.last is None or self.hidden or nothing:
                return
            self._learns = not self._learns
            if not self._learns and not len(distant):
                return
            mine = np.concatenate([body, sure]) if len(sure) else body
            apart, times = self.others[~about_within(self.others, mine, self.settings.move)], 2.0
            apart = np.concatenate([apart, distant]) if len(distant) else apart
        self._background.add(cells_of(apart, CELL), times)
        if self.last is not None and sum(map(len, self._beside)) < SOME:
            self._beside.append(apart[:: len(apart) // PER_FRAME + 1])

    def beside(self) -> Float32[np.ndarray, "point 3"]:
        """Some points of objects that were seen beside the body at first; later frames are not searched there."""
        return np.concatenate([np.zeros((0, 3), np.float32), *self._beside])


def near_taken(points: Float32[np.ndarray, "point 3"], taken: Sequence[np.ndarray]) -> Bool[np.ndarray, " point"]:
    """Which points are near some that are taken."""
    return touching(cells_of(points, BESIDE), cells_of(np.concatenate(taken), BESIDE))


def stands_aside(thing: Float32[np.ndarray, "thing 3"], body: Float32[np.ndarray, "body 3"], floor: Plane) -> bool:
    """Whether an object is beside the body, not below it as legs are."""
    return bool(within(floor.level(thing), floor.level(body), ASIDE).mean() < 0.05)
