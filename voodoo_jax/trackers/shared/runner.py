"""Passes one recording through the compiled programs: chunks of frames, changes of the body. Host side."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Bool, Int

from voodoo_jax.config.options import Change, Settings
from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.kernels.landmarks import Features
from voodoo_jax.markers.table import ENOUGH, TO_START, explained, marker_table
from voodoo_jax.model.attachments import appeared, applied, hung_on
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.solve.names import FeatureNames, PartNames
from voodoo_jax.solve.padding import FEATURE_BUCKETS, Chunk, bucket, pad_features, pad_frames
from voodoo_jax.solve.scan import NOBODY, State, Step, TrackOptions, Visit, Visits, at_rest, track_visits

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


class FrameRunner:
    """Tracks the frames of one person: chunks of frames, with changes of the body between them.

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
        self.sized = False  # whether the body has its size; the first start finds it
        first = people[0].time_ns if people else 0
        stamps = np.array([f.time_ns for f in people], np.int64)
        self.pending = [(int(np.searchsorted(stamps, first + round(c.time * 1e9))), c) for c in changes]
        self.others = [k for k, f in enumerate(people) if f.other]  # frames in which something else becomes the body
        self.doubt = False  # whether its start is in doubt, and nothing later is looked at
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
        self.named = few & self.table.enough(ENOUGH)  # frames that named points alone tell of

    def can_start(self, at: int) -> bool:
        """Whether the frames from `at` on have measurements to start from."""
        return True

    def frames(self, first: int, end: int) -> list[BodyObservation]:
        """Frames `first` to `end` - 1, of which the body is tracked."""
        return self.people[first:end]

    def look_for(self, thing: str, limbs: list[int], at: int, state: State) -> None:
        """Finds the direction of a held object from frame `at` on; unchanged if it is undetermined."""

    def change(self, at: int, state: State | None) -> State | None:
        """Applies the changes of the body that are due before frame `at`; poses of other limbs are unchanged."""
        due = [change for frame, change in self.pending if frame <= at]
        for change in due:
            before, self.body = self.body, applied(self.body, change)
            self.sized = self.sized or change.scale > 0
            limbs = appeared(before, self.body)
            if state is not None and limbs:
                if isinstance(change.add, Body) and not change.axis:
                    self.look_for(change.add.topology.limbs[0], limbs, at, state)
                spin, velocity = np.array(state.spin), np.array(state.velocity)
                spin[limbs], velocity[limbs] = 0.0, 0.0
                state = state._replace(poses=hung_on(self.body, state.poses, limbs), spin=spin, velocity=velocity)
        if due:
            self.pending = self.pending[len(due) :]
            self.bodies.append((at, self.body))
        return state

    def another(self, at: int) -> None:
        """Replaces the body from frame `at` on."""
        self.sized = False
        self.bodies.append((at, self.body))
        self.others = [k for k in self.others if k > at]

    def prepare(self) -> None:
        """Compiles or loads the program for frames like the present ones."""
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

    # 6 parameters: what the program is given
    def _asked(
        self,
        body: Body,
        options: TrackOptions,
        measured: tuple,
        chosen: Int[np.ndarray, " frame"],
        states: State,
        sure: bool = True,
    ) -> tuple:
        """Arguments of track_visits, always of the same shapes."""
        count = len(states.seen)
        frame, track = np.zeros(self.length, np.int32), np.full(self.length, NOBODY, np.int32)
        frames, tracks = np.tile(chosen, count), np.repeat(np.arange(count), len(chosen))
        frame[: len(frames)], track[: len(tracks)] = frames, tracks
        full = jax.tree.map(lambda x: np.concatenate([x, np.repeat(x[:1], TRACKS - count, 0)]), on_host(states))
        points, seconds, features = measured
        return body, options, full, points, seconds, Visits(frame, track, np.array(sure)), features

    def chunk(self, state: State, at: int, most: int) -> tuple[State, Step, int]:
        """Tracks up to one chunk of frames from `at`, at most that many, up to the next change of the body; the number
        tracked."""
        end = min([at + min(most, self.settings.track.chunk), *(frame for frame, _ in self.pending), *self.others])
        frames = self.frames(at, end)
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
        """The frames padded for the compiled program."""
        most = self.settings.detect.points
        chunk = pad_frames(frames, self.capacity, self.length, previous_ns, self.sensors, most, self.parts)
        return chunk, pad_features(frames, self.length, self.feature_capacity, self.names, self.choices)

    def _with_named(self, step: Step, at: int, count: int) -> Step:
        """The step with results of named points in frames that have no others."""
        frames = at + np.flatnonzero(self.named[at : at + count])
        if not len(frames):
            return step
        m = self.table.markers
        m = m._replace(points=m.points[frames], seen=m.seen[frames])
        found = explained(self.body, m, step.poses[frames - at])
        share, residual, weight = (np.array(x) for x in (step.explained, step.residual, step.limb_weight))
        share[frames - at], residual[frames - at], weight[frames - at] = found
        return step._replace(explained=share, residual=residual, limb_weight=weight)


def names_alone(people: list[BodyObservation]) -> bool:
    """Whether a recording has named points and no depth at all."""
    return all(len(f.points) < FEW_POINTS for f in people) and any(len(f.pairs.names) >= TO_START for f in people)
