"""What each stage gives where it acts: python -m experiments.ablation.acting RECORDINGS --cases CASES

A stage that changes nothing in a log gives nothing there. So every log of every set is tracked once with all stages,
each of which is watched, and then once more without each stage that did something. Sets: the recordings, every fifth
frame of them, recordings of several people (who is nearest counts), of real sensors, cases from the field, and the
scenes and changed recordings of experiments/stress. Writes acting.md; results are kept in a file of lines as they come,
and a run that is ended early goes on there.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro
from tqdm import tqdm

import voodoo_jax as vj
from experiments.bench.replay_speed import machine
from experiments.common import human, log_files, machine_line, table
from experiments.judged import trials, whole
from experiments.scoreboard.cases import CASES, Near, beside, make
from experiments.scoreboard.tracked import Known, read_known
from experiments.stress.changes import changes
from experiments.stress.scenes import scenes, shoot
from voodoo_jax.config.options import Settings
from voodoo_jax.detect import pipeline as detection
from voodoo_jax.records.recording import Frame
from voodoo_jax.trackers.front import track
from voodoo_jax.trackers.icp import pipeline as icp

CHANGED_LOGS = 9  # every so manieth recording is changed in all ways of experiments/stress
# act in every log: judged on the recordings only
ALWAYS = ("weigh_by_noise", "forward_backward", "fit_forearms", "place_joints")
SAME = 0.0005  # metres of mean joint distance: tracks are the same


@dataclass(frozen=True)
class Job:
    """One log, and the stage that it is tracked without; "": none, and all are watched."""

    group: str
    name: str
    path: str = ""  # of the log; of a scene or a changed recording: what to change
    truth: tuple[str, ...] = ()  # files
    step: int = 1
    case: Near | None = None  # says in which frame the truth is given
    without: str = ""


@dataclass(frozen=True)
class Result:
    """How a log went."""

    group: str
    name: str
    without: str
    error_cm: float  # mean over joints and the truth's times, no answer is 1 m; NaN without a truth
    lost: bool
    unsaid: bool  # more than 20 cm off, and said to be tracked with confidence
    tracked: float  # share of the frames
    acted: tuple[str, ...]  # stages that changed something
    joints: list | None = None  # [frame, joint, 3] a few of them, to compare


def watched(stage: Any, acted: set[str]) -> Callable:
    """The stage's call, which says when it changes something."""
    call = type(stage).__call__

    def run(self: Any, *given: Any) -> Any:
        name = self.name
        if name in {s.name for s in detection.POINTS}:
            before = list(given[0])
            after = list(call(self, before, *given[1:]))
            if any(not _alike(a, b) for a, b in zip(before, after, strict=True)):
                acted.add(name)
            return iter(after)
        after = call(self, *given)
        if name in {s.name for s in detection.SCENE}:
            before, known = given[0], lambda f: (*f.up, *f.scene.floor.normal, f.scene.floor.offset)
            if known(before) != known(after):
                acted.add(name)
            return replace(after, frames=_moving(after.frames, acted)) if name == "steady_sensors" else after
        if hasattr(after, "best"):
            changed = after.best is not given[1].best
        else:
            changed = after is not given[-1] or name == "fit_forearms"
        if changed:
            acted.add(name)
        return after

    return run


def _moving(frames: Iterable[Frame], acted: set[str]) -> Iterator[Frame]:
    """The frames; says when one of them has been moved."""
    for frame in frames:
        if frame.T_fixed_steady is not None:
            acted.add("steady_sensors")
        yield frame


def _alike(one: Any, other: Any) -> bool:
    return one is other or (
        len(one.points) == len(other.points) and np.array_equal(one.points, other.points) and one.doubt == other.doubt
    )


@contextmanager
def watching() -> Iterator[set[str]]:
    """Collects the names of stages that change something."""
    acted: set[str] = set()
    with ExitStack() as stack:
        for stage in (*detection.stages(), *icp.stages()):
            stack.enter_context(patch.object(type(stage), "__call__", watched(stage, acted)))
        yield acted


