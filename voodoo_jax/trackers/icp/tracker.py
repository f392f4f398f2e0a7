"""A whole recording: finds the body, starts, tracks in chunks, starts anew where it was lost. Host side."""

import time
from dataclasses import replace
from threading import Thread
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Float32, Float64

from voodoo_jax.compile.executable import program, seconds_of_waiting
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.camera_motion import to_fixed
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.kernels.joint_limits import check
from voodoo_jax.markers.diagnostics import residuals
from voodoo_jax.markers.label_swaps import Exchange, jumps, put_right
from voodoo_jax.markers.own_sites import (
    Named,
    named_subject,
    of_subject,
    told,
    with_own_names,
    with_own_sites,
    without_own_sites,
)
from voodoo_jax.markers.table import TO_START, marker_table, sized_by_markers, without_gaps
from voodoo_jax.model.attachments import loaded, prepared
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.records.notes import as_few
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Rays
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Status, Tracks, only_as_sure
from voodoo_jax.solve.covariance import covariances
from voodoo_jax.solve.names import FeatureNames
from voodoo_jax.solve.scan import Visit, options_from
from voodoo_jax.trackers.icp.confidence import rated
from voodoo_jax.trackers.icp.diagnostics import notes_on
from voodoo_jax.trackers.icp.joint_spread import with_passes
from voodoo_jax.trackers.icp.log_doubts import log_doubts
from voodoo_jax.trackers.icp.misfit import Misfit, misfit
from voodoo_jax.trackers.icp.pipeline import FINISH, PLACE, REFINE
from voodoo_jax.trackers.icp.refine.stage import is_active
from voodoo_jax.trackers.icp.runner import FEW_POINTS, Runner, by_markers, spans
from voodoo_jax.trackers.icp.segment import depths
from voodoo_jax.trackers.icp.sequence import Progress, track_whole


def prepare(body: Body, settings: Settings, sensors: int, names: set[tuple[str, ...]], parts: bool) -> list[Thread]:
    """Begins to compile or load, in the threads returned, what recordings of so many depth sensors are tracked with:
    while they are read. `names` of the features that frames have at once; `parts`: whether points have limbs assigned.
    """
    if jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        return []  # that may be this thread's alone
    changes = loaded(settings.changes)
    body = prepared(body, changes)
    nothing, none = np.zeros((0, 3), np.float32), np.zeros(0, np.int32)
    origins, part = np.zeros((max(1, sensors), 3), np.float32), none if parts else None
    # most names at once, and each of them: both decide about the program
    said = [max(names, key=len, default=()), *((name,) for name in sorted({name for some in names for name in some}))]
    rays = (Rays(some, *np.zeros((2, len(some), 3), np.float32)) for some in said)
    frames = [BodyObservation(0, nothing, none, origins, each, part=part) for each in rays]
    scene = Scene(Plane(np.array([0, 0, 1], np.float32), 0.0), (), False)
    options = options_from(settings.solve, settings.track, settings.features)
    if not sensors:  # tracks of markers have points of their own
        body = with_own_sites(body, {})[0]
    run = Runner(body, options, frames, scene, settings, changes)
    chunk = padded(Segment.blank(0, body.limb_count), settings.track.chunk)
    threads = [Thread(target=looked_at.prepare, args=(body, *chunk))]
    threads.append(Thread(target=depths.prepare, args=(body, chunk[0])))
    if sensors:  # markers alone have another program
        threads.insert(0, Thread(target=run.prepare))
    for thread in threads:
        thread.start()
    return threads


class Derived(NamedTuple):
    """What follows from the poses of some frames. Leading axis: frame."""

    joints: Float[Any, "frame joint 3"]  # joint centres `body.topology.centres`, metres
    beyond_limits: Float[Any, "frame bodyjoint"]  # of `body.topology.joints`, radians
    depth_inside: Float[Any, "frame limb"]  # in another limb, more than in the rest pose, metres
    limb_covariance: Float[Any, "frame limb 6 6"]  # turn (rad), shift (m) in the limb's frame
    joint_covariance: Float[Any, "frame joint 3 3"]  # square metres


@program
def looked_at(body: Body, poses: Poses, twist: Float[Array, "frame limb 6 6"]) -> Derived:
    """Joint centres of a chunk of frames, how sure they are, and what is not plausible."""
    centres, odd = jax.vmap(lambda some: (joint_centres(body, some), check(body, some)))(poses)
    return Derived(centres, odd.beyond, odd.depth, *covariances(body, poses, twist))


class Unplaced(NamedTuple):
    """A person whose poses stand, and whose joints are not in their places yet (the stages of PLACE)."""

    run: Runner
    tracks: Tracks  # without what is said of joints, and without notes
    exchanges: list[Exchange]
    named: Named
    notes: tuple[str, ...]  # so far


