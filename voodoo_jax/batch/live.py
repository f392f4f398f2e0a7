"""Tracks a log while it is recorded, publishes each frame, and writes the results as replay does."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from voodoo_jax.batch.log_job import output_paths, remove_others, remove_partials
from voodoo_jax.batch.outcome import Outcome, outcome_of
from voodoo_jax.batch.replay import parameters_of
from voodoo_jax.compile.cache_dir import keep_compiled
from voodoo_jax.config.limited import limited
from voodoo_jax.config.options import Settings, SettingsError
from voodoo_jax.detect.opening import open_checked
from voodoo_jax.detect.pipeline import build_of
from voodoo_jax.exporters.foxglove import Publisher, write_tracks_mcap
from voodoo_jax.exporters.npz import write_tracks_npz
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.rigid import on_device
from voodoo_jax.io.live.frames import LiveLog
from voodoo_jax.io.live.sources import URLS, Source
from voodoo_jax.io.opened_log import LogReader
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Tracks, for_users
from voodoo_jax.storage.atomic import made_folder
from voodoo_jax.trackers.base import LogInfo, Unsuitable, tracker_of
from voodoo_jax.trackers.both.live import LiveBoth
from voodoo_jax.trackers.flexible.live import LiveFlexible
from voodoo_jax.trackers.icp.live import LiveTracker

CAUGHT_UP = 0.25  # seconds: from the first frame on that is given out so soon, latencies count; by hand
SAID_EVERY = 2.0  # seconds between two lines on how it goes; by hand

Say = Callable[[str], None]


@dataclass
class Pace:
    """Delay with which frames are published."""

    latencies: list[float] = field(default_factory=list)  # seconds from the frame's last message to its poses
    behind: list[float] = field(default_factory=list)  # seconds by the recorder's clock, if it is this machine's
    frames: int = 0
    caught_up: int = -1  # number of the first frame that was given out soon
    began: float = 0.0  # of that frame
    last: float = 0.0
    processor: float = 0.0  # seconds, at that frame

    def note(self, arrived: float | None, log_time_ns: int | None) -> None:
        """Counts one more published frame."""
        now = time.monotonic()
        late = now - arrived if arrived is not None else float("nan")
        if self.caught_up < 0 and late < CAUGHT_UP:
            self.caught_up, self.began, self.processor = self.frames, now, time.process_time()
        self.frames, self.last = self.frames + 1, now
        self.latencies.append(late)
        self.behind.append(time.time() - log_time_ns / 1e9 if log_time_ns is not None else float("nan"))

    def __str__(self) -> str:
        """As a sentence."""
        late = np.array(self.latencies[max(self.caught_up, 0) :])
        late = late[np.isfinite(late)]
        if not len(late):
            return "no frame was published"
        median, most = np.percentile(late, [50, 95])
        text = f"latency {_seconds(median)} (median), {_seconds(most)} (95 %)"
        if self.caught_up < 0:
            return f"{text}; tracking was slower than the recording"
        count, spent = self.frames - self.caught_up - 1, self.last - self.began
        if count > 0 and spent > 0:
            each = (time.process_time() - self.processor) / count
            text += f", {count / spent:.1f} frames/s, {1000 * each:.0f} ms of processor time each"
        behind = float(np.nanmedian(self.behind[self.caught_up :]))
        if 0 <= behind < 10:
            text += f"; {_seconds(behind)} after the recorder had them"
        return text


def _seconds(x: float) -> str:
    return f"{1000 * x:.0f} ms" if x < 1 else f"{x:.1f} s"


@dataclass(frozen=True, eq=False)
class LiveJob:
    """A source and what is to be done with it."""

    place: str  # of the source
    out: str  # folder
    body: Body
    settings: Settings  # with online
    names: str = ""  # of joints

    def __post_init__(self):
        if self.settings.changes:
            raise SettingsError("[[change]] in the settings: live tracking does not support changes of the body")
        for name in ("skin", "pose_net"):
            if getattr(self.settings.read, name):
                raise SettingsError(f"read.{name} needs a whole log: live tracking does not support it")

    @property
    def targets(self) -> tuple[Path, Path]:
        """Paths of the tracks and .voodoo.mcap."""
        name = self.place
        for scheme in URLS:
            if name.startswith(scheme):
                name = name.removeprefix(scheme).rstrip("/").replace(":", "-").replace("/", "-")
        return output_paths(os.path.abspath(name), self.out)


def track_live(job: LiveJob, source: Source, publishers: list[Publisher], say: Say, progress: Say) -> Outcome:
    """Tracks until the source ends (or a caller sets `source.ended`), and writes the results.

    **Arguments:** `say` receives messages, `progress` the progress every two seconds. Raises LogError, SettingsError,
    Unsuitable; OSError if results cannot be written.
    """
    settings = job.settings
    made_folder(job.out)
    with limited(settings.limits):
        body, build = on_device(job.body), build_of(job.body, settings.start.scale)
        read = tracker_of(settings).reads(settings.read)
        live = LiveLog(source, read, lambda log, read: open_checked(log, read, build, settings.detect), say)
        reader = live.open()
        if not reader.sensors:
            raise Unsuitable(
                f"'{source.path}' has only named points or rays, but live tracking needs depth; use replay"
            )
        say(f"{', '.join(reader.sensors)}: in '{reader.fixed_frame}'. Programs are loaded, or compiled once ...")
        nowhere = Scene(Plane(np.array([0, 0, 1], np.float32), 0.0), (), False)
        first = _examples(reader), nowhere, bool(reader.features)
        tracker = (
            LiveFlexible(body, settings, source.path) if settings.tracker == "flexible"
            else LiveBoth(body, settings, source.path, *first) if settings.tracker == "both"
            else LiveTracker(body, settings, *first)
        )  # fmt: skip
        tracker.prepare()
        keep_compiled()
        say("ready; Ctrl-C ends it")
        pace = _followed(tracker, live, reader, job, publishers, progress)
        tracks = tracker.whole(LogInfo(source.path, reader.fixed_frame, notes=lambda: live.notes))
    tracks = for_users(tracks.with_names(job.names), reader)
    say(str(pace))
    return _written(job, tracks)


def _followed(
    tracker: LiveTracker | LiveFlexible | LiveBoth,
    live: LiveLog,
    reader: LogReader,
    job: LiveJob,
    publishers: list[Publisher],
    progress: Say,
) -> Pace:
    """Tracks and publishes all frames."""
    pace, said = Pace(), time.monotonic()
    times: dict[int, tuple[float | None, int | None]] = {}  # of frames that are not given out yet
    tracklets, seen = tracker.watched(live.frames(), reader.up, on_device(job.body), job.settings, reader.up_is_given)

    def give(found: list[Tracks]) -> None:
        nonlocal said
        for one in found:
            shown = for_users(replace(one, fixed_frame=reader.fixed_frame).with_names(job.names), reader)
            for publisher in publishers:
                publisher.frame(shown)
            pace.note(*times.pop(int(one.time_ns[0]), (None, None)))
            if time.monotonic() - said > SAID_EVERY:
                said = time.monotonic()
                word = "tracked" if one.tracked[0] else "not tracked"
                progress(f"{pace.frames} frames, {_seconds(pace.latencies[-1])} late, {word}")

    for observation in seen:
        at = observation.time_ns
        times[at] = live.arrived.get(at), live.log_times.get(at)
        give(tracker.add(observation, tracklets.finder.scene))
    give(tracker.end())
    return pace


def _written(job: LiveJob, tracks: Tracks) -> Outcome:
    """Writes the results as replay does."""
    npz, mcap = job.targets
    for path in (npz, mcap):
        remove_partials(path)
    write_tracks_mcap(tracks, mcap, dict(parameters_of(job.settings)))
    write_tracks_npz(tracks, npz, "")
    remove_others(str(npz), 1)
    return outcome_of(job.place, str(npz), tracks)


def _examples(reader: LogReader) -> list[BodyObservation]:
    """Frames without points, shaped like those to come."""
    nothing, none = np.zeros((0, 3), np.float32), np.zeros(0, np.int32)
    origins, part = np.zeros((len(reader.sensors), 3), np.float32), none if reader.parts else None
    blank = BodyObservation(0, nothing, none, origins, part=part, parts=reader.parts)
    return [blank, *(replace(blank, rays=rays, pairs=pairs) for rays, pairs in reader.named)]
