"""One recording on its way through the compiled programs: trials, chunks of frames, changes of the body. Host side."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Int, Int8

from voodoo_jax.config.options import Change, Settings, StartSettings
from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.kernels.landmarks import Features
from voodoo_jax.markers.table import ENOUGH, TO_START, explained, marker_table
from voodoo_jax.model.attachments import appeared, applied, directions, hung_on, pointing
from voodoo_jax.model.body import Body
from voodoo_jax.model.pose_library import Stance
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Status
from voodoo_jax.solve.names import FeatureNames, PartNames
from voodoo_jax.solve.padding import FEATURE_BUCKETS, Chunk, bucket, pad_features, pad_frames
from voodoo_jax.solve.scan import NOBODY, State, Step, TrackOptions, Visit, Visits, at_rest, track_visits
from voodoo_jax.trackers.icp.trials import Trial, in_pieces, run_trials

THING_FRAMES = 2  # times the frames of a start: a held thing has few points to tell where it points
FEW_POINTS = 20  # fewer on the body: nothing to track by
TRACKS = 16  # starts that are tried at once: all headings, and the poses that were lost


def first_run(mask: Bool[np.ndarray, " frame"], length: int) -> int:
    """Index of the first run of `length` True, or the array's length."""
    if len(mask) < length:
        return len(mask)
    full = np.convolve(mask, np.ones(length, int), "valid") == length
    return int(np.argmax(full)) if full.any() else len(mask)


def spans(bodies: Sequence[tuple[int, Body]], count: int) -> list[tuple[int, int, Body]]:
    """First frame, the one after the last, and body, from the bodies [(first frame, body)] of `count` frames."""
    ends = [*(first for first, _ in bodies[1:]), count]
    return [(first, end, body) for (first, body), end in zip(bodies, ends)]


