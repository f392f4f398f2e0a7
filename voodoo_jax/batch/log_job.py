"""One log from file to result files: the same function for this process, worker processes and other machines."""

import math
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
from voodoo_jax.config.options import Settings, SettingsError
from voodoo_jax.config.output_style import Style
from voodoo_jax.geometry.arrays_file import arrays_in
from voodoo_jax.geometry.rigid import on_device
from voodoo_jax.model.body import Body
from voodoo_jax.records.notes import SENTENCE, plain
from voodoo_jax.records.tracks import Tracks, for_users
from voodoo_jax.storage.atomic import check_writable
from voodoo_jax.storage.cores import ahead, own_cores
from voodoo_jax.storage.troubles import NotWritten
from voodoo_jax.storage.urls import TRACKS, delivered, fetched, is_url, joined, log_name, opened, person_place, removed

AHEAD = 4  # frames that are read while the ones before are looked at; by hand
Progress = Callable[[float], None]  # called with the share that is done, 0..1
Visit = Callable[..., Any]  # solve.scan.Visit, which takes long to import


@dataclass(frozen=True, eq=False)
class Job:
    """A log and what is to be done with it. Can be sent to other processes."""

    log: str  # absolute path or URL
    out: str  # folder: absolute path or URL
    body: Body
    settings: Settings
    smooth_seconds: float
    recipe: str  # see finished.recipe_key
    parameters: tuple[tuple[str, str], ...]  # for the .voodoo.mcap: all settings as text
    picture: bool
    only_picture: bool = False  # the tracks are there already, what is drawn or exported from them is not
    exports: tuple[str, ...] = ()  # formats, see exporters/formats.py
    style: Style = Style()
    html: bool = False
    compile_cache: str = ""  # folder; empty: none
    size: int = 1  # bytes of the log
    timeout: float = 0.0  # seconds after which it is given up; 0: never


def output_paths(log: str | os.PathLike[str], out: str | os.PathLike[str]) -> tuple[Path, Path]:
    """Paths of a log's tracks: `<stem>.tracks.npz` and `<stem>.voodoo.mcap` in `out`."""
    stem = log_name(os.fspath(log))
    return Path(out) / f"{stem}.tracks.npz", Path(out) / f"{stem}{TRACKS}"


def output_places(log: str, out: str) -> tuple[str, str, str]:
    """Names of a log's tracks, .voodoo.mcap and picture in `out`, a path or URL."""
    npz, mcap = output_paths(log, "")
    return joined(out, npz.name), joined(out, mcap.name), joined(out, npz.name.removesuffix(".tracks.npz") + ".png")


# 7 parameters: what is tracked by what, who watches it, and how joints are called
def track_log(
    path: str | os.PathLike[str],
    body: Body,
    settings: Settings,
    progress: Progress | None = None,
    visit: Visit | None = None,
    timeout: float = 0.0,
    names: str = "",
) -> list[Tracks]:
    """Reads a log frame by frame and tracks everybody in it; `visit` see do_job, `names` Tracks.with_names.
    Raises LogError, also after `timeout` seconds if that is not 0; Unsuitable."""
    from voodoo_jax.detect.opening import open_checked
    from voodoo_jax.detect.pipeline import build_of
    from voodoo_jax.io.container import LogError
    from voodoo_jax.trackers.base import Task, source_of_log, tracker_of

    until = time.monotonic() + timeout if timeout else math.inf

    tracker = tracker_of(settings)
    log = open_checked(path, tracker.reads(settings.read), build_of(body, settings.start.scale), settings.detect)
    total, done = max(1, (1 + tracker.passes(settings)) * len(log)), 0.0  # read, track there, and back

    def more(count: float) -> None:
        nonlocal done
        done += count
        if time.monotonic() > until:
            raise LogError(out_of_time(timeout))
        if progress is not None:
            progress(min(1.0, done / total))

    def counted() -> Iterable:
        # in another thread where that pays; several workers share the cores already
        for frame in ahead(log.frames(), AHEAD) if own_cores() > 1 and log.unpacks else log.frames():
            more(1)
            yield frame

    task = Task(body, source_of_log(log), settings, more, visit)
    if visit is None:
        tracker.prepare(task)
    found = tracker.track(task, counted())
    return [for_users(tracks.with_names(names), log) for tracks in found]


