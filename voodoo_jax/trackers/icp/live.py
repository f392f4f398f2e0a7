"""Tracks a body frame by frame as frames arrive, like `online` tracking of a whole recording. Host side.

The steps are those of sequence.follow, in the same order and by the same programs: the result of a frame equals that of
a replay of the finished recording. Only a start waits for the frames of its trials.
"""

import time
from collections.abc import Iterator
from copy import copy
from dataclasses import fields, replace

import numpy as np

from voodoo_jax.compile.executable import seconds_of_waiting
from voodoo_jax.config.options import Settings, SettingsError
from voodoo_jax.detect.disk_buffer import Spill
from voodoo_jax.detect.pipeline import watched
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.markers.own_sites import with_names
from voodoo_jax.model.attachments import prepared
from voodoo_jax.model.body import Body
from voodoo_jax.records.notes import as_few
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Status, Tracks, scale_confidence
from voodoo_jax.solve.padding import FEATURE_BUCKETS, bucket
from voodoo_jax.solve.scan import State, at_rest, options_from
from voodoo_jax.trackers.base import LogInfo
from voodoo_jax.trackers.icp.confidence import rate_joints
from voodoo_jax.trackers.icp.diagnostics import log_doubts, notes_on
from voodoo_jax.trackers.icp.initialise import begin, clearer
from voodoo_jax.trackers.icp.joint_spread import with_passes
from voodoo_jax.trackers.icp.pipeline import PLACE, REFINE
from voodoo_jax.trackers.icp.refine.place_joints import Gaps, PlaceJoints, band_gaps, persons_body, sensor_places
from voodoo_jax.trackers.icp.runner import THING_FRAMES, Runner
from voodoo_jax.trackers.icp.stage import is_active, looked
from voodoo_jax.trackers.icp.tracker import finished, tracks_of
from voodoo_jax.trackers.shared import eye
from voodoo_jax.trackers.shared.confidence import AROUND
from voodoo_jax.trackers.shared.report import looked_at, padded
from voodoo_jax.trackers.shared.runner import FEW_POINTS
from voodoo_jax.trackers.shared.segment import Followed, segment_of
from voodoo_jax.trackers.shared.sequence import DOUBT, SPAN

KEPT = 64  # frames whose points stay in memory: any gives the same that is more than a start looks back or ahead


class LiveRunner(Runner):
    """Tracks an unfinished recording one frame at a time."""

    def __init__(self, body: Body, settings: Settings, scene: Scene, first: list[BodyObservation], features: bool):
        """`first` frames with the sensors and names of later ones; `features`: whether other named features may
        come."""
        super().__init__(body, options_from(settings.solve, settings.track, settings.features), first, scene, settings)
        self.length = THING_FRAMES * settings.start.frames  # of one program for trials and single frames
        if features and self.names.rows:
            self.feature_capacity = max(self.feature_capacity, bucket(1, FEATURE_BUCKETS))
        self.people = []
        self.others: list[int] = []
        self.named = self.featured = np.zeros(0, bool)

    def append(self, frame: BodyObservation) -> None:
        """One more frame."""
        names = (*frame.rays.names, *frame.pairs.names)
        if frame.other:
            self.others.append(len(self.people))
        self.people.append(frame)
        if len(self.people) > KEPT:  # its points are no longer looked at
            self.people[-KEPT - 1] = self.people[-KEPT - 1].only(np.zeros(0, int))
        few = len(frame.points) < FEW_POINTS
        known = few and any(self.names.look_up(name) is not None for name in names)
        self.featured = np.append(self.featured, known)
        self.named = np.append(self.named, False)

    def one(self, state: State, at: int) -> tuple[State, Followed]:
        """One frame, tracked from the state after the one before."""
        previous = self.people[at - 1].time_ns if at else None
        state, step, left_out = self._tracked(state, self.frames(at, at + 1), previous)
        self.left_out += left_out
        return state, segment_of(self, step, at, 1)


