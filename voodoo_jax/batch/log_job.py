"""One log from file to result files: the same function for this process, worker processes and other machines."""

import os
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path
from typing import Any

from voodoo_jax.batch.outcome import Outcome, outcome_of
from voodoo_jax.compile.cache_dir import keep_compiled, process_runs, use_compile_cache
from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.rigid import on_device
from voodoo_jax.model.body import Body
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.urls import TRACKS, delivered, fetched, joined

Progress = Callable[[float], None]  # called with the share that is done, 0..1
Visit = Callable[..., Any]  # solve.scan.Visit, which takes long to import


@dataclass(frozen=True, eq=False)
class Job:
    """A log and all that is to be done with it. Can be sent to other processes."""

    log: str  # absolute path or URL
    out: str  # folder: absolute path or URL
    body: Body
    settings: Settings
    smooth_seconds: float
    recipe: str  # see finished.recipe_key
    parameters: tuple[tuple[str, str], ...]  # for the .voodoo.mcap: all settings as text
    picture: bool
    only_picture: bool = False  # the tracks are there already
    compile_cache: str = ""  # folder; empty: none
    size: int = 1  # bytes of the log


def output_paths(log: str | os.PathLike[str], out: str | os.PathLike[str]) -> tuple[Path, Path]:
    """Where the tracks of a log go: `<stem>.tracks.npz` and `<stem>.voodoo.mcap` in `out`."""
    stem = Path(log).name.removesuffix(".mcap")
    return Path(out) / f"{stem}.tracks.npz", Path(out) / f"{stem}{TRACKS}"


def output_places(log: str, out: str) -> tuple[str, str, str]:
    """Names of a log's tracks, .voodoo.mcap and picture in `out`, a path or URL."""
    npz, mcap = output_paths(log, "")
    return joined(out, npz.name), joined(out, mcap.name), joined(out, npz.name.removesuffix(".tracks.npz") + ".png")


def track_log(
    path: str | os.PathLike[str],
    body: Body,
    settings: Settings,
    progress: Progress | None = None,
    visit: Visit | None = None,
) -> Tracks:
    """Reads a log frame by frame and tracks the body in it; `visit` see do_job. Raises LogError, Unsuitable."""
    from voodoo_jax.io.log_reader import open_log
    from voodoo_jax.trackers.base import Source, tracker_of

    tracker = tracker_of(settings)
    log = open_log(path, tracker.reads(settings.read))
    source = Source(
        log.path, log.fixed_frame, log.up, len(log.sensors), log.named_at_once, bool(log.parts), lambda: log.notes
    )
    if visit is None:
        tracker.prepare(body, settings, source)
    total, done = max(1, (1 + tracker.passes(settings)) * len(log)), 0  # read, track there, and back

    def more(count: int) -> None:
        nonlocal done
        done += count
        if progress is not None:
            progress(min(1.0, done / total))

    def counted() -> Iterable:
        for frame in log.frames():
            more(1)
            yield frame

    return tracker.track(body, counted(), source, settings, more, visit)


def draw(tracks: Tracks, target: Path, settings: Settings, count: int = 4, log: str = "") -> None:
    """Writes a picture of some frames of a tracked log, reading it (or its copy `log`) once more but keeping these
    frames only."""
    from voodoo_jax.io.log_reader import open_log
    from voodoo_jax.records.recording import Recording
    from voodoo_jax.viz.figures import picture, spread

    read = replace(settings.read, images=False, matching="fine")  # clouds are drawn
    reader = open_log(log or tracks.source, read)
    wanted = set(tracks.time_ns[spread(len(tracks.time_ns), count)].tolist())
    frames = tuple(frame for frame in reader.frames() if frame.time_ns in wanted)
    picture(tracks, Recording(reader.path, reader.fixed_frame, reader.up, reader.sensors, frames), target, count)


def do_job(job: Job, progress: Progress | None = None, visit: Visit | None = None) -> Outcome:
    """Tracks one log and writes its results; `visit` runs the program, None: here and now. Whatever goes wrong with it
    is told in the outcome."""
    from voodoo_jax.io.container import LogError
    from voodoo_jax.trackers.base import Unsuitable

    began = time.perf_counter()
    use_compile_cache(job.compile_cache)
    try:
        outcome = _done(job, progress, visit)
    except (LogError, Unsuitable) as problem:
        outcome = Outcome(job.log, error=str(problem))
    except MemoryError:
        outcome = Outcome(job.log, error="out of memory: use fewer --workers, or cut the log in pieces")
    except Exception as problem:  # one log's trouble is not the others'
        outcome = Outcome(job.log, error=f"unexpected {type(problem).__name__}: {problem}")
    keep_compiled()
    if outcome.error and os.path.exists(output_places(job.log, job.out)[0]):
        outcome = replace(outcome, error=f"{outcome.error} (What is there of this log is from an earlier run.)")
    return replace(outcome, total_seconds=time.perf_counter() - began)


def _done(job: Job, progress: Progress | None, visit: Visit | None) -> Outcome:
    from voodoo_jax.batch.resume import log_fingerprint, run_key
    from voodoo_jax.exporters.foxglove import write_tracks_mcap
    from voodoo_jax.exporters.npz import read_tracks_npz, write_tracks_npz
    from voodoo_jax.io.container import LogError
    from voodoo_jax.trackers.base import Unsuitable
    from voodoo_jax.trackers.smoothing import smooth

    key, (place, _, drawn) = "", output_places(job.log, job.out)
    with ExitStack() as stack:
        try:
            log = stack.enter_context(fetched(job.log))
        except Exception as problem:  # every store has its own errors
            raise LogError(f"'{job.log}' cannot be fetched: {type(problem).__name__}: {problem}") from problem
        folder = stack.enter_context(delivered(job.out))
        npz, mcap = output_paths(job.log, folder)
        target = npz.with_name(Path(drawn).name)
        for path in (npz, mcap, target):
            remove_partials(path)
        if job.only_picture:
            tracks = read_tracks_npz(stack.enter_context(fetched(place)))
        else:
            with suppress(OSError), open(log, "rb") as stream:  # before reading: it may be changed meanwhile
                key = run_key(job.recipe, log_fingerprint(stream))
            try:
                tracks = track_log(log, on_device(job.body), job.settings, progress, visit)
            except (LogError, Unsuitable) as problem:
                raise LogError(str(problem).replace(log, job.log)) from problem
            tracks = smooth(replace(tracks, source=job.log), job.smooth_seconds)
            write_tracks_mcap(tracks, mcap, {**dict(job.parameters), "run_key": key})
            write_tracks_npz(tracks, npz, key)  # last: where it is, both are
        trouble = _picture(tracks, target, job, log) if job.picture else ""
    outcome = outcome_of(job.log, place, tracks, picture=drawn if job.picture and not trouble else "")
    notes = (*outcome.notes, f"No picture: {trouble}") if trouble else outcome.notes
    return replace(outcome, notes=notes, skipped=job.only_picture)


def _picture(tracks: Tracks, target: Path, job: Job, log: str) -> str:
    """Draws; why that did not work, or nothing."""
    try:
        draw(tracks, target, job.settings, log=log)
    except (ValueError, OSError) as problem:
        return str(problem)
    return ""


def remove_partials(target: Path) -> None:
    """Removes half-written files of this name whose process does not run any more: see atomic.replacing."""
    with suppress(OSError):
        for partial in target.parent.glob(f".{escape(target.name)}.*.tmp"):
            pid = partial.name.removesuffix(".tmp").rsplit(".", 1)[-1]
            if pid.isdigit() and not process_runs(int(pid)):
                partial.unlink(missing_ok=True)
