"""A whole recording: finds the body, starts, tracks in chunks, starts anew where it was lost. Host side."""

import time
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, islice

import equinox as eqx
import jax
import jax.monitoring
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float32

from voodoo_jax.batch import FEATURE_BUCKETS, FeatureNames, PartNames, bucket, pad_features, pad_frames
from voodoo_jax.body import Body, joint_centres, scaled
from voodoo_jax.changes import appeared, applied, directions, hung_on, loaded, pointing, prepared
from voodoo_jax.kernels.plausible import check
from voodoo_jax.marker_exchange import Exchange, jumps, put_right
from voodoo_jax.marker_log import (
    ENOUGH,
    TO_START,
    explained,
    marker_start,
    marker_table,
    sized_by_markers,
    without_gaps,
)
from voodoo_jax.marker_notes import marker_notes
from voodoo_jax.person import PersonFinder, PersonFrame, Scene, find_scene, person_frames, without_furniture
from voodoo_jax.pose import Poses
from voodoo_jax.recording import Frame, Recording
from voodoo_jax.settings import Settings, StartSettings
from voodoo_jax.start import Trial, rest_height, run_trials, sized, standing_places
from voodoo_jax.tracking import State, Step, TrackOptions, at_rest, options_from, track_chunk
from voodoo_jax.tracks import Status, Tracks

Progress = Callable[[int], None]
FEW_POINTS = 20  # fewer on the body: nothing to track by
FAR_BEYOND, DEEP = 20.0, 0.04  # degrees beyond a joint's limit, metres inside another limb: worth a note
SCENE_FRAMES = 15  # floor and walls are looked for in every third of so many first frames


def find_person(
    frames: Iterable[Frame], up: Float32[np.ndarray, "3"], body: Body, settings: Settings
) -> tuple[Scene, list[PersonFrame]]:
    """Floor and walls, and the body's points of every frame. Of the frames, taken one by one, only these are kept."""
    stream: Iterator[Frame] = iter(frames)
    first = list(islice(stream, SCENE_FRAMES))
    scene = find_scene(first[::3], up, up_is_sure=bool(up[2] > 0.99))
    scale = settings.start.scale
    # a body's scale need not be its height
    height = rest_height(scaled(body, scale) if scale > 0 else body)
    finder = PersonFinder(scene, height, settings.person)
    people = list(person_frames(chain(first, stream), finder))
    return scene, without_furniture(people, scene.floor.normal)


_compiling = [0.0]


def _count_compiling(event: str, duration_secs: float, **_: str | int) -> None:
    if event.startswith("/jax/core/compile/"):
        _compiling[0] += duration_secs


jax.monitoring.register_event_duration_secs_listener(_count_compiling)


def _compile_clock() -> float:
    """Seconds that jax has spent on tracing and compiling in this process."""
    return _compiling[0]


