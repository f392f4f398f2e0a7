"""A whole recording: finds the body, starts, tracks in chunks, starts anew where it was lost. Host side."""

import time
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, islice

import jax
import jax.monitoring
import numpy as np
from jaxtyping import Array, Float, Float32

from voodoo_jax.batch import FeatureNames
from voodoo_jax.beginning import Beginning, begin
from voodoo_jax.body import Body, joint_centres, scaled
from voodoo_jax.changes import loaded, prepared
from voodoo_jax.kernels.plausible import check
from voodoo_jax.marker_exchange import Exchange, jumps, put_right
from voodoo_jax.marker_log import (
    TO_START,
    marker_table,
    sized_by_markers,
    without_gaps,
)
from voodoo_jax.marker_notes import marker_notes
from voodoo_jax.passage import PASSAGE, rows_of, there_and_back
from voodoo_jax.person import PersonFinder, PersonFrame, Scene, find_scene, person_frames, without_furniture
from voodoo_jax.pose import Poses
from voodoo_jax.programs import program
from voodoo_jax.recording import Frame, Recording
from voodoo_jax.session import FEW_POINTS, Session, by_markers, first_run
from voodoo_jax.settings import Settings
from voodoo_jax.start import rest_height
from voodoo_jax.tracking import State, at_rest, options_from
from voodoo_jax.tracks import Status, Tracks
from voodoo_jax.uncertainty import covariances

Progress = Callable[[int], None]
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


@program
def looked_at(
    body: Body, poses: Poses, twist: Float[Array, "frame limb 6 6"]
) -> tuple[Float[Array, "frame centre 3"], dict[str, Array]]:
    """Joint centres of a chunk of frames, how sure they are, and what is not plausible, by names of Tracks' arrays."""
    centres, odd = jax.vmap(lambda some: (joint_centres(body, some), check(body, some)))(poses)
    of_limbs, of_joints = covariances(body, poses, twist)
    return centres, {"beyond_limits": odd.beyond, "depth_inside": odd.depth, "limb_covariance": of_limbs,
                     "joint_covariance": of_joints}  # fmt: skip


