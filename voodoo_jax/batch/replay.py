"""Many logs: selects and distributes them and collects the outcomes; a log that fails does not stop the others."""

import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from typing import Literal

from tqdm.auto import tqdm  # a bar in terminals and notebooks alike, 1 MB

from voodoo_jax.batch.log_job import Job, draw, output_paths, output_places, track_log
from voodoo_jax.batch.outcome import Outcome, outcome_of_arrays
from voodoo_jax.batch.output_paths import folders_within, largest_first, logs_of, parse_shard, shard_of
from voodoo_jax.batch.process_pool import Report, Results, default_workers, in_process, in_workers, may_have_gpu
from voodoo_jax.batch.worker_start import can_copy, in_a_copy
from voodoo_jax.compile.cache_dir import safe_folder
from voodoo_jax.config.options import Settings, SettingsError
from voodoo_jax.config.output_style import Style
from voodoo_jax.config.ray_tasks import RayTasks, check_ray_tasks
from voodoo_jax.geometry.rigid import on_device
from voodoo_jax.model.body import Body
from voodoo_jax.records.notes import shown
from voodoo_jax.storage.atomic import check_writable, made_folder
from voodoo_jax.storage.troubles import NotWritten, check_text, not_written
from voodoo_jax.storage.urls import NPZ, byte_size, expanded, file_system, is_url, joined, person_place

__all__ = ["NotSummedUp", "Outcome", "draw", "output_paths", "replay", "track_log"]

SMOOTHEST = 1000.0  # seconds over which tracks may be averaged
LONGEST = 1e6  # seconds, eleven days: timers take no more than some hundred years
SUMMARY_SECONDS = 30.0  # the summary is written so often while logs are being done


def check_changes(body: Body, settings: Settings) -> None:
    """Raises SettingsError for changes that cannot be made to a body: once, before the logs are read."""
    if settings.changes and (problem := in_a_copy(_trouble_of_changes, body, settings)):
        raise SettingsError(problem)


def _trouble_of_changes(body: Body, settings: Settings) -> str:
    from voodoo_jax.model.attachments import loaded, prepared
    from voodoo_jax.model.body_file import BodyFileError

    try:
        prepared(on_device(body), loaded(settings.changes))
    except (SettingsError, BodyFileError) as problem:
        return str(problem)
    return ""


class NotSummedUp(NotWritten):
    """All logs are finished, but replay.jsonl or report.html could not be written; `outcomes` has the results."""

    def __init__(self, text: str, outcomes: list[Outcome]):
        super().__init__(text)
        self.outcomes = outcomes