class LiveTracker:
    """Follows the main person (or body) through frames as they come.

    **Arguments:** `first` some frames of the recording, with the sensors and names of later ones; `features` whether
    other named features may come. Raises SettingsError for settings that need later frames.
    """

    watched = staticmethod(watched)  # the person in each frame, and what follows them: see detect.pipeline

    def __init__(
        self, body: Body, settings: Settings, first: list[BodyObservation], scene: Scene, features: bool = False
    ):
        if settings.changes:
            raise SettingsError("[[change]] in the settings: live tracking does not support changes of the body")
        if settings.online_lag:
            raise SettingsError("live tracking gives results at once; leave out online_lag (replay supports it)")
        if settings.looks_ahead("track") or settings.looks_ahead("detect"):
            raise SettingsError("live tracking needs settings.online")
        self.seconds = 0.0  # of tracking so far, without compiling
        self._body = body = prepared(body, ())
        first, self.settings, self._named = with_names(body, first, settings)
        self.run = LiveRunner(body, self.settings, scene, first, features)
        self._others = {n for names in self._named.others.values() for n in names}
        self._kept, self._rows = Spill(), list[Followed]()
        self._enough, self._ended = list[bool](), False
        self._steps = self._followed()
        self._shown = _Shown(self.run)

    def prepare(self) -> None:
        """Compiles or loads the programs."""
        self.run.prepare()
        eye.prepare(self.run.body)
        blank = Followed.blank(0, self.run.body.limb_count)
        looked_at.prepare(self.run.body, *padded(blank, 1))

    def add(self, frame: BodyObservation, scene: Scene) -> list[Tracks]:
        """Adds one frame; returns tracks of one frame each, for the frames that are final now, in order. `scene`: the
        present one, for a start."""
        self.run.scene = scene
        self.run.append(frame)
        self._kept.append(frame)
        self._enough.append(len(frame.points) >= 3 * FEW_POINTS)
        return self._settled()

    def end(self) -> list[Tracks]:
        """Ends the input; returns the frames that waited for more."""
        self._ended = True
        return self._settled()

    @property
    def people(self) -> list[BodyObservation]:
        """The points on the person in each frame so far."""
        return self._kept.frames()

    def whole(self, source: LogInfo) -> Tracks:
        """Tracks of all frames, as replay writes them."""
        run, people = self.run, self.people
        every = Runner(self._body, run.options, people, run.scene, self.settings)
        every.body, every.bodies, every.sized, every.left_out = run.body, run.bodies, run.sized, run.left_out
        tracks = finished(every, _joined_rows(self._rows, run.body.limb_count), source)
        notes = as_few((*source.notes(), *notes_on(every, tracks, self._named)))
        return replace(tracks, seconds=self.seconds, notes=notes)

    def _settled(self) -> list[Tracks]:
        began, waited = time.perf_counter(), seconds_of_waiting()
        out = []
        for row in self._steps:
            if row is None:
                break
            self._rows.append(row)
            out.append(self._shown(row))
        self.seconds += time.perf_counter() - began - (seconds_of_waiting() - waited)
        return out

    # -- the steps of sequence.follow

    def _until(self, at: int) -> Iterator[None]:
        """Waits for a frame, or the end."""
        while len(self.run.people) <= at and not self._ended:
            yield None

    def _there(self, at: int) -> bool:
        return at < len(self.run.people)

    def _blank(self, at: int, status: Status) -> Followed:
        row = Followed.blank(1, self.run.body.limb_count)
        row.status[:] = status
        return replace(row, first=at)

    def _start_frames(self, at: int) -> Iterator[None]:
        """Waits for the frames that a start needs."""
        s = self.settings.start
        good = lambda: sum(len(f.points) >= FEW_POINTS for f in self.run.people[at : at + 3 * s.frames])  # noqa: E731
        yield from self._until(at + s.size_frames - 1)
        while not self._ended and good() < s.frames and not self._there(at + 3 * s.frames - 1):
            yield None

    def _followed(self) -> Iterator[Followed | None]:
        """The result of each frame; None if another frame is needed first."""
        run, state, before, at = self.run, None, None, 0
        tried = -1  # until that frame nothing is given up as lost
        yield from self._until(0)
        while self._there(at) and not self._enough[at]:
            yield self._blank(at, Status.NOT_STARTED)
            at += 1
            yield from self._until(at)
        while self._there(at):
            if run.others and run.others[0] <= at:
                state = before = None
                run.another(at)
            if state is None:
                yield from self._start_frames(at)
                if not run.can_start(at):
                    yield self._blank(at, Status.NO_DATA)
                    at += 1
                    yield from self._until(at)
                    continue
                start = begin(run, at, before)
                state = at_rest(start.poses)
            chunk = _Chunk(at, min(DOUBT if run.doubt else SPAN, self.settings.track.chunk), tried < at, self.settings)
            while self._there(at) and not chunk.over and not (run.people[at].other and at > chunk.first):
                after, row = run.one(state, at)
                row, mended = looked(run, row, REFINE)
                state = mended or after
                chunk.take(row, mended is not None)
                status = row.status if not run.doubt else np.where(row.tracked, Status.LOST, row.status).astype(np.int8)
                yield replace(row, status=status)
                at += 1
                yield from self._until(at)
            if chunk.broken:
                state, before, tried = None, chunk.before, at + self.settings.track.patience
                while chunk.gone and self._there(at) and not self._enough[at]:
                    yield self._blank(at, Status.NO_DATA)
                    at += 1
                    yield from self._until(at)
            elif run.doubt and chunk.full and self._there(at):
                yield from self._start_frames(at)
                if (better := clearer(run, at)) is not None:
                    state = at_rest(better.poses)