def track(
    body: Body, recording: Recording, settings: Settings | None = None, progress: Progress | None = None
) -> Tracks:
    """Tracks a body through a recording; nothing about the person need be known.

    **Arguments:** `body` any body, scaled to what is seen unless `settings.start.scale` says otherwise; `progress` is
    called with the number of frames done since the last call, for each pass (see settings.track.both_ways).

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
    from_markers = by_markers(people)
    if from_markers:
        people = without_gaps(people)
        names = FeatureNames(body.topology, settings.features)
        exchanges = jumps(marker_table(people, names).markers)
        people = put_right(people, exchanges)
        table = marker_table(people, names)
        enough = table.enough(TO_START)
    at = int(np.argmax(enough)) if enough.any() else count
    if at < count and from_markers:
        body, sides = sized_by_markers(body, table.markers, settings.start.scale)
        people, exchanges = put_right(people, sides), exchanges + sides
    changes = loaded(settings.changes)
    body = prepared(body, changes)
    limbs, joint_count = body.limb_count, len(body.topology.joints)
    options = options_from(settings.solve, settings.track, settings.features)
    run = Session(body, options, people, scene, settings, changes)
    if at < count:
        run.prepare()
    out = {
        "rotation": np.full((count, limbs, 4), np.nan, np.float32),
        "translation": np.full((count, limbs, 3), np.nan, np.float32),
        "status": np.full(count, Status.NOT_STARTED, np.int8),
        "residual": np.full(count, np.nan, np.float32),
        "explained": np.zeros(count, np.float32),
        "steps": np.zeros(count, np.int32),
        "points": np.array([len(f.points) for f in people], np.int32),
        "limb_weight": np.zeros((count, limbs), np.float32),
        "cost": np.zeros(count),
        "beyond_limits": np.full((count, joint_count), np.nan, np.float32),
        "depth_inside": np.full((count, limbs), np.nan, np.float32),
        "limb_covariance": np.full((count, limbs, 6, 6), np.nan, np.float32),
        "joint_covariance": np.full((count, len(body.topology.centres), 3, 3), np.nan, np.float32),
    }
    passages: list[tuple[Beginning, slice]] = []  # frames from one start to the next
    patience = settings.track.patience
    state: State | None = None
    before: Poses | None = None  # the last ones before the body was gone
    tried = -1
    if progress is not None:
        progress(at)
    while at < count:
        state = run.change(at, state)
        if state is None and not run.can_start(at):
            out["status"][at], at = Status.NO_DATA, at + 1
            if progress is not None:
                progress(1)
            continue
        if state is None:
            start = begin(run, at, before)
            state = at_rest(start.poses)
            passages.append((start, slice(at, at)))
        after, step, taken = run.chunk(state, at)
        rows = rows_of(run, step, at, taken)
        # gone or lost for long: stop here and look anew
        gone = first_run(rows["status"] == Status.NO_DATA, patience)
        lost = first_run(rows["status"] == Status.LOST, patience) if tried < at else taken
        keep = min(gone, lost + patience if lost < taken else taken, taken)
        for name, row in rows.items():
            out[name][at : at + keep] = row[:keep]
        passages[-1] = passages[-1][0], slice(passages[-1][1].start, at + keep)
        at += keep
        state = after
        if keep < taken:
            state = before = None
            if gone == keep:
                before = jax.tree.map(lambda leaf, k=gone: leaf[k - 1], step.poses) if gone else None
                later = np.flatnonzero(enough[at:])
                skip = int(later[0]) if len(later) else count - at
                out["status"][at : at + skip] = Status.NO_DATA
                at, keep = at + skip, keep + skip
            tried = at + patience
        if progress is not None:
            progress(keep)
    if settings.track.both_ways and not run.by_markers and not settings.changes:
        for start, span in passages:
            for name, row in there_and_back(run, start, {name: out[name][span] for name in PASSAGE}).items():
                out[name][span] = row
            if progress is not None:
                progress(span.stop - span.start)
    del out["cost"]
    out["residual"][out["status"] == Status.NO_DATA] = np.nan
    joints = np.full((count, len(run.body.topology.centres), 3), np.nan, np.float32)
    for (first, body), end in zip(run.bodies, [*(at for at, _ in run.bodies[1:]), count]):
        absent = ~np.asarray(body.present)
        for name in ("rotation", "translation", "limb_covariance"):
            out[name][first:end, absent] = np.nan
        _look_at(body, out, joints, first, end, settings.track.chunk)
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


def _look_at(body: Body, out: dict[str, np.ndarray], joints: np.ndarray, first: int, end: int, chunk: int) -> None:
    """Fills in joints of some frames with one body, how sure they are, and what is not plausible about the poses."""
    for at in range(first, end, chunk):
        span = slice(at, min(at + chunk, end))
        count = span.stop - at
        pad = ((0, chunk - count), (0, 0), (0, 0))  # one program for every length
        poses = Poses(np.pad(out["rotation"][span], pad), np.pad(out["translation"][span], pad))
        centres, seen = looked_at(body, poses, jax.device_put(np.pad(out["limb_covariance"][span], (*pad, (0, 0)))))
        joints[span] = np.asarray(centres)[:count]
        there = np.any(np.isfinite(out["translation"][span]), (1, 2))
        for name, found in seen.items():
            found = np.asarray(found)[:count]
            out[name][span] = np.where(there.reshape(-1, *[1] * (found.ndim - 1)), found, np.nan)


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


def _notes(run: Session, out: dict[str, np.ndarray], exchanges: list[Exchange]) -> tuple[str, ...]:
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
    for name, count in run.unknown.items():
        notes.append(f"Feature '{name}' was not used ({count} times): features.names gives it no point of this body.")
    if run.parts is not None and run.parts.unknown:
        names = ", ".join(sorted(run.parts.unknown))
        notes.append(f"The body has no limb {names}: points assigned to it count as on the body, on whichever limb.")
    for _, change in run.pending:
        notes.append(f"The change at {change.time:g} s comes after the last frame: not made.")
    if run.settings.changes and run.settings.track.both_ways:
        notes.append("The body changes on the way, so it was tracked forwards only.")
    if run.features_left_out:
        notes.append(f"{run.features_left_out} features were left out: more in a frame than there is room for.")
    return tuple(notes)