def settings_of(job: Job) -> Settings:
    """Default settings without the job's stage."""
    settings = Settings()
    if job.without in {s.name for s in detection.stages()}:
        return replace(settings, detect=replace(settings.detect, skip=(job.without,)))
    if job.without:
        return replace(settings, track=replace(settings.track, skip=(job.without,)))
    return settings


def tracked(job: Job) -> tuple[vj.Tracks, list[Known]]:
    """Tracks of the job's log, and who is in it."""
    body, settings = human(), settings_of(job)
    if job.group.startswith("stress"):
        if job.path:
            recorded = changes(body, Settings())[job.name.split(": ")[1]](whole(Path(job.path)))
        else:
            recorded = shoot(job.name, scenes()[job.name]())
        joints = np.where(recorded.there[:, None, None], recorded.joints, np.nan)
        log = recorded.log(body, settings)
        return log.track(body, settings), [Known(recorded.stamps, recorded.names, joints, {})]
    recording = vj.read_log(job.path)
    recording = replace(recording, frames=recording.frames[:: job.step])
    people = []
    for truth in job.truth:
        known = read_known(Path(truth))
        each = known.joints if known.joints.ndim == 4 else known.joints[None]
        people += [known._replace(joints=joints) for joints in each]
    tracks = track(body, recording, settings)
    return tracks, [job.case.placed(known, tracks) for known in people] if job.case else people


