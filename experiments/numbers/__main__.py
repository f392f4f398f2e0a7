"""What do the trackers' numbers change? python -m experiments.numbers LOG.mcap ... --parts rating --kept logs.pkl

People are found once. Each number is then made 1.5 times as large and as small, one at a time (counts are rounded), and
what it says is judged: joints, and how far the confidence may be trusted. Numbers that only rate what was tracked are
tried on kept tracks; others track anew, those of a stage in the logs in which that stage changes something. Results are
added to a file of lines; numbers.md is made of these.
"""

import importlib
import json
import pickle
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import tyro
from scipy.stats import rankdata

from experiments.common import human, table
from experiments.scoreboard.cases import beside
from experiments.scoreboard.tracked import Known, Outcome, read_known
from experiments.sensitivity import FACTORS, changed
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.opening import open_checked
from voodoo_jax.detect.pipeline import find_people
from voodoo_jax.records.scene import Subject
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import LogInfo, Task
from voodoo_jax.trackers.icp import misfit, people, pipeline, tracker
from voodoo_jax.trackers.of_points import PointTracker
from voodoo_jax.trackers.shared.runner import spans

TRACKERS, OUT = "voodoo_jax.trackers.", Path(__file__).with_name("numbers.md")
# of each part, the modules and their numbers
RATING = {
    "icp.misfit": ("POINTS", "EXPLAINED", "AROUND", "OWN", "NOISE", "USUAL", "ALONG", "WIDER"),
    "shared.confidence": (
        "AROUND", "DEEP", "TOGETHER", "PLENTY", "USUAL", "UNUSUAL", "SMALL", "LEAST_SHARE", "LEAST_DISTANCE",
    ),
    "icp.refine.hang_legs": ("HIDDEN",),
    "icp.refine.hang_arms": ("OWN", "SOME", "BARE", "APART"),
}  # fmt: skip
PEOPLE = {"icp.people": ("MOVED", "FRAMES", "SLIVER", "WHOLE", "CLOSE", "AROUND")}


class Found(NamedTuple):
    """A log whose people are found, and the truth."""

    name: str
    people: list[Subject]
    known: list[Known]


class Judged(NamedTuple):
    """A log's tracks beside the truth."""

    error: float  # of joints, mean, cm
    said: np.ndarray  # probabilities that joints are within 10 cm
    right: np.ndarray  # whether they are

    @property
    def loss(self) -> float:
        """Mean of minus the logarithm of the probability said of what is."""
        said = np.clip(np.where(self.right, self.said, 1 - self.said), 0.01, 1.0)
        return float(-np.log(said).mean()) if len(said) else float("nan")


def read(path: Path, seconds: float) -> Found:
    """The people of the first seconds of a log, and the truth beside it."""
    reader = open_checked(path)
    frames = []
    for frame in reader.frames():
        if frames and frame.time_ns - frames[0].time_ns > seconds * 1e9:
            break
        frames.append(replace(frame, pictures=()))
    truth, known = path.with_suffix(".truth.npz"), list[Known]()
    if truth.exists():
        one = read_known(truth)
        known = [one._replace(joints=j) for j in (one.joints if one.joints.ndim == 4 else one.joints[None])]
    subjects = [replace(s, frames=list(s.frames)) for s in find_people(frames, reader.up, human(), Settings())]
    return Found("/".join(path.parts[-2:]), subjects, known)


def judge(tracks: list[Tracks], known: list[Known]) -> Judged:
    """Each known person beside the tracks that are nearest."""
    each = [[o for t in tracks if (o := beside(t, one)) is not None] for one in known]
    best: list[Outcome] = [min(some, key=lambda o: np.nanmean(o.error)) for some in each if some]
    told = [np.isfinite(o.confidence) & np.isfinite(o.error) for o in best]
    said, right = [o.confidence[t] for o, t in zip(best, told)], [o.error[t] < 0.1 for o, t in zip(best, told)]
    error = float(np.mean([o.error_cm for o in best])) if best else float("nan")
    return Judged(error, np.concatenate([np.zeros(0), *said]), np.concatenate([np.zeros(0, bool), *right]))


def tracked(log: Found, settings: Settings | None = None) -> list[Tracks]:
    settings = settings or Settings()
    return PointTracker().follow(Task(human(), LogInfo(log.name), settings), log.people)


def unplaced(log: Found) -> list[tracker.Unplaced]:
    """The people of a log with final poses, before anything is said of them."""
    kept: list[tracker.Unplaced] = []
    with patch.object(people, "placed", lambda one: (kept.append(one), tracker.placed(one))[1]):
        tracked(log)
    return kept


def rated(one: tracker.Unplaced) -> Tracks:
    """Kept poses, rated anew."""
    run, t = one.run, one.tracks
    if all(frame.T_fixed_steady is None for frame in run.people):  # else points are elsewhere than poses
        each = [
            misfit.misfit(body, t.rotation[a:b], t.translation[a:b], run.people[a:b])
            for a, b, body in spans(run.bodies, len(t.time_ns))
        ]
        fit = misfit.Misfit(*map(np.concatenate, zip(*each)))
        t = t.having(limb_beside=fit.beside, limb_distance=fit.distance, limb_bare=fit.bare, limb_own=fit.own)
    return tracker.in_places(run, t)