class _Run:
    """Tracks one recording's person frames with one body."""

    def __init__(self, body: Body, options: TrackOptions, people: list[PersonFrame], scene: Scene, settings: Settings):
        self.body, self.options, self.people, self.scene, self.settings = body, options, people, scene, settings
        self.sensors = len(people[0].origins) if people else 1
        self.capacity = bucket(settings.person.points)
        self.bodies = [(0, body)]  # first frame from which on the body is so
        first = people[0].time_ns if people else 0
        stamps = np.array([f.time_ns for f in people], np.int64)
        changes = loaded(settings.changes)
        self.pending = [(int(np.searchsorted(stamps, first + round(c.time * 1e9))), c) for c in changes]
        self.left_out = 0  # points beyond settings.person.points
        self.names = FeatureNames(body.topology, settings.features)
        most = max((len(f.rays.names) + len(f.pairs.names) for f in people), default=0)
        self.feature_capacity = bucket(most, FEATURE_BUCKETS)
        self.choices = self.names.choices({name for f in people for name in (*f.rays.names, *f.pairs.names)})
        self.parts = PartNames(body.topology) if any(f.part is not None for f in people) else None
        self.table = marker_table(people, self.names)
        few = np.array([len(f.points) < FEW_POINTS for f in people], bool)
        self.featured = few & np.array([bool(f.rays.names or f.pairs.names) for f in people], bool)
        self.by_markers = _by_markers(people)
        self.named = few & self.table.enough(ENOUGH)  # frames that named points alone tell of
        if self.by_markers:
            self.capacity = 8

    def start(self, at: int) -> State:
        """State after the best trial from frame `at`; by markers alone at the nearest frame that has enough of them."""
        if self.by_markers:
            good = np.flatnonzero(self.table.enough(TO_START))
            frame = int(good[np.argmin(np.abs(good - at))])
            return at_rest(marker_start(self.body, self.table.markers, frame))
        s: StartSettings = self.settings.start
        frames = [f for f in self.people[at : at + 3 * s.frames] if len(f.points) >= FEW_POINTS][: s.frames]
        places = standing_places(self.body, frames[::-1], self.scene.floor, s.headings)
        starts = jax.tree.map(lambda *leaves: jnp.stack(leaves), *places)
        trial = self._trials(frames, starts)
        best = int(np.argmin(np.asarray(trial.cost)))
        return at_rest(jax.tree.map(lambda leaf: leaf[best], trial.state.poses))

    def change(self, at: int, state: State | None) -> State | None:
        """Makes the changes of the body that are due before frame `at`; the others' poses stay as they are."""
        due = [change for frame, change in self.pending if frame <= at]
        for change in due:
            before, self.body = self.body, applied(self.body, change)
            limbs = appeared(before, self.body)
            if state is not None and limbs:
                if isinstance(change.add, Body) and not change.axis:
                    self._look_for(change.add.topology.limbs[0], limbs, at, state)
                rows = jnp.array(limbs, int)
                spin, velocity = state.spin.at[rows].set(0.0), state.velocity.at[rows].set(0.0)
                state = State(hung_on(self.body, state.poses, limbs), spin, velocity)
        if due:
            self.pending = self.pending[len(due) :]
            self.bodies.append((at, self.body))
        return state

    def _look_for(self, thing: str, limbs: list[int], at: int, state: State) -> None:
        """Lets a held thing point where the first frames from `at` on say it does: trials as at the start."""
        t = self.body.topology
        joint = t.children.index(t.limbs.index(thing))
        bodies = [pointing(self.body, joint, axis) for axis in directions(self.settings.start.directions)]
        starts = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(hung_on(b, state.poses, limbs) for b in bodies))
        trial = self._trials(self.people[at : at + self.settings.start.frames], starts)
        self.body = bodies[int(np.argmin(np.asarray(trial.cost)))]

    def _trials(self, frames: list[PersonFrame], starts: Poses) -> Trial:
        """Tracks some frames from every start pose (leading axis), the last one first."""
        s: StartSettings = self.settings.start
        # backwards in time, so that the trials end where tracking begins
        frames = frames[::-1]
        chunk = pad_frames(frames, self.capacity, s.frames, None, self.sensors, self.settings.person.points, self.parts)
        features = pad_features(frames, s.frames, self.feature_capacity, self.names, self.choices)
        if features is not None:
            # what may be face or hand fits any heading and blurs the choice between them
            sure = jnp.all(features.point == features.point[..., :1], -1)
            features = eqx.tree_at(lambda f: f.weight, features, jnp.where(sure, features.weight, 0.0))
        # the interval by which the pull to the prediction is set: loose trials would bend to any heading
        seconds = jnp.minimum(jnp.abs(chunk.seconds), self.options.prior_interval)
        return run_trials(self.body, self.options, starts, chunk.points, seconds, features)

    def chunk(self, state: State, at: int) -> tuple[State, Step, int]:
        """Tracks up to one chunk of frames from `at`, not past the next change of the body; the number tracked."""
        length = self.settings.track.chunk
        end = min([at + length, *(frame for frame, _ in self.pending)])
        frames = self.people[at:end]
        previous = self.people[at - 1].time_ns if at else None
        padded = pad_frames(
            frames, self.capacity, length, previous, self.sensors, self.settings.person.points, self.parts
        )
        seconds, valid = jnp.asarray(padded.seconds), jnp.asarray(padded.valid)
        features = pad_features(frames, length, self.feature_capacity, self.names, self.choices)
        self.left_out += padded.left_out
        state, step = track_chunk(self.body, self.options, state, padded.points, seconds, valid, features)
        return state, self._with_named(jax.tree.map(np.asarray, step), at, len(frames)), len(frames)

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


def _by_markers(people: list[PersonFrame]) -> bool:
    """Whether a recording has named points and no depth at all."""
    return all(len(f.points) < FEW_POINTS for f in people) and any(len(f.pairs.names) >= TO_START for f in people)