# 8 parameters: what a log says of itself, and what runs the program
def track_person(
    body: Body,
    scene: Scene,
    people: list[BodyObservation],
    settings: Settings,
    source: str,
    fixed_frame: str,
    notes: tuple[str, ...] = (),
    visit: Visit | None = None,
) -> Tracks:
    """Tracks a body through frames in which it was already told apart from its surroundings (see find_body);
    `visit` see Runner."""
    return placed(track_poses(body, scene, people, settings, source, fixed_frame, notes, visit=visit))


# 10 parameters: besides who looks on, and where to begin
def track_poses(
    body: Body,
    scene: Scene,
    people: list[BodyObservation],
    settings: Settings,
    source: str,
    fixed_frame: str,
    notes: tuple[str, ...] = (),
    progress: Progress | None = None,
    visit: Visit | None = None,
    begin: int = 0,
) -> Unplaced:
    """As track_person, before joints are put in their places: `placed` does that. It starts in frame `begin` or later,
    and is tracked back from there, too."""
    began, waited = time.perf_counter(), seconds_of_waiting()
    count = len(people)
    enough = np.array([len(f.points) >= 3 * FEW_POINTS for f in people], bool)
    exchanges: list[Exchange] = []
    mirrored = False
    from_markers = by_markers(people)
    people, settings, named = with_names(body, people, settings)
    if from_markers:
        people = without_gaps(people)
        body, own = with_own_sites(body, named.known.places)
        settings = replace(settings, features=with_own_names(settings.features, own))
        names = FeatureNames(body.topology, settings.features)
        exchanges = jumps(marker_table(people, names).markers)
        people = put_right(people, exchanges)
        table = marker_table(people, names)
        enough = table.enough(TO_START)
    at = int(np.argmax(enough)) if enough.any() else count
    if at < count and from_markers:
        spots = tuple(named.known.places.get(n, "") for n in table.markers.names)
        markers = table.markers._replace(places=spots, newington=named.known.newington)
        body, sides, mirrored = sized_by_markers(body, markers, settings.start.scale)
        people, exchanges = put_right(people, sides), exchanges + ([] if mirrored else sides)
    changes = loaded(settings.changes)
    body = prepared(body, changes)
    options = options_from(settings.solve, settings.track, settings.features)
    run = Runner(body, options, people, scene, settings, changes, visit)
    run.mirrored = mirrored
    if begin > at and begin < count and enough[begin] and not from_markers and settings.looks_ahead("track"):
        whole = track_whole(run, begin, enough, REFINE, progress, at)
    else:
        whole = track_whole(run, at, enough, REFINE, progress)
    for stage in FINISH:
        if is_active(whole.run, stage):
            whole = stage(whole)
    run = whole.run
    tracks = tracks_of(run, whole.segment, source, fixed_frame)
    tracks = tracks if run.by_markers else with_passes(tracks)
    compiling = seconds_of_waiting() - waited
    tracks = replace(tracks, seconds=time.perf_counter() - began - compiling, compile_seconds=compiling)
    return Unplaced(run, tracks, exchanges, named, (*notes, *whole.notes))


def placed(person: Unplaced) -> Tracks:
    """Tracks with joints in their places, rated, and what is to be said of them."""
    began, run = time.perf_counter(), person.run
    tracks = in_places(run, person.tracks)
    notes = as_few((*person.notes, *notes_on(run, tracks, person.exchanges, person.named)))
    return replace(tracks, seconds=tracks.seconds + time.perf_counter() - began, notes=notes)


def finished(run: Runner, segment: Segment, source: str, fixed_frame: str) -> Tracks:
    """Tracks of a whole recording, see tracks_of, with joints in their places and rated."""
    return in_places(run, with_passes(tracks_of(run, segment, source, fixed_frame)))


def in_places(run: Runner, tracks: Tracks) -> Tracks:
    """Tracks with joints in their places (the stages of PLACE), rated by those."""
    for stage in PLACE:
        if is_active(run, stage):
            tracks = stage(run, tracks)
    return with_rating(run, _with_residuals(tracks, run) if run.by_markers else tracks)


def with_rating(run: Runner, tracks: Tracks) -> Tracks:
    """Tracks with the confidence of their joints, and LOST where it is low; a log in doubt makes all joints less
    sure, but nobody LOST."""
    settings = run.settings
    found = rated(tracks, settings.track.lost_confidence, settings.looks_ahead("track"), run.by_markers)
    return only_as_sure(found, log_doubts(run.body, run.scene, run.people, settings, run.mirrored).right)


def with_names(
    body: Body, people: list[BodyObservation], settings: Settings
) -> tuple[list[BodyObservation], Settings, Named]:
    """The frames with the named points of one subject, the settings with what their names mean, and who it is."""
    t = body.topology
    named = named_subject(people, t, settings.features)
    features = told(settings.features, named.known, (*t.sites, *t.centres))
    return of_subject(people, named), replace(settings, features=features), named