def out_of_time(seconds: float) -> str:
    """Why a log was given up."""
    return f"tracking stopped after {seconds:g} s; allow more (--log-timeout), or split the log"


def draw(people: list[Tracks], target: Path, settings: Settings, count: int = 4, log: str = "") -> None:
    """Writes a picture of some frames of a tracked log, reading it (or its copy `log`) once more but keeping these
    frames only."""
    from voodoo_jax.detect.opening import open_checked
    from voodoo_jax.detect.pipeline import build_of
    from voodoo_jax.records.recording import Recording
    from voodoo_jax.records.stretches import spread
    from voodoo_jax.viz.figures import picture

    tracks = people[0]
    build = build_of(tracks.body, settings.start.scale)
    # a network would look at all images for four frames
    read = replace(settings.read, images=True, pose_net="", matching="fine")
    reader = open_checked(log or tracks.source, read, build, settings.detect)
    wanted = set(tracks.time_ns[spread(len(tracks.time_ns), count)].tolist())
    frames = tuple(frame for frame in reader.frames() if frame.time_ns in wanted)
    read = Recording(reader.path, reader.fixed_frame, reader.up, reader.sensors, frames, origin=reader.origin)
    picture(people, read, target, count)


def do_job(job: Job, progress: Progress | None = None, visit: Visit | None = None) -> Outcome:
    """Tracks one log and writes its results; `visit` runs the program, None: in this process. Errors are reported in
    the outcome."""
    from voodoo_jax.config.limited import limited
    from voodoo_jax.io.container import LogError
    from voodoo_jax.trackers.base import Unsuitable

    began = time.perf_counter()
    use_compile_cache(job.compile_cache)
    try:
        with limited(job.settings.limits):
            outcome = _done(job, progress, visit)
    except (LogError, SettingsError, Unsuitable, NotWritten) as problem:
        outcome = Outcome(job.log, error=str(problem))
    except UnicodeEncodeError as problem:  # bytes of a name that are no text
        outcome = Outcome(job.log, error=f"its name, or a name in it, is not UTF-8 ({problem.reason}): rename the file")
    except OSError as problem:
        why = problem.strerror or str(problem)
        text = f"'{problem.filename or job.log}' can no longer be read: {why}. Was it moved, or its disk removed?"
        outcome = Outcome(job.log, error=plain(text, SENTENCE))
    except MemoryError:
        outcome = Outcome(job.log, error="out of memory: use fewer --workers, or split the log")
    except Exception as problem:  # one log's trouble is not the others'
        outcome = Outcome(job.log, error=plain(f"unexpected {type(problem).__name__}: {problem}", SENTENCE))
    keep_compiled()
    if outcome.error and os.path.exists(output_places(job.log, job.out)[0]):
        outcome = replace(outcome, error=f"{outcome.error} (This log's result files are from an earlier run.)")
    return replace(outcome, total_seconds=time.perf_counter() - began)


