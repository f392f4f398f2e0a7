"""A whole recording: finds the body, starts, tracks in chunks, starts anew where it was lost. Host side."""

import time
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, islice

import jax
import jax.monitoring
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float32

from voodoo_jax.batch import FEATURE_BUCKETS, FeatureNames, bucket, pad_features, pad_frames
from voodoo_jax.body import Body, joint_centres, scaled
from voodoo_jax.person import PersonFinder, PersonFrame, Scene, find_scene, person_frames, without_furniture
from voodoo_jax.pose import Poses
from voodoo_jax.recording import Frame, Recording
from voodoo_jax.settings import Settings, StartSettings
from voodoo_jax.start import rest_height, run_trials, sized, standing_places
from voodoo_jax.tracking import State, Step, TrackOptions, at_rest, options_from, track_chunk
from voodoo_jax.tracks import Status, Tracks

Progress = Callable[[int], None]
FEW_POINTS = 20  # fewer on the body: nothing to track by
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
        self.left_out = 0  # points beyond settings.person.points
        self.names = FeatureNames(body.topology, settings.features)
        most = max((len(f.rays.names) + len(f.pairs.names) for f in people), default=0)
        self.feature_capacity = bucket(most, FEATURE_BUCKETS)

    def start(self, at: int) -> State:
        """State after the best trial from frame `at`."""
        s: StartSettings = self.settings.start
        frames = [f for f in self.people[at : at + 3 * s.frames] if len(f.points) >= FEW_POINTS][: s.frames]
        # backwards in time, so that the trials end where tracking begins
        frames = frames[::-1]
        chunk = pad_frames(frames, self.capacity, s.frames, None, self.sensors, self.settings.person.points)
        places = standing_places(self.body, frames, self.scene.floor, s.headings)
        starts = jax.tree.map(lambda *leaves: jnp.stack(leaves), *places)
        features = pad_features(frames, s.frames, self.feature_capacity, self.names)
        # the interval by which the pull to the prediction is set: loose trials would bend to any heading
        seconds = jnp.minimum(jnp.abs(chunk.seconds), self.options.prior_interval)
        trial = run_trials(self.body, self.options, starts, chunk.points, seconds, features)
        best = int(np.argmin(np.asarray(trial.cost)))
        return at_rest(jax.tree.map(lambda leaf: leaf[best], trial.state.poses))

    def chunk(self, state: State, at: int) -> tuple[State, Step, int]:
        """Tracks up to one chunk of frames from `at`; the number tracked."""
        length = self.settings.track.chunk
        frames = self.people[at : at + length]
        previous = self.people[at - 1].time_ns if at else None
        padded = pad_frames(frames, self.capacity, length, previous, self.sensors, self.settings.person.points)
        seconds, valid = jnp.asarray(padded.seconds), jnp.asarray(padded.valid)
        features = pad_features(frames, length, self.feature_capacity, self.names)
        self.left_out += padded.left_out
        state, step = track_chunk(self.body, self.options, state, padded.points, seconds, valid, features)
        return state, jax.tree.map(np.asarray, step), len(frames)


def _status(step: Step, lost_explained: float) -> np.ndarray:
    """Status of each frame of a chunk."""
    few = np.asarray(step.points) < FEW_POINTS
    lost = np.asarray(step.explained) < lost_explained
    return np.where(few, Status.NO_DATA, np.where(lost, Status.LOST, Status.TRACKED)).astype(np.int8)


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
    count, limbs = len(people), body.limb_count
    enough = np.array([len(f.points) >= 3 * FEW_POINTS for f in people], bool)
    at = int(np.argmax(enough)) if enough.any() else count
    body = sized(body, people[at : at + settings.start.size_frames], scene.floor, settings.start)
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
    }
    patience = settings.track.patience
    state: State | None = None
    tried = -1
    if progress is not None:
        progress(at)
    while at < count:
        if state is None:
            state = run.start(at)
        after, step, taken = run.chunk(state, at)
        status = _status(step, settings.track.lost_explained)[:taken]
        # gone or lost for long: stop here and look anew
        gone = _first_run(status == Status.NO_DATA, patience)
        lost = _first_run(status == Status.LOST, patience) if tried < at else taken
        keep = min(gone, lost + patience if lost < taken else taken, taken)
        span = slice(at, at + keep)
        out["rotation"][span] = step.poses.rotation[:keep]
        out["translation"][span] = step.poses.translation[:keep]
        out["status"][span] = status[:keep]
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
    poses = Poses(jnp.asarray(out["rotation"]), jnp.asarray(out["translation"]))
    joints = np.asarray(jax.jit(jax.vmap(joint_centres, (None, 0)))(body, poses)) if count else np.zeros((0, 0, 3))
    joints = joints.reshape(count, len(body.topology.centres), 3).astype(np.float32)
    compiling = _compile_clock() - compiled
    seconds = time.perf_counter() - began - compiling
    stamps = np.array([f.time_ns for f in people], np.int64)
    return Tracks(
        source,
        fixed_frame,
        body,
        stamps,
        joints=joints,
        seconds=seconds,
        compile_seconds=compiling,
        notes=tuple(notes) + _notes(run, out),
        **out,
    )


def _notes(run: _Run, out: dict[str, np.ndarray]) -> tuple[str, ...]:
    notes = []
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