# 19 parameters, the options of the command, each by name; half of the lines say what they are
def replay(
    logs: Iterable[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    body: Body | None = None,
    settings: Settings | None = None,
    quiet: bool = False,
    smooth_seconds: float = 0.0,
    *,
    picture: bool = False,
    html: bool = False,
    report: bool = False,
    export: Iterable[str] = (),
    style: Style | None = None,
    again: bool = False,
    verbose: bool = False,
    workers: int = 1,
    engine: Literal["local", "batch", "ray"] = "local",
    shard: str = "",
    compile_cache: str = "",
    log_timeout: float = 0.0,
    ray: RayTasks | None = None,
) -> list[Outcome]:
    """Tracks a body in each log and writes `<stem>.tracks.npz` and `<stem>.voodoo.mcap` into `out`. Results of logs
    below a given folder keep the folder structure (see output_paths.py).

    A log that cannot be read or tracked is reported in its Outcome, and the others are tracked. Files appear under
    their final names only when complete. Logs that an earlier run has finished with the same settings, body and version
    are skipped. `replay.jsonl` in `out` has a line for each person of each log. `<stem>.tracks.npz` has the person in
    view for longest, `<stem>.2.tracks.npz`, ... have the others, and `<stem>.voodoo.mcap` shows all.

    **Arguments:** `logs` and `out` paths, or URLs (see storage/urls.py); `smooth_seconds` see
    trackers.smoothing.smooth; `picture` also draws `<stem>.png`; `html` writes `<stem>.html`, a page for a browser;
    `report` writes `report.html`, with a row for each log with results in `out`; `export` further formats of the tracks
    (exporters/formats.py), such as "bvh"; `style` names of joints and bones; `again` tracks finished logs again;
    `verbose` also prints notes that need no action; `workers` number of tracking processes, 0: chosen for this machine,
    1: a copy of this process, or this one if it cannot be copied (see worker_start.py); `engine` "batch": in this
    process, several logs as one batch on all of JAX's devices; "ray": on a Ray cluster; `shard` "2/8": only the second
    of eight parts of the logs; `compile_cache` folder for compiled programs, "": the user's, "off": none; `log_timeout`
    seconds after which a log fails, 0: never; `ray` resources of each log on a Ray cluster.

    **Returns:** an Outcome for each log (of the shard), in the order of `logs`.

    Raises ValueError if two logs would write the same files, or an argument cannot be used; NotWritten if nothing can
    be written in `out`; NotSummedUp, after all logs, if replay.jsonl or the report cannot be written.
    """
    from voodoo_jax.batch.resume import recipe_key
    from voodoo_jax.batch.summary_file import summary_name, write_summary
    from voodoo_jax.exporters.formats import check_formats
    from voodoo_jax.model.body_file import load_on_host
    from voodoo_jax.trackers.stages import check_stages

    if not 0 <= smooth_seconds <= SMOOTHEST:
        raise ValueError(f"--smooth {smooth_seconds}: must not be negative, and at most {SMOOTHEST:g} seconds")
    if workers < 0:
        raise ValueError(f"--workers {workers}: must be 1 or more, or 0 for a number that suits this machine")
    if not 0 <= log_timeout <= LONGEST:
        raise ValueError(f"--log-timeout {log_timeout}: must not be negative, and at most {LONGEST:g} seconds")
    tasks, style = ray or RayTasks(), style or Style()
    check_ray_tasks(tasks)
    check_stages(settings or Settings())
    check_changes(body or load_on_host("human"), settings or Settings())
    if settings is not None and settings.read.pose_net:
        from voodoo_jax.sensors.pose_net import check_pose_net

        check_pose_net(settings.read.pose_net)  # here, not once for each log
    exports = check_formats(export)
    number, count = parse_shard(shard)
    summary = summary_name(number, count)
    named = [(_absolute(log), _absolute(place)) for log in logs for place in expanded(log)]
    within = folders_within(logs_of(named))
    places = list(within)
    out, settings, body = _absolute(out), settings or Settings(), body or load_on_host("human")
    check_text(out, "--out")
    if not is_url(out):
        made_folder(out)
    places = shard_of(places, number, count)
    job = Job(
        log="",
        out=out,
        body=body,
        settings=settings,
        smooth_seconds=smooth_seconds,
        recipe=recipe_key(body, settings, smooth_seconds, style),
        parameters=parameters_of(settings, smooth_seconds),
        picture=picture,
        exports=exports,
        style=style,
        html=html,
        compile_cache=safe_folder(compile_cache),
        timeout=log_timeout,
    )
    jobs = {log: replace(job, log=log, out=joined(out, within[log]), size=max(1, byte_size(log))) for log in places}
    done: dict[str, Outcome] = {}
    save = partial(_trouble_of, lambda: write_summary(done.values(), out, summary), joined(out, summary))
    with ThreadPoolExecutor(8) as several:  # a store's answers take long
        for log, found in zip(places, several.map(partial(_finished, again=again), jobs.values())):
            if found is not None and found.picture == "due":
                jobs[log] = replace(jobs[log], only_picture=True)
            elif found is not None:
                done[log] = replace(found, folder=within[log])
                _say(done[log], quiet, verbose)
    if len(done) < len(places) and not is_url(out):
        check_writable(joined(out, "replay"))
    left = largest_first([log for log in places if log not in done], {log: jobs[log].size for log in places})
    ordered, saved = [jobs[log] for log in left], time.monotonic()
    sizes = [job.size for job in ordered]
    shares = [0.0] * len(ordered)

    def advance(which: int, share: float) -> None:
        bar.update(round(sizes[which] * share) - round(sizes[which] * shares[which]))
        shares[which] = share

    try:
        # before the bar, which has a thread of its own
        results = _engine(ordered, advance, engine, workers, tasks)
        with tqdm(total=sum(sizes), unit="B", unit_scale=True, disable=quiet or None, leave=False) as bar:
            bar.set_description(f"{len(done)}/{len(places)} logs")
            with closing(results):
                for which, outcome in results:
                    done[outcome.path] = outcome = replace(outcome, folder=within[outcome.path])
                    advance(which, 1.0)
                    bar.set_description(f"{len(done)}/{len(places)} logs")
                    _say(outcome, quiet, verbose)
                    if time.monotonic() - saved > SUMMARY_SECONDS:
                        save()
                        saved = time.monotonic()
    finally:
        unsaved = save()
    outcomes = [done[log] for log in places]
    if report:
        from voodoo_jax.batch.report import NAME, write_report

        unreported = _trouble_of(lambda: write_report(out, summary), joined(out, NAME))
    if trouble := [*unsaved, *(unreported if report else [])]:
        raise NotSummedUp("; ".join(trouble), outcomes)
    return outcomes


def _trouble_of(write: Callable[[], object], place: str) -> list[str]:
    """Writes a summary file. Returns why that failed, which is reported at the end and does not stop the logs."""
    try:
        write()
    except Exception as problem:  # every store has its own errors
        if isinstance(problem, OSError) and problem.errno:
            return [str(not_written(problem, place))]
        return [f"'{place}' cannot be written: {problem or type(problem).__name__}"]
    return []


def _engine(
    jobs: list[Job], report: Report, engine: Literal["local", "batch", "ray"], workers: int, ray: RayTasks
) -> Results:
    """Number and outcome of each finished job."""
    if engine == "ray":
        from voodoo_jax.batch.ray_cluster import on_ray

        return on_ray(jobs, report, ray)
    if engine == "batch":
        from voodoo_jax.batch.lanes import in_batch

        return in_batch(jobs, report)
    count = min(workers or default_workers(len(jobs)), len(jobs))
    # what is in this process's memory no other can read
    within = any(place.startswith("memory://") for job in jobs for place in (job.log, job.out))
    # one worker too where it starts at once, as a copy: a log that ends it ends no more than that
    alone = count <= 1 and not (jobs and can_copy() and not may_have_gpu())
    return in_process(jobs, report) if alone or within else in_workers(jobs, report, count)


def _finished(job: Job, again: bool) -> Outcome | None:
    """The outcome of an earlier run, its `picture` "due" if it is wanted and missing or old; None: no such run."""
    from voodoo_jax.batch.extra_files import VIEW, exported_name
    from voodoo_jax.batch.resume import finished_arrays

    npz, mcap, png = output_places(job.log, job.out)
    arrays = None if again else finished_arrays(job.log, npz, mcap, job.recipe)
    if arrays is None:
        return None
    wanted = [png] if job.picture else []
    wanted += [npz.removesuffix(NPZ) + VIEW] if job.html else []
    wanted += [joined(job.out, exported_name(npz, name)) for name in job.exports]
    due = bool(wanted) and min(map(_changed, wanted)) < _changed(npz)
    drawn = "due" if due else png if job.picture else ""
    others = (
        outcome_of_arrays(job.log, person_place(npz, number), one, skipped=True)
        for number, one in enumerate(arrays[1:], 2)
    )
    return outcome_of_arrays(job.log, npz, arrays[0], skipped=True, picture=drawn, others=tuple(others))


def _changed(place: str) -> float:
    """Modification time of a file in seconds; 0 if it does not exist, or its store does not say."""
    try:
        if not is_url(place):
            return os.stat(place).st_mtime
        system, path = file_system(place)
        return system.modified(path).timestamp()
    except (OSError, NotImplementedError, KeyError):
        return 0.0


def _absolute(place: str | os.PathLike[str]) -> str:
    """An absolute place for other processes; file:// URLs as paths. Raises ValueError if fsspec lacks a package."""
    place = os.fspath(place)
    if is_url(place):
        path = file_system(place)[1]
        return path if place.startswith("file://") else place
    try:
        return os.path.abspath(os.path.expanduser(place))
    except FileNotFoundError as problem:
        raise ValueError(f"'{place}': the current folder no longer exists; change to another one") from problem


def parameters_of(settings: Settings, smooth_seconds: float = 0.0) -> tuple[tuple[str, str], ...]:
    """All settings as text."""
    every = asdict(settings)
    stages = {stage: values for stage, values in every.items() if isinstance(values, dict)}
    out = {f"{stage}.{k}": str(v) for stage, values in stages.items() for k, v in values.items()}
    out |= {name: str(every[name]) for name in every if name not in (*stages, "changes")}
    out["smooth_seconds"] = str(smooth_seconds)
    return tuple((out | {f"change.{n}": str(change) for n, change in enumerate(settings.changes, 1)}).items())


def _say(outcome: Outcome, quiet: bool, verbose: bool) -> None:
    if not quiet:
        tqdm.write(shown(outcome.words(verbose)))