# one frame's check for a chunk of frames
check_poses = eqx.filter_jit(eqx.filter_vmap(check, in_axes=(None, 0)))


def _status(step: Step, lost_explained: float, named: np.ndarray, featured: np.ndarray) -> np.ndarray:
    """Status of each frame; `named` those that named points alone tell of, `featured` those that have some feature."""
    few = (np.asarray(step.points)[: len(named)] < FEW_POINTS) & ~named
    lost = np.asarray(step.explained)[: len(named)] < lost_explained
    status = np.where(lost, Status.LOST, Status.TRACKED)
    return np.where(few, np.where(featured, Status.FEATURES, Status.NO_DATA), status).astype(np.int8)


def _first_run(mask: np.ndarray, length: int) -> int:
    """Index of the first run of `length` True, or the array's length."""
    if len(mask) < length:
        return len(mask)
    full = np.convolve(mask, np.ones(length, int), "valid") == length
    return int(np.argmax(full)) if full.any() else len(mask)


def track(
    body: Body, recording: Recording, settings: Settings | None = None, progress: Progress | None = None
) -> Tracks:
    """Tracks a body through a recording; nothing about the person need be known.

    **Arguments:** `body` any body, scaled to what is seen unless `settings.start.scale` says otherwise; `progress` is
    called with the number of frames done since the last call.

    **Returns:** Tracks in the recording's fixed frame, one row per frame of the recording.
    """
    settings = settings or Settings()
    scene, people = find_person(recording, recording.up, body, settings)
    return track_person(body, scene, people, settings, recording.path, recording.fixed_frame, recording.notes, progress)


def track_person(
    body: Body,
    scene: Scene,
    people: list[PersonFrame],
    settings: Settings,
    source: str,
    fixed_frame: str,
    notes: tuple[str, ...] = (),
    progress: Progress | None = None,
) -> Tracks:
    """Tracks a body through frames in which it was already told apart from its surroundings (see find_person)."""
    began, compiled = time.perf_counter(), _compile_clock()
    count = len(people)
    enough = np.array([len(f.points) >= 3 * FEW_POINTS for f in people], bool)
    exchanges: list[Exchange] = []
    if _by_markers(people):
        people = without_gaps(people)
        names = FeatureNames(body.topology, settings.features)
        exchanges = jumps(marker_table(people, names).markers)
        people = put_right(people, exchanges)
        table = marker_table(people, names)
        enough = table.enough(TO_START)
    at = int(np.argmax(enough)) if enough.any() else count
    if at < count and _by_markers(people):
        body, sides = sized_by_markers(body, table.markers, settings.start.scale)
        people, exchanges = put_right(people, sides), exchanges + sides
    else:
        body = sized(body, people[at : at + settings.start.size_frames], scene.floor, settings.start)
    body = prepared(body, loaded(settings.changes))
    limbs, joint_count = body.limb_count, len(body.topology.joints)
    run = _Run(body, options_from(settings.solve, settings.track, settings.features), people, scene, settings)
    out = {
        "rotation": np.full((count, limbs, 4), np.nan, np.float32),
        "translation": np.full((count, limbs, 3), np.nan, np.float32),
        "status": np.full(count, Status.NOT_STARTED, np.int8),
        "residual": np.full(count, np.nan, np.float32),
        "explained": np.zeros(count, np.float32),
        "steps": np.zeros(count, np.int32),
        "points": np.array([len(f.points) for f in people], np.int32),
        "limb_weight": np.zeros((count, limbs), np.float32),
        "beyond_limits": np.full((count, joint_count), np.nan, np.float32),
        "depth_inside": np.full((count, limbs), np.nan, np.float32),
    }
    patience = settings.track.patience
    state: State | None = None
    tried = -1
    if progress is not None:
        progress(at)
    while at < count:
        state = run.change(at, state)
        if state is None:
            state = run.start(at)
        after, step, taken = run.chunk(state, at)
        these = slice(at, at + taken)
        status = _status(step, settings.track.lost_explained, run.named[these], run.featured[these])
        # gone or lost for long: stop here and look anew
        gone = _first_run(status == Status.NO_DATA, patience)
        lost = _first_run(status == Status.LOST, patience) if tried < at else taken
        keep = min(gone, lost + patience if lost < taken else taken, taken)
        span = slice(at, at + keep)
        out["rotation"][span] = step.poses.rotation[:keep]
        out["translation"][span] = step.poses.translation[:keep]
        out["status"][span] = status[:keep]
        odd = check_poses(run.body, step.poses)
        out["beyond_limits"][span], out["depth_inside"][span] = odd.beyond[:keep], odd.depth[:keep]
        absent = ~np.asarray(run.body.present)
        out["rotation"][span, absent], out["translation"][span, absent] = np.nan, np.nan
        for name in ("residual", "explained", "steps", "limb_weight"):
            out[name][span] = getattr(step, name)[:keep]
        at += keep
        state = after
        if keep < taken:
            if gone == keep:
                later = np.flatnonzero(enough[at:])
                skip = int(later[0]) if len(later) else count - at
                out["status"][at : at + skip] = Status.NO_DATA
                at, keep, state = at + skip, keep + skip, None
            else:
                state = None
            tried = at + patience
        if progress is not None:
            progress(keep)
    out["residual"][out["status"] == Status.NO_DATA] = np.nan
    joints = np.full((count, len(run.body.topology.centres), 3), np.nan, np.float32)
    centres = jax.jit(jax.vmap(joint_centres, (None, 0)))
    for (first, body), end in zip(run.bodies, [*(at for at, _ in run.bodies[1:]), count]):
        poses = Poses(jnp.asarray(out["rotation"][first:end]), jnp.asarray(out["translation"][first:end]))
        joints[first:end] = centres(body, poses) if end > first else 0.0
    compiling = _compile_clock() - compiled
    seconds = time.perf_counter() - began - compiling
    stamps = np.array([f.time_ns for f in people], np.int64)
    return Tracks(
        source,
        fixed_frame,
        run.body,
        stamps,
        joints=joints,
        seconds=seconds,
        compile_seconds=compiling,
        notes=tuple(notes) + _notes(run, out, exchanges),
        **out,
    )