class Runner:
    """Tracks one recording's person frames: start, chunks of frames, changes of the body on the way.

    `changes` are those of the settings, loaded, and `body` is prepared for them (see model.attachments.prepared);
    `visit` runs the program, None: here and now.
    """

    def __init__(  # 7 parameters, each once: what is tracked, how, and by whom
        self,
        body: Body,
        options: TrackOptions,
        people: list[BodyObservation],
        scene: Scene,
        settings: Settings,
        changes: Sequence[Change] = (),
        visit: Visit | None = None,
    ):
        self.body, self.options, self.people, self.scene, self.settings = body, options, people, scene, settings
        self.visit = visit or track_visits
        self._given = body, changes  # as they were before the first frame
        self.sensors = len(people[0].origins) if people else 1
        self.capacity = bucket(settings.detect.points)
        self.length = max(settings.track.chunk, settings.start.frames)  # frames that the program takes at once
        self.bodies = [(0, body)]  # first frame from which on the body is so
        self.mirrored = False  # whether left and right of all names were exchanged
        self.sized = False  # whether the body has its size; the first start finds it
        self.stances: dict[int, Stance] = {}  # that segments began in, by first frame, the last time they were tracked
        first = people[0].time_ns if people else 0
        stamps = np.array([f.time_ns for f in people], np.int64)
        self.pending = [(int(np.searchsorted(stamps, first + round(c.time * 1e9))), c) for c in changes]
        self.others = [k for k, f in enumerate(people) if f.other]  # frames in which something else becomes the body
        self.left_out = 0  # points beyond settings.detect.points
        self.names = FeatureNames(body.topology, settings.features)
        named = [(*f.rays.names, *f.pairs.names) for f in people]
        self.feature_capacity = bucket(max(map(len, named), default=0), FEATURE_BUCKETS) if self.names.rows else 0
        seen = Counter(name for names in named for name in names)
        self.choices = self.names.choices(set(seen))
        self.unknown = {name: count for name, count in seen.items() if self.names.look_up(name) is None}
        known = [sum(name not in self.unknown for name in names) for names in named]
        self.features_left_out = sum(max(0, count - self.feature_capacity) for count in known)
        self.parts = PartNames(body.topology) if any(f.part is not None for f in people) else None
        self.table = marker_table(people, self.names)
        few = np.array([len(f.points) < FEW_POINTS for f in people], bool)
        self.featured = few & np.array(known, bool)
        self.by_markers = by_markers(people)
        self.named = few & self.table.enough(ENOUGH)  # frames that named points alone tell of
        if self.by_markers:
            self.capacity, self.sized = 8, True
            self.options = replace(options, by_features=True)

    def anew(self, people: list[BodyObservation]) -> "Runner":
        """The same recording with other points on the body, before its first frame; segments that began in other
        stances may do so again."""
        body, changes = self._given
        other = Runner(body, self.options, people, self.scene, self.settings, changes, self.visit)
        other.stances = self.stances
        return other

    @property
    def offers(self) -> frozenset[str]:
        """What stages may need: "points", "one body" (that does not change on the way), and the body's joints."""
        points = {"points"} if not self.by_markers else set()
        one_body = {"one body"} if not self.settings.changes else set()
        return frozenset({*points, *one_body, *self.body.topology.joints})

    def can_start(self, at: int) -> bool:
        """Whether the frames from `at` on hold something to start from."""
        reach = self.people[at : at + 3 * self.settings.start.frames]
        return self.by_markers or any(len(f.points) >= FEW_POINTS for f in reach)

    def change(self, at: int, state: State | None) -> State | None:
        """Makes the changes of the body that are due before frame `at`; the others' poses stay as they are."""
        due = [change for frame, change in self.pending if frame <= at]
        for change in due:
            before, self.body = self.body, applied(self.body, change)
            self.sized = self.sized or change.scale > 0
            limbs = appeared(before, self.body)
            if state is not None and limbs:
                if isinstance(change.add, Body) and not change.axis:
                    self._look_for(change.add.topology.limbs[0], limbs, at, state)
                spin, velocity = np.array(state.spin), np.array(state.velocity)
                spin[limbs], velocity[limbs] = 0.0, 0.0
                state = state._replace(poses=hung_on(self.body, state.poses, limbs), spin=spin, velocity=velocity)
        if due:
            self.pending = self.pending[len(due) :]
            self.bodies.append((at, self.body))
        return state

    def another(self, at: int) -> None:
        """From frame `at` on the body is something else, of another size."""
        self.sized = False
        self.bodies.append((at, self.body))
        self.others = [k for k in self.others if k > at]

    def _look_for(self, thing: str, limbs: list[int], at: int, state: State) -> None:
        """Lets a held thing point where the first frames from `at` on say it does: trials as at the start."""
        t = self.body.topology
        joint = t.children.index(t.limbs.index(thing))
        bodies = [pointing(self.body, joint, axis) for axis in directions(self.settings.start.directions)]
        starts = [hung_on(b, state.poses, limbs) for b in bodies]
        frames = min(THING_FRAMES * self.settings.start.frames, self.length)
        trial = self.trials(self.body, self.people[at : at + frames], starts)
        self.body = bodies[int(np.argmin(trial.cost))]

    def trials(self, body: Body, frames: list[BodyObservation], starts: list[Poses]) -> Trial:
        """Tracks some frames from every start pose, the last one first."""
        s: StartSettings = self.settings.start
        # backwards in time, so that the trials end where tracking begins
        chunk, features = self._padded(frames[::-1], None)
        if features is not None:
            # what may be face or hand fits any heading and blurs the choice between them
            point, weight = np.asarray(features.point), np.asarray(features.weight)
            weight = np.where(np.all(point == point[..., :1], -1), weight, np.float32(0))
            features = eqx.tree_at(lambda f: f.weight, features, jax.device_put(weight))
        # the interval by which the pull to the prediction is set: loose trials would bend to any heading
        seconds = np.minimum(np.abs(chunk.seconds), np.asarray(self.options.prior_interval))
        seen = np.any(np.asarray(chunk.points.weight)[: s.frames] > 0, 1)

        def tracked(states: State, chosen: np.ndarray, most: int | None) -> tuple[State, Step]:
            options, steps = self.options, self.options.icp.max_steps
            if most is not None:
                steps = jax.device_put(np.minimum(np.asarray(steps), np.int32(most)))
                options = eqx.tree_at(lambda o: o.icp.max_steps, options, steps)
            visit = partial(self._visited, body, options, (chunk.points, seconds, features), chosen, sure=False)
            return in_pieces(visit, states, max(1, min(TRACKS, self.length // max(len(chosen), 1))))

        return run_trials(body, jax.tree.map(lambda *leaves: np.stack(leaves), *starts), seen, tracked)

    def prepare(self) -> None:
        """Makes the program that tracks, or loads it: for frames like those that there are."""
        chunk, features = self._padded(self.people[: self.length], None)
        nobody = at_rest(jax.tree.map(lambda x: x[None], on_host(self.body.rest)))
        measured = chunk.points, chunk.seconds, features
        track_visits.prepare(*self._asked(self.body, self.options, measured, np.arange(1), nobody))

    def _visited(
        self,
        body: Body,
        options: TrackOptions,
        measured: tuple,
        chosen: Int[np.ndarray, " frame"],
        states: State,
        sure: bool = True,
    ) -> tuple[State, Step]:
        """Tracks some of the frames that are `measured` (points, seconds, features; padded) from each of the states
        (leading axis: track); the states after them, and a Step for each (leading axes: track and frame). On the host.
        `sure`: whether covariances are wanted.
        """
        count = len(states.seen)
        after, step = on_host(self.visit(*self._asked(body, options, measured, chosen, states, sure)))
        used = slice(count * len(chosen))
        step = jax.tree.map(lambda x: x[used].reshape(count, len(chosen), *x.shape[1:]), step)
        return jax.tree.map(lambda x: x[:count], after), step

    def _asked(
        self,
        body: Body,
        options: TrackOptions,
        measured: tuple,
        chosen: Int[np.ndarray, " frame"],
        states: State,
        sure: bool = True,
    ) -> tuple:
        """What track_visits takes, always of the same shapes."""
        count = len(states.seen)
        frame, track = np.zeros(self.length, np.int32), np.full(self.length, NOBODY, np.int32)
        used = slice(count * len(chosen))
        frame[used], track[used] = np.tile(chosen, count), np.repeat(np.arange(count), len(chosen))
        full = jax.tree.map(lambda x: np.concatenate([x, np.repeat(x[:1], TRACKS - count, 0)]), on_host(states))
        points, seconds, features = measured
        return body, options, full, points, seconds, Visits(frame, track, np.array(sure)), features

    def chunk(self, state: State, at: int, most: int) -> tuple[State, Step, int]:
        """Tracks up to one chunk of frames from `at`, at most so many, not past the next change of the body, or to
        something else; the number tracked."""
        end = min([at + min(most, self.settings.track.chunk), *(frame for frame, _ in self.pending), *self.others])
        frames = self.people[at:end]
        previous = self.people[at - 1].time_ns if at else None
        state, step, left_out = self._tracked(state, frames, previous)
        self.left_out += left_out
        return state, self._with_named(step, at, len(frames)), len(frames)

    def one(self, state: State, at: int) -> State:
        """The state after frame `at` alone, on the host: no covariances, no features."""
        previous = self.people[at - 1].time_ns if at else None
        chunk, _ = self._padded(self.people[at : at + 1], previous)
        alone = jax.tree.map(lambda x: x[None], on_host(state))
        measured = chunk.points, chunk.seconds, None
        after, _ = self._visited(self.body, self.options, measured, np.arange(1), alone, sure=False)
        return jax.tree.map(lambda x: x[0], after)

    def forwards(self, poses: Poses, first: int, last: int) -> tuple[State, Step]:
        """Tracks frames `first` to `last` - 1, beginning with `poses`; the state after them, and their steps."""
        state, steps = self.through(poses, self.people[first:last])
        return state, self._with_named(steps, first, last - first)

    def backwards(self, poses: Poses, first: int, last: int) -> Step:
        """Tracks frames `first` to `last` - 1, the last one first, beginning with `poses`; steps in order of time."""
        # the same frames as if time ran the other way
        turned = [replace(f, time_ns=-f.time_ns) for f in self.people[first:last][::-1]]
        steps = self.through(poses, turned)[1]
        return self._with_named(jax.tree.map(lambda leaf: leaf[::-1], steps), first, len(turned))

    def through(self, poses: Poses, frames: list[BodyObservation]) -> tuple[State, Step]:
        """The state after any number of frames, begun at rest in `poses` in the first, and a step for each of them."""
        state, steps, length = at_rest(poses), [], self.length
        for at in range(0, len(frames), length):
            previous = frames[at - 1].time_ns if at else None
            state, step, _ = self._tracked(state, frames[at : at + length], previous)
            steps.append(step)
        return state, jax.tree.map(lambda *parts: np.concatenate(parts), *steps)

    def _tracked(self, state: State, frames: list[BodyObservation], previous_ns: int | None) -> tuple[State, Step, int]:
        """The state after the frames, a step for each, and how many points were left out."""
        chunk, features = self._padded(frames, previous_ns)
        measured, alone = (chunk.points, chunk.seconds, features), jax.tree.map(lambda x: x[None], on_host(state))
        found = self._visited(self.body, self.options, measured, np.arange(len(frames)), alone)
        return *jax.tree.map(lambda x: x[0], found), chunk.left_out

    def _padded(self, frames: list[BodyObservation], previous_ns: int | None) -> tuple[Chunk, Features | None]:
        """The frames as the one program takes them."""
        most = self.settings.detect.points
        chunk = pad_frames(frames, self.capacity, self.length, previous_ns, self.sensors, most, self.parts)
        return chunk, pad_features(frames, self.length, self.feature_capacity, self.names, self.choices)

    def _with_named(self, step: Step, at: int, count: int) -> Step:
        """The step with what named points say in frames that have no others."""
        frames = at + np.flatnonzero(self.named[at : at + count])
        if not len(frames):
            return step
        m = self.table.markers
        m = m._replace(points=m.points[frames], seen=m.seen[frames])
        found = explained(self.body, m, step.poses[frames - at])
        share, residual, weight = (np.array(x) for x in (step.explained, step.residual, step.limb_weight))
        share[frames - at], residual[frames - at], weight[frames - at] = found
        return step._replace(explained=share, residual=residual, limb_weight=weight)


def by_markers(people: list[BodyObservation]) -> bool:
    """Whether a recording has named points and no depth at all."""
    return all(len(f.points) < FEW_POINTS for f in people) and any(len(f.pairs.names) >= TO_START for f in people)


def status_of(
    step: Step, lost_explained: float, named: Bool[np.ndarray, " frame"], featured: Bool[np.ndarray, " frame"]
) -> Int8[np.ndarray, " frame"]:
    """Status of each frame; `named` those that named points alone tell of, `featured` those that have some feature."""
    few = (np.asarray(step.points)[: len(named)] < FEW_POINTS) & ~named
    lost = np.asarray(step.explained)[: len(named)] < lost_explained
    status = np.where(lost, Status.LOST, Status.TRACKED)
    return np.where(few, np.where(featured, Status.FEATURES, Status.NO_DATA), status).astype(np.int8)