class _Chunk:
    """Frames that replay tracks at once; at their end it detects that the body is gone or lost."""

    def __init__(self, first: int, most: int, may_be_lost: bool, settings: Settings):
        self.first, self._most, self._may_be_lost = first, most, may_be_lost
        self._patience, self._statuses = settings.track.patience, list[int]()
        self._poses: list[Poses] = []
        self._ends = False  # its last frame's pose was mended

    def take(self, row: Followed, ends: bool) -> None:
        self._ends = ends
        self._statuses.append(int(row.status[0]))
        self._poses = [*self._poses[-self._patience :], row.pose_at(0)]

    def _run_of(self, status: Status) -> bool:
        last = self._statuses[-self._patience :]
        return len(last) == self._patience and set(last) == {int(status)}

    @property
    def full(self) -> bool:
        return self._ends or len(self._statuses) >= self._most

    @property
    def gone(self) -> bool:
        return not self.full and self._run_of(Status.NO_DATA)

    @property
    def broken(self) -> bool:
        """Whether the segment ends, because the body is gone or lost."""
        return self.gone or (not self.full and self._may_be_lost and self._run_of(Status.LOST))

    @property
    def over(self) -> bool:
        return self.full or self.broken

    @property
    def before(self) -> Poses | None:
        """The last poses before the body was gone."""
        return self._poses[0] if self.gone and len(self._poses) > self._patience else None


class _Shown:
    """The published tracks of each frame, with placed joint centres and confidence, from earlier frames only."""

    def __init__(self, run: LiveRunner):
        self._run = run
        self._places = [stage for stage in PLACE if isinstance(stage, PlaceJoints) and is_active(run, stage)]
        self._rows: list[Tracks] = []  # of the present body, for the bands: before they were rated
        self._first = 0  # frame in which it began
        self._until = 0  # frame of the present body until which the bands hold
        self._gaps: dict[str, Gaps] = {}
        self._body: Body | None = None  # the present one, and what it is in its usual proportions
        self._usual: Body | None = None
        self._recent: list[Tracks] = []  # in which it is looked back for confidence

    def __call__(self, row: Followed) -> Tracks:
        run, at = self._run, row.first
        frame = run.people[at]
        alone = copy(run)
        alone.people, alone.bodies = [frame], [(0, run.body)]
        alone.settings = replace(run.settings, track=replace(run.settings.track, chunk=1))
        own = {f.name: np.array(v) if isinstance(v := getattr(row, f.name), np.ndarray) else v for f in fields(row)}
        tracks = with_passes(tracks_of(alone, replace(row, **own | {"first": 0}), LogInfo()))
        if frame.other and at > 0:
            self._rows, self._first, self._until = [], at, 0
        for _ in self._places:
            tracks = self._placed(tracks, frame, at - self._first)
        self._recent = [*self._recent[-AROUND:], tracks]
        window = joined_tracks([replace(t, body=tracks.body) for t in self._recent])
        found = rate_joints(window, run.settings.track.lost_confidence, False).only(slice(-1, None))
        return scale_confidence(found, log_doubts(run.body, run.scene, alone.people, run.settings).right)

    def _placed(self, tracks: Tracks, frame: BodyObservation, number: int) -> Tracks:
        """Places joint centres by the bands of earlier frames up to a recent one, as PlaceJoints does online."""
        self._rows.append(_for_bands(tracks))
        if tracks.body is not self._body:
            self._body, self._usual = tracks.body, persons_body(tracks.body)
        body, eyes = self._usual, sensor_places([frame])
        if body is None or eyes is None:
            return tracks
        stage = self._places[0]
        if number >= self._until:
            self._until = stage.part_end(number, 0)
            self._rows = [joined_tracks([replace(t, body=tracks.body) for t in self._rows])]
            self._gaps = band_gaps(body, self._rows[0])
        return stage.placed(body, tracks, eyes, self._gaps)


def _for_bands(tracks: Tracks) -> Tracks:
    """The data for the stretch of bands, without large arrays."""
    return tracks.having(limb_covariance=None, joint_covariance=None, beyond_limits=None, depth_inside=None)


def joined_tracks(parts: list[Tracks]) -> Tracks:
    """Joins tracks of successive frames of one body."""
    if len(parts) == 1:
        return parts[0]
    rows = [part.rows() for part in parts]
    return parts[-1].having(**{name: np.concatenate([each[name] for each in rows]) for name in rows[0]})


def _joined_rows(rows: list[Followed], limbs: int) -> Followed:
    """Rows of all frames as one segment."""
    if not rows:
        return Followed.blank(0, limbs)
    names = [f.name for f in fields(Followed) if isinstance(getattr(rows[0], f.name), np.ndarray)]
    return replace(rows[0], first=0, **{name: np.concatenate([getattr(row, name) for row in rows]) for name in names})