def values(owner: Any, name: str) -> Iterator[tuple[str, Any]]:
    """A number's label and other values: each of a tuple alone."""
    value = getattr(owner, name)
    every = value if isinstance(value, tuple) else (value,)
    for at, one in enumerate(every):
        for factor in FACTORS if isinstance(one, int | float) else ():
            new = max(round(one * factor), 1) if isinstance(one, int) else one * factor
            new += isinstance(one, int) and one % 2 and 1 - new % 2  # windows stay odd
            if new != one:
                both = (*every[:at], new, *every[at + 1 :]) if isinstance(value, tuple) else new
                yield f"{f'{name}[{at}]' if isinstance(value, tuple) else name} {one:g} -> {new:.3g}", both


def compare(label: str, now: dict[str, Judged], before: dict[str, Judged], file: Path) -> None:
    """Adds a line of what a change gives."""
    some = [n for n in now if np.isfinite(before[n].error)]
    off = np.array([now[n].error - before[n].error for n in some])
    loss = np.array([now[n].loss - before[n].loss for n in some])
    loss = loss[np.isfinite(loss)]
    spread = lambda x: float(np.std(x) / max(len(x), 1) ** 0.5)  # noqa: E731
    auc = np.nanmean([auroc(now[n]) - auroc(before[n]) for n in some]) if some else float("nan")
    worst = max(some, key=lambda n: abs(now[n].error - before[n].error), default="")
    line = {
        "number": label, "logs": len(some), "differ": int((np.abs(off) > 1e-3).sum()),
        "error": [float(off.mean()) if some else 0.0, spread(off)],
        "loss": [float(loss.mean()) if len(loss) else 0.0, spread(loss)], "auroc": float(auc),
        "most": [worst, float(off[some.index(worst)]) if some else 0.0],
    }  # fmt: skip
    with file.open("a") as out:
        out.write(json.dumps(line) + "\n")
    print(line, flush=True)


def auroc(one: Judged) -> float:
    """How often what is right is trusted above what is wrong."""
    right, wrong = int(one.right.sum()), int((~one.right).sum())
    if not right or not wrong:
        return float("nan")
    return float((rankdata(one.said)[one.right].sum() - right * (right + 1) / 2) / (right * wrong))


def of_modules(chosen: dict[str, tuple[str, ...]]) -> Iterator[tuple[str, Any, str, Any]]:
    """Label, module, name and other value of numbers."""
    for module, names in chosen.items():
        owner = importlib.import_module(TRACKERS + module)
        for name in names:
            yield from ((f"{module}.{label}", owner, name, new) for label, new in values(owner, name))


def of_stage(stage: Any) -> Iterator[tuple[str, Any, str, Any]]:
    """The same of a stage's."""
    for field in fields(stage):
        if isinstance(getattr(stage, field.name), int | float | tuple) and field.name != "among":
            yield from ((f"{stage.name}.{label}", stage, field.name, new) for label, new in values(stage, field.name))


def without(name: str) -> Settings:
    return replace(Settings(), track=replace(Settings().track, skip=(name,)))


def text(lines: Iterable[dict]) -> str:
    """A row for each change."""
    rows = [
        [
            one["number"], f"{one['differ']} of {one['logs']}", f"{one['error'][0]:+.3f} +- {one['error'][1]:.3f}",
            f"{one['loss'][0]:+.4f} +- {one['loss'][1]:.4f}", f"{one['auroc']:+.4f}",
            f"{one['most'][0]} {one['most'][1]:+.2f}" if one["differ"] else "",
        ]
        for one in lines
    ]  # fmt: skip
    head = ["number", "logs whose joints differ", "error, cm", "log loss of the confidence", "AUROC", "most, cm"]
    return f"{table(head, rows)}\n"


def main(
    logs: tyro.conf.Positional[tuple[Path, ...]] = (),
    parts: tuple[str, ...] = ("rating",),
    seconds: float = 8.0,
    kept: Path = Path("build/numbers.pkl"),
    lines: Path = Path("build/numbers.jsonl"),
    out: Path = OUT,
) -> None:
    """What the numbers of the trackers change.

    Args:
        logs: recordings with their truth beside them.
        parts: rating, people (logs of several), or names of stages.
        seconds: of each log.
        kept: file that keeps found people between runs.
        lines: file to which results are added.
        out: the table of all results.
    """
    warnings.simplefilter("ignore", RuntimeWarning)
    kept.parent.mkdir(parents=True, exist_ok=True)
    found: list[Found] = pickle.loads(kept.read_bytes()) if kept.exists() else [read(p, seconds) for p in logs]
    kept.write_bytes(pickle.dumps(found))
    for part in parts:
        again: Callable[[], dict[str, Judged]]
        if part == "rating":
            each = {log.name: (unplaced(log), log.known) for log in found}
            again = lambda each=each: {n: judge([*map(rated, some)], known) for n, (some, known) in each.items()}  # noqa: E731
            every = of_modules(RATING)
        elif part == "people":
            some = [log for log in found if len(log.people) > 1]
            again = lambda some=some: {log.name: judge(tracked(log), log.known) for log in some}  # noqa: E731
            every = of_modules(PEOPLE)
        else:
            stage = next(one for one in pipeline.stages() if one.name == part)
            without_it = {log.name: judge(tracked(log, without(part)), log.known) for log in found}
            with_it = {log.name: judge(tracked(log), log.known) for log in found}
            some = [log for log in found if with_it[log.name].error != without_it[log.name].error]
            compare(f"{part}: without it", without_it, with_it, lines)
            again = lambda some=some: {log.name: judge(tracked(log), log.known) for log in some}  # noqa: E731
            every = of_stage(stage)
        before = again()
        for label, owner, name, value in every:
            with changed(owner, name, value):
                compare(label, again(), before, lines)
        out.write_text(text(json.loads(line) for line in lines.read_text().splitlines()))


if __name__ == "__main__":
    tyro.cli(main)