def work(job: Job) -> Result:
    """Tracks and judges."""
    try:
        with watching() as acted:
            tracks, people = tracked(job)
    except vj.LogError:
        return Result(job.group, job.name, job.without, float("nan"), False, False, 0.0, ())
    outcomes = [o for known in people if (o := beside(tracks, known)) is not None]
    best = min(outcomes, key=lambda o: np.nanmean(o.error), default=None)
    some = tracks.joints[:: max(1, len(tracks.time_ns) // 20)]
    return Result(
        job.group, job.name, job.without, best.error_cm if best else float("nan"), bool(best and best.grade == 0),
        bool(best and best.wrong_unsaid), float(tracks.tracked.mean()) if len(tracks.time_ns) else 0.0,
        () if job.without else tuple(sorted(acted)), np.round(some, 4).tolist(),
    )  # fmt: skip


def all_jobs(recordings: Path, cases: Path | None, made: Path) -> list[Job]:
    """Every log of every set, with all stages."""
    files = log_files(recordings)
    truth = lambda p: (str(p.with_suffix(".truth.npz")),) if p.with_suffix(".truth.npz").exists() else ()  # noqa: E731
    jobs = [Job("recordings", p.stem, str(p), truth(p)) for p in files]
    jobs += [Job("every fifth frame", p.stem, str(p), truth(p), 5) for p in files]
    for folder in ("people", "real", "real/markers", "markers", "stereo"):
        found = sorted((recordings / folder).glob("*.mcap"))
        jobs += [Job(folder, p.stem, str(p), truth(p)) for p in found[:: 3 if folder == "stereo" else 1]]
    jobs += [Job("stress scenes", name) for name in scenes()]
    for name in changes(human(), Settings()):
        if name not in ("as they are", "every fifth frame"):
            jobs += [Job("stress changes", f"{p.stem}: {name}", str(p)) for p in files[::CHANGED_LOGS]]
    for case, checks in CASES.items() if cases else ():
        assert cases is not None
        folder = made / case
        if not folder.exists():
            folder.mkdir(parents=True)
            make(cases / case, folder)
        for check in checks:
            if isinstance(check, Near) and (log := folder / check.log).is_file():
                known = (
                    folder / check.truth if check.truth.endswith(".npz") else recordings / f"{check.truth}.truth.npz"
                )
                jobs.append(Job("cases", f"{case}/{check.log}", str(log), (str(known),), case=check))
    return jobs


def load(file: Path) -> dict[tuple[str, str, str], Result]:
    """Results so far."""
    lines = file.read_text().splitlines() if file.exists() else []
    found = [Result(**json.loads(line)) for line in lines]
    return {(r.group, r.name, r.without): r for r in found}


def moved(one: Result, other: Result) -> float:
    """Mean distance of joints between two results, metres; NaN: tracked in different frames only."""
    a, b = np.array(one.joints, float), np.array(other.joints, float)
    if a.shape != b.shape or not a.size:
        return 0.0 if a.shape == b.shape else float("nan")
    if (np.isfinite(a) != np.isfinite(b)).any():
        return float("nan")
    away = np.linalg.norm(a - b, axis=-1)
    return float(np.nanmean(away)) if np.isfinite(away).any() else 0.0


def text(found: dict[tuple[str, str, str], Result], note: str) -> str:
    """A row for each stage and set in which it changes tracks."""
    rows = []
    whole_ones = {key[:2]: r for key, r in found.items() if not key[2]}
    groups = list(dict.fromkeys(group for group, _ in whole_ones))
    for stage in (*detection.stages(), *icp.stages()):
        for group in groups:
            of_group = {k: r for k, r in whole_ones.items() if k[0] == group}
            pairs = [(r, found[(*k, stage.name)]) for k, r in of_group.items() if (*k, stage.name) in found]
            pairs = [(a, b) for a, b in pairs if not moved(a, b) < SAME]
            if not pairs:
                continue
            judged = [(a, b) for a, b in pairs if np.isfinite(a.error_cm) and np.isfinite(b.error_cm)]
            mean = [f"{np.mean([p[k].error_cm for p in judged]):.2f}" if judged else "" for k in (0, 1)]
            better = sum(a.error_cm < b.error_cm - 0.1 for a, b in judged)
            worse = sum(a.error_cm > b.error_cm + 0.1 for a, b in judged)
            lost, unsaid = ([sum(getattr(p[k], what) for p in judged) for k in (0, 1)] for what in ("lost", "unsaid"))
            rows.append([
                stage.name, group, f"{len(pairs)} of {len(of_group)}", *mean, f"{better} / {worse}",
                f"{lost[0]} / {lost[1]}", f"{unsaid[0]} / {unsaid[1]}",
            ])  # fmt: skip
    head = ["stage", "set", "logs that it changes", "with it, cm", "without it, cm", "better / worse by 1 mm",
            "lost with / without", "wrong unsaid with / without"]  # fmt: skip
    silent = [s.name for s in (*detection.stages(), *icp.stages()) if s.name not in {row[0] for row in rows}]
    return f"{note}\n{table(head, rows)}\n\nStages that change no log: {', '.join(silent) or 'none'}.\n"


def main(
    recordings: tyro.conf.Positional[Path],
    cases: Path | None = None,
    made: Path = Path("build/cases"),
    kept: Path = Path("build/acting.jsonl"),
    only: tuple[str, ...] = (),
    processes: int = 2,
    out: Path = Path(__file__).parent,
) -> None:
    """What each stage gives where it acts.

    Args:
        recordings: folder with *.mcap, *.truth.npz and the folders people, real, markers and stereo.
        cases: folder with a folder for each case from the field.
        made: where the logs of the cases are made.
        kept: file to which results are added, a line each.
        only: sets to do; none named: all.
        processes: how many work at once.
        out: folder for acting.md.
    """
    before, found = machine(), load(kept)
    kept.parent.mkdir(parents=True, exist_ok=True)
    jobs = [job for job in all_jobs(recordings, cases, made) if not only or job.group in only]

    def do(some: list[Job]) -> None:
        left = [job for job in some if (job.group, job.name, job.without) not in found]
        for result in tqdm(trials(work, left, processes), total=len(left), leave=False, disable=None):
            found[result.group, result.name, result.without] = result
            with kept.open("a") as file:
                file.write(json.dumps(asdict(result)) + "\n")
            (out / "acting.md").write_text(text(found, machine_line(before)))

    do(jobs)
    do([replace(job, without=stage) for job in jobs for stage in found[job.group, job.name, ""].acted
        if stage not in ALWAYS or job.group == "recordings"])  # fmt: skip
    (out / "acting.md").write_text(text(found, machine_line(before)))


if __name__ == "__main__":
    tyro.cli(main)