def _done(job: Job, progress: Progress | None, visit: Visit | None) -> Outcome:
    from voodoo_jax.batch.extra_files import attempted, extra_files, write_exports, write_view
    from voodoo_jax.batch.resume import fingerprint_of, run_key
    from voodoo_jax.exporters.foxglove import write_tracks_mcap
    from voodoo_jax.exporters.npz import read_tracks_npz, write_tracks_npz
    from voodoo_jax.io.container import LogError
    from voodoo_jax.io.convert.sources import as_mcap
    from voodoo_jax.trackers.base import Unsuitable
    from voodoo_jax.trackers.smoothing import smooth

    key, (place, _, drawn) = "", output_places(job.log, job.out)
    with ExitStack() as stack:
        try:
            log = stack.enter_context(fetched(job.log))
        except Exception as problem:  # every store has its own errors
            raise LogError(f"'{job.log}' cannot be downloaded: {type(problem).__name__}: {problem}") from problem
        original = log
        log, converted = stack.enter_context(as_mcap(log, job.settings.read.types))
        folder = stack.enter_context(delivered(job.out))
        npz, mcap = output_paths(job.log, folder)
        target = npz.with_name(Path(drawn).name)
        for path in (npz, mcap, target, *extra_files(npz, job.exports)):
            remove_partials(path)
        if job.only_picture:
            people = [read_tracks_npz(stack.enter_context(fetched(place)))]
            numbers = range(2, people[0].people + 1)
            people += [read_tracks_npz(stack.enter_context(fetched(person_place(place, k)))) for k in numbers]
        else:
            job.log.encode()  # before hours of work
            for path in (npz, mcap):
                check_writable(path)
            with suppress(OSError):  # before reading: it may be changed meanwhile
                key = run_key(job.recipe, fingerprint_of(original, far=is_url(job.log)))
            try:
                people = track_log(
                    log, on_device(job.body), job.settings, progress, visit, job.timeout, job.style.names
                )
            except (LogError, Unsuitable) as problem:
                raise LogError(str(problem).replace(log, job.log)) from problem
            people = [replace(one, source=job.log, notes=(*converted, *one.notes)) for one in people]
            people = [smooth(one, job.smooth_seconds) for one in people]
            check_names(place, len(people))
            write_tracks_mcap(people, mcap, {**dict(job.parameters), "run_key": key})
            for one in people[::-1]:  # the main one last: where it is, all are
                write_tracks_npz(one, Path(person_place(str(npz), one.person)), key)
            remove_others(place, len(people))
        notes = attempted("picture", lambda: draw(people, target, job.settings, log=log)) if job.picture else []
        drawn = drawn if job.picture and not notes else ""
        notes += write_exports(people, npz, job.exports, job.style)
        notes += write_view(people, npz, job.settings, log) if job.html else []
    others = tuple(outcome_of(job.log, person_place(place, one.person), one) for one in people[1:])
    outcome = outcome_of(job.log, place, people[0], picture=drawn, others=others)
    return replace(outcome, file_notes=tuple(notes), skipped=job.only_picture)


def check_names(place: str, count: int) -> None:
    """Raises LogError if a result file belongs to another log: a log `a.2` has the name of the second person in `a`.
    `place` of the main person's tracks."""
    from voodoo_jax.io.container import LogError

    for person in range(1, count + 1):
        mine = person_place(place, person)
        if (there := _person_in(mine)) not in (None, person):
            raise LogError(f"'{mine}' has the tracks of person {there} of another log: name another --out")


def remove_others(place: str, count: int) -> None:
    """Removes tracks of people beyond this number, which an earlier run found in this log."""
    person = count + 1
    while _person_in(person_place(place, person)) == person:
        removed(person_place(place, person))
        person += 1


def _person_in(place: str) -> int | None:
    """Number of the person in a tracks file, 1 if alone; None: no such file, or no tracks."""
    from voodoo_jax.batch.resume import BROKEN

    try:
        with opened(place) as stream:
            return int(arrays_in(stream, ("person",)).get("person", 1))
    except BROKEN:
        return None


def remove_partials(target: Path) -> None:
    """Removes half-written files of this name whose process has ended: see atomic.replacing."""
    with suppress(OSError):
        for partial in target.parent.glob(f".{escape(target.name)}.*.tmp*"):
            pid = partial.name.rpartition(".tmp")[0].rsplit(".", 1)[-1]
            if pid.isdigit() and not process_runs(int(pid)):
                partial.unlink(missing_ok=True)
