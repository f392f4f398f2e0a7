"""Tracks a recording of named points alone: estimates the person's sizes and the place of each point on the body, then
the poses frame by frame. Host side."""

import time
from dataclasses import replace
from threading import Thread
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float32

from voodoo_jax.compile.executable import seconds_of_waiting
from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.markers.diagnostics import FEW, MIRRORED, marker_notes, name_notes, residuals
from voodoo_jax.markers.label_swaps import Exchange, jumps, put_right
from voodoo_jax.markers.own_sites import (
    Named,
    apart_by_names,
    with_names,
    with_own_names,
    with_own_sites,
    without_own_sites,
)
from voodoo_jax.markers.table import TO_START, marker_start, marker_table, sized_by_markers, without_gaps
from voodoo_jax.markers.upward import with_upward
from voodoo_jax.model.attachments import loaded, prepared
from voodoo_jax.model.body import Body
from voodoo_jax.records.notes import as_few
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Subject
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Tracks, scale_confidence
from voodoo_jax.solve.names import FeatureNames
from voodoo_jax.solve.scan import options_from
from voodoo_jax.trackers.base import Task
from voodoo_jax.trackers.shared import report
from voodoo_jax.trackers.shared.confidence import UNMARKED, joint_confidence
from voodoo_jax.trackers.shared.notes import implausible
from voodoo_jax.trackers.shared.runner import FrameRunner
from voodoo_jax.trackers.shared.segment import Followed
from voodoo_jax.trackers.shared.sequence import KnownStart, Method, follow

# share of logs with left and right exchanged in all names, not in the coordinates, as left-handed ones have; by hand
MISNAMED = 0.2


def prepare(task: Task) -> list[Thread]:
    """Begins to compile or load the programs that follow after the poses, in the returned thread, while the log is
    read. The program that finds the poses depends on the names."""
    if jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        return []  # that may be this thread's alone
    body = with_own_sites(prepared(task.body, loaded(task.settings.changes)), {})[0]
    chunk = report.padded(Segment.blank(0, body.limb_count), task.settings.track.chunk)
    thread = Thread(target=report.looked_at.prepare, args=(body, *chunk))
    thread.start()
    return [thread]


class MarkerRunner(FrameRunner):
    """Tracks one recording's named points."""

    def __init__(self, *given: Any, **named: Any):
        super().__init__(*given, **named)
        self.capacity, self.sized = 8, True  # of no points at all: the least room that the program has
        self.options = replace(self.options, by_features=True)


class FromMarkers(Method):
    """Segments begin with the pose of the nearest frame that has enough named points; there are no refinements."""

    def begin(self, run: FrameRunner, at: int, before: Poses | None) -> KnownStart:
        good = np.flatnonzero(run.table.enough(TO_START))
        frame = int(good[np.argmin(np.abs(good - at))])
        return KnownStart(at, marker_start(run.body, run.table.markers, frame))


class Sized(NamedTuple):
    """A recording with corrected names, and a body of the person's sizes that has a site for each name."""

    body: Body
    people: list[BodyObservation]
    settings: Settings
    named: Named
    exchanges: list[Exchange]  # put right, for a time each
    mirrored: bool  # left and right of all names were exchanged


def sized(task: Task, frames: list[BodyObservation]) -> Sized:
    """Removes gaps from frames, corrects exchanged names, and fits sizes and places of the points to some frames."""
    people, settings, named = with_names(task.body, frames, task.settings)
    people = without_gaps(people)
    body, own = with_own_sites(task.body, named.known.places)
    settings = replace(settings, features=with_own_names(settings.features, own))
    names = FeatureNames(body.topology, settings.features)
    exchanges = jumps(marker_table(people, names).markers)
    people = put_right(people, exchanges)
    table = marker_table(people, names)
    if not table.enough(TO_START).any():
        return Sized(body, people, settings, named, exchanges, False)
    spots = tuple(named.known.places.get(n, "") for n in table.markers.names)
    markers = table.markers._replace(places=spots, newington=named.known.newington)
    body, sides, mirrored = sized_by_markers(body, markers, settings.start.scale)
    return Sized(body, put_right(people, sides), settings, named, exchanges + ([] if mirrored else sides), mirrored)


def track_named(task: Task, subject: Subject) -> Tracks:
    """Tracks a body through named points that belong to one person."""
    began, waited = time.perf_counter(), seconds_of_waiting()
    body, people, settings, named, exchanges, mirrored = sized(task, subject.frames)
    changes = loaded(settings.changes)
    options = options_from(settings.solve, settings.track, settings.features)
    run = MarkerRunner(prepared(body, changes), options, people, subject.scene, settings, changes, task.visit)
    enough = run.table.enough(TO_START)
    at = int(np.argmax(enough)) if enough.any() else len(people)
    segment = Followed.blank(len(people), run.body.limb_count)
    follow(run, at, enough, segment, FromMarkers(), task.progress)
    tracks = report.tracks_of(run, segment, task.source)
    poses = Poses(tracks.rotation, tracks.translation)
    found = residuals(run.body, run.table.markers, poses, tracks.tracked)
    tracks = replace(tracks, body=without_own_sites(tracks.body), marker_residual=found)
    tracks = replace(tracks, joint_confidence=marker_confidence(tracks, settings.looks_ahead("track")))
    tracks = scale_confidence(tracks, MISNAMED if mirrored and not settings.read.mirror else 1.0)
    notes = [*task.source.notes(), *implausible(tracks), *name_notes(named)]
    notes += [] if enough.any() else [FEW]
    notes += [MIRRORED] if mirrored else []
    notes += marker_notes(run.body, run.table, poses, tracks.time_ns, tracks.tracked, exchanges)
    compiling = seconds_of_waiting() - waited
    spent = time.perf_counter() - began - compiling
    return replace(tracks, seconds=spent, compile_seconds=compiling, notes=as_few(notes))


def marker_confidence(tracks: Tracks, ahead: bool = True) -> Float32[np.ndarray, "frame joint"]:
    """As joint_confidence, for recordings of named points alone, whose `limb_weight` is the number of points near their
    places on each limb. It makes no frame LOST: a set for legs alone gives no reason to doubt the whole.

    The logistic function was fitted to depth, and overestimates limbs without points: the confidence of a joint whose
    own limb has none in the frame is at most UNMARKED, even if a neighbour's markers hold it.
    """
    found = joint_confidence(tracks, ahead)
    unmarked = tracks.evidence.limb_weight[:, np.array(tracks.body.topology.centre_limbs, int)] <= 0
    # not np.fmin: where there is none, there is none
    return np.where(unmarked, np.minimum(found, np.float32(UNMARKED)), found)


def track_all_named(task: Task, people: list[Subject]) -> list[Tracks]:
    """Tracks of all people that the names distinguish, at most as many as the settings allow."""
    settings, source = task.settings, task.source
    if settings.detect.people != 1:
        people = apart_by_names(people[0], task.body.topology, settings.features)[: settings.detect.people or None]
    several = sum(bool(one.name) for one in people)
    each = task.progress and (lambda count, tell=task.progress: tell(count / len(people)))
    tracks = []
    for one in people:
        whose = [f"Named points of {several} people: these tracks are of '{one.name}'."] if one.name else []
        own = replace(task, progress=each, source=source.noted(*whose))
        tracks.append(replace(track_named(own, one), person=one.number, people=len(people)))
    return tracks if source.up_is_given else with_upward(tracks, source.up)
