"""Tracks a whole recording of depth: starts, tracks in chunks, starts again after the body was lost. Host side."""

import time
from dataclasses import replace
from threading import Thread
from typing import NamedTuple

import jax
import numpy as np

from voodoo_jax.compile.executable import seconds_of_waiting
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.markers.own_sites import Named, with_names
from voodoo_jax.model.attachments import loaded, prepared
from voodoo_jax.records.notes import as_few
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Rays
from voodoo_jax.records.scene import Scene, Subject
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Tracks, scale_confidence
from voodoo_jax.solve.scan import options_from
from voodoo_jax.trackers.base import LogInfo, Task
from voodoo_jax.trackers.icp.confidence import rate_joints
from voodoo_jax.trackers.icp.diagnostics import log_doubts, notes_on
from voodoo_jax.trackers.icp.joint_spread import with_passes
from voodoo_jax.trackers.icp.misfit import Misfit, misfit
from voodoo_jax.trackers.icp.pipeline import FINISH, PLACE, REFINE
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.segment import depths
from voodoo_jax.trackers.icp.sequence import track_whole
from voodoo_jax.trackers.icp.stage import is_active
from voodoo_jax.trackers.shared import eye, report
from voodoo_jax.trackers.shared.runner import FEW_POINTS, spans


def prepare(task: Task) -> list[Thread]:
    """Begins to compile or load, in the threads returned, the programs for a recording of depth, while it is read."""
    if jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        return []  # that may be this thread's alone
    settings, source = task.settings, task.source
    changes = loaded(settings.changes)
    body = prepared(task.body, changes)
    nothing, none = np.zeros((0, 3), np.float32), np.zeros(0, np.int32)
    origins, part = np.zeros((max(1, source.sensors), 3), np.float32), none if source.parts else None
    # most names at once, and each of them: both decide about the program
    each = sorted({name for some in source.names for name in some})
    said = [max(source.names, key=len, default=()), *((name,) for name in each)]
    rays = (Rays(some, *np.zeros((2, len(some), 3), np.float32)) for some in said)
    frames = [BodyObservation(0, nothing, none, origins, each, part=part) for each in rays]
    scene = Scene(Plane(np.array([0, 0, 1], np.float32), 0.0), (), False)
    options = options_from(settings.solve, settings.track, settings.features)
    run = Runner(body, options, frames, scene, settings, changes)
    chunk = report.padded(Segment.blank(0, body.limb_count), settings.track.chunk)
    threads = [Thread(target=run.prepare), Thread(target=report.looked_at.prepare, args=(body, *chunk))]
    threads.append(Thread(target=depths.prepare, args=(body, chunk[0])))
    threads.append(Thread(target=eye.prepare, args=(body,)))
    for thread in threads:
        thread.start()
    return threads


class Unplaced(NamedTuple):
    """A person with final poses, before joint centres are placed (the stages of PLACE)."""

    run: Runner
    tracks: Tracks  # without what is said of joints, and without notes
    named: Named
    notes: tuple[str, ...]  # so far


def track_poses(task: Task, subject: Subject, begin: int = 0) -> Unplaced:
    """Tracks a body through the frames of a person, before `placed` places joint centres. It starts in frame `begin` or
    later, and also tracks backwards from there."""
    began, waited = time.perf_counter(), seconds_of_waiting()
    people, settings, named = with_names(task.body, subject.frames, task.settings)
    enough = np.array([len(f.points) >= 3 * FEW_POINTS for f in people], bool)
    at = int(np.argmax(enough)) if enough.any() else len(people)
    changes = loaded(settings.changes)
    options = options_from(settings.solve, settings.track, settings.features)
    run = Runner(prepared(task.body, changes), options, people, subject.scene, settings, changes, task.visit)
    later = at < begin < len(people) and enough[begin] and settings.looks_ahead("track")
    whole = track_whole(run, begin if later else at, at, enough, REFINE, task.progress)
    for stage in FINISH:
        if is_active(whole.run, stage):
            whole = stage(whole)
    tracks = with_passes(tracks_of(whole.run, whole.segment, task.source))
    compiling = seconds_of_waiting() - waited
    tracks = replace(tracks, seconds=time.perf_counter() - began - compiling, compile_seconds=compiling)
    return Unplaced(whole.run, tracks, named, (*task.source.notes(), *whole.notes))


def placed(person: Unplaced) -> Tracks:
    """Tracks with placed joint centres, rate_joints, and notes."""
    began, run = time.perf_counter(), person.run
    tracks = in_places(run, person.tracks)
    notes = as_few((*person.notes, *notes_on(run, tracks, person.named)))
    return replace(tracks, seconds=tracks.seconds + time.perf_counter() - began, notes=notes)


def finished(run: Runner, segment: Segment, source: LogInfo) -> Tracks:
    """Tracks of a whole recording, see tracks_of, with placed joint centres and rate_joints."""
    return in_places(run, with_passes(tracks_of(run, segment, source)))


def in_places(run: Runner, tracks: Tracks) -> Tracks:
    """Tracks with placed joint centres (the stages of PLACE), and rate_joints with these."""
    for stage in PLACE:
        if is_active(run, stage):
            tracks = stage(run, tracks)
    return with_rating(run, tracks)


def with_rating(run: Runner, tracks: Tracks) -> Tracks:
    """Tracks with the confidence of their joints, and LOST where it is low; doubts about the log lower the confidence
    of all joints, but do not make frames LOST."""
    settings = run.settings
    found = rate_joints(tracks, settings.track.lost_confidence, settings.looks_ahead("track"))
    return scale_confidence(found, log_doubts(run.body, run.scene, run.people, settings).right)


def tracks_of(run: Runner, segment: Segment, source: LogInfo) -> Tracks:
    """Tracks of a whole recording, see shared/report.py, with the misfits of limbs."""
    fit = _misfit(run, segment)  # before poses are moved to the fixed frame: points are where the poses are
    tracks = report.tracks_of(run, segment, source)
    if fit is None:
        return tracks
    return tracks.having(limb_beside=fit.beside, limb_distance=fit.distance, limb_bare=fit.bare, limb_own=fit.own)


def _misfit(run: Runner, segment: Segment) -> Misfit | None:
    """Misfits of limbs and points, which are in the frame of the poses."""
    if not len(segment):
        return None
    found = [
        misfit(body, segment.rotation[first:end], segment.translation[first:end], people)
        for first, end, body in spans(run.bodies, len(segment))
        if (people := run.people[first:end])
    ]
    return Misfit(*map(np.concatenate, zip(*found)))