def _with_residuals(tracks: Tracks, run: Runner) -> Tracks:
    """Tracks by markers alone with the markers' residuals, and their body without the points made for these."""
    poses = Poses(tracks.rotation, tracks.translation)
    found = residuals(run.body, run.table.markers, poses, tracks.tracked)
    residual = np.array(list(found.values()), np.float32)
    return replace(tracks, body=without_own_sites(tracks.body), marker_names=tuple(found), marker_residual=residual)


def tracks_of(run: Runner, segment: Segment, source: str, fixed_frame: str) -> Tracks:
    """Tracks of a whole recording, with all that follows from its poses; these are moved to the fixed frame in place,
    and covariances take the place of the segment's.

    **Arguments:** `segment` all frames of the recording; `source` its path.
    """
    fit = _misfit(run, segment)
    to_fixed(run.people, segment.rotation, segment.translation)
    segment.residual[segment.status == Status.NO_DATA] = np.nan
    chunk = run.settings.track.chunk
    derived = _room(run.body, segment)
    for first, end, body in spans(run.bodies, len(segment)):
        absent = ~np.asarray(body.present)
        for array in (segment.rotation, segment.translation, segment.limb_covariance):
            array[first:end, absent] = np.nan
        for at in range(first, end, chunk):
            span = slice(at, min(at + chunk, end))
            for array, part in zip(derived, derived_from(body, segment[span], chunk)):
                array[span] = part
    return Tracks(
        source, fixed_frame, run.body,
        time_ns=np.array([f.time_ns for f in run.people], np.int64),
        rotation=segment.rotation, translation=segment.translation, joints=derived.joints, status=segment.status,
        residual=segment.residual, explained=segment.explained, steps=segment.steps,
        points=np.array([len(f.points) for f in run.people], np.int32),
        limb_weight=segment.limb_weight, passes_apart=segment.passes_apart, beyond_limits=derived.beyond_limits,
        depth_inside=derived.depth_inside, limb_covariance=derived.limb_covariance,
        joint_covariance=derived.joint_covariance, up=_up(run), limb_beside=fit and fit.beside,
        limb_distance=fit and fit.distance, limb_bare=fit and fit.bare, limb_own=fit and fit.own,
        facing_odds=segment.facing_odds, T_fixed_steady=_sensor_motion(run.people),
        matched=any(f.matched for f in run.people),
    )  # fmt: skip


def _sensor_motion(people: list[BodyObservation]) -> Float64[np.ndarray, "frame 4 4"] | None:
    """How sensors moved that the log has at rest, see Tracks; None if they did not."""
    motion = [np.eye(4) if frame.T_fixed_steady is None else frame.T_fixed_steady for frame in people]
    return np.stack(motion) if any(frame.T_fixed_steady is not None for frame in people) else None


def _misfit(run: Runner, segment: Segment) -> Misfit | None:
    """How badly limbs fit the points, which are where the poses are; None of markers alone."""
    if run.by_markers or not len(segment):
        return None
    found = [
        misfit(body, segment.rotation[first:end], segment.translation[first:end], people)
        for first, end, body in spans(run.bodies, len(segment))
        if (people := run.people[first:end])
    ]
    return Misfit(*map(np.concatenate, zip(*found)))


def _up(run: Runner) -> Float32[np.ndarray, "3"]:
    """Upwards in the fixed frame; of a camera that moves unknown to the log, in its first frame."""
    normal = np.asarray(run.scene.floor.normal, np.float32)
    T = run.people[0].T_fixed_steady if run.people else None
    return normal if T is None else (T[:3, :3] @ normal).astype(np.float32)


def _room(body: Body, segment: Segment) -> Derived:
    """Arrays for what follows from the poses of a segment, without their numbers; its own for covariances of limbs."""
    t = body.topology
    rows = (len(t.centres), 3), (len(t.joints),), (len(t.limbs),), (len(t.limbs), 6, 6), (len(t.centres), 3, 3)
    found = Derived(*(np.empty((len(segment), *row), np.float32) for row in rows))
    return found._replace(limb_covariance=segment.limb_covariance)


def derived_from(body: Body, segment: Segment, chunk: int) -> Derived:
    """What follows from the poses of up to `chunk` frames with one body; on the host, NaN where there is no pose."""
    found = looked_at(body, *padded(segment, chunk))
    there = np.any(np.isfinite(segment.translation), (1, 2))
    each = (np.asarray(array, np.float32)[: len(segment)] for array in found)
    return Derived(*(np.where(there.reshape(-1, *[1] * (array.ndim - 1)), array, np.float32(np.nan)) for array in each))


def padded(segment: Segment, chunk: int) -> tuple[Poses, jax.Array]:
    """Poses of some frames and their limbs' covariances, as looked_at takes them: one program for every length."""
    pad = ((0, chunk - len(segment)), (0, 0), (0, 0))
    poses = Poses(np.pad(segment.rotation, pad), np.pad(segment.translation, pad))
    return poses, jax.device_put(np.pad(segment.limb_covariance, (*pad, (0, 0))))