def _implausible(body: Body, out: dict[str, np.ndarray]) -> list[str]:
    """Sentences on joints beyond their limits and limbs in each other, where they are so in many tracked frames."""
    notes, tracked = [], out["status"] == Status.TRACKED
    for what, names, found, most in (
        (f"bent more than {FAR_BEYOND:.0f} degrees beyond their limits", body.topology.joints,
         np.degrees(out["beyond_limits"]), FAR_BEYOND),
        (f"more than {100 * DEEP:.0f} cm inside other limbs", body.topology.limbs, out["depth_inside"], DEEP),
    ):  # fmt: skip
        with np.errstate(invalid="ignore"):
            share = (found[tracked] > most).mean(0) if tracked.any() else np.zeros(len(names))
        often = [f"{names[k]} ({100 * share[k]:.0f} %)" for k in np.argsort(-share) if share[k] > 0.05]
        if often:
            notes.append(f"Not plausible, {what} (share of the frames): {', '.join(often)}.")
    return notes


def _notes(run: _Run, out: dict[str, np.ndarray], exchanges: list[Exchange]) -> tuple[str, ...]:
    notes = _implausible(run.body, out)
    if run.by_markers:
        poses, stamps = Poses(out["rotation"], out["translation"]), np.array([f.time_ns for f in run.people], np.int64)
        tracked = out["status"] == Status.TRACKED
        if not run.table.enough(TO_START).any():
            notes.append(f"No frame has {TO_START} markers that features.names knows a point of this body for.")
        return (*notes, *marker_notes(run.body, run.table, poses, stamps, tracked, exchanges))
    if not run.scene.floor_seen:
        notes.append("No floor was seen: its height was taken from the fixed frame or from the lowest points.")
    if len(out["status"]) and np.all(out["status"] == Status.NOT_STARTED):
        notes.append("Nothing of the body's height was found: not one frame is tracked.")
    total = int(out["points"].sum())
    if run.left_out:
        share, most = 100 * run.left_out / total, run.settings.person.points
        notes.append(f"{share:.0f} % of the body's points were thinned out (person.points = {most} per frame).")
    for name, count in run.names.unknown.items():
        notes.append(f"Feature '{name}' was not used ({count} times): features.names gives it no point of this body.")
    if run.names.left_out:
        notes.append(f"{run.names.left_out} features were left out: more in a frame than there is room for.")
    return tuple(notes)
