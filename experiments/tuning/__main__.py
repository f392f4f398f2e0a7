"""Do weights, options and the template gain by gradients, on people left out? python -m experiments.tuning RECORDINGS

Parts: `curves` the loss along each number, one at a time; `weights`, `template`, `body` and so on (see FREE) tuned on
some people, scored on the others, by folds of people. Writes a table for each part, and a figure of the curves.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import jax
import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.figure import Figure
from tqdm import tqdm

import voodoo_jax as vj
from experiments.common import Log, human, load_dims, load_log, log_files, score, table, write
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.frames import Truth
from voodoo_jax.fitting.parameters import changed, named_changes, parameters
from voodoo_jax.fitting.problem import Problem
from voodoo_jax.fitting.seen import Seen
from voodoo_jax.fitting.tuning import Tuned
from voodoo_jax.model.body import Body

WEIGHTS = ("bands.*.weight", "solve.*", "track.*", "features.*.weight")
FREE = {
    "weights": WEIGHTS,
    # what is left when bands stay as they are, whose gaps the stage that places joints was learned with
    "prediction": ("solve.prior*", "solve.robust_scale", "solve.steady*", "track.*", "features.*.weight"),
    "template": ("lengths.*", "radii.*", "anchors.*"),
    "girths": ("radii.*",),
    "body": ("bands.*.weight", "radii.*", "anchors.*"),
}
Part = Literal["curves", "weights", "prediction", "template", "girths", "body"]
AT = (-1.0, -0.5, 0.5, 1.0)  # of a parameter's usual deviation
FIRST = 16  # frames that are not scored: half a second, see common.SKIP


@dataclass(frozen=True)
class Case:
    """A recording, tracked by the package's body and settings, and made ready for gradients."""

    log: Log
    stature: float
    problem: Problem
    error_cm: float  # of all of it, tracked

    @property
    def name(self) -> str:
        return self.log.name


def prepared(files: list[Path], frames: int, points: int) -> list[Case]:
    """The recordings whose features most of them have: they share one program."""
    settings, found = Settings(), []
    for file in tqdm(files, "track", leave=False, disable=None):
        log = load_log(file, human(), settings)
        tracks = log.track(human(), settings)
        seen, truth = Seen(tracks, log.people, log.scene, human()), Truth(log.stamps, log.names, log.joints)
        size = dict(first=FIRST, frames=frames, points=points, room=frames)
        one = vj.problem(human(), seen, settings, truth=truth, **size)
        found.append(Case(log, round(load_dims(file)["stature"], 3), one, score(log, tracks).error_cm))
    kinds = [case.problem.features for case in found]
    usual = max(kinds, key=kinds.count)
    return [case for case in found if case.problem.features == usual]


def fold_of(cases: list[Case], folds: int) -> dict[str, int]:
    """The fold in which each recording is left out: all of one person in one, statures mixed."""
    people = sorted({case.stature for case in cases})
    return {case.name: people.index(case.stature) % folds for case in cases}


@partial(jax.jit, static_argnums=0)
def _loss(names: tuple[str, ...], values: jax.Array, problem: Problem) -> jax.Array:
    return vj.loss.joints(vj.solved(dict(zip(names, values)), problem), problem)


def losses(cases: list[Case], names: tuple[str, ...], values: np.ndarray) -> np.ndarray:
    """The loss of each recording, cm."""
    return 100 * np.array([float(_loss(names, np.asarray(values, np.float32), case.problem)) for case in cases])


def curves(cases: list[Case], free: tuple[str, ...], out: Path) -> None:
    """The loss of each recording along each parameter, all others as they are."""
    known = parameters(cases[0].problem.body, free, cases[0].problem.features)
    none = np.zeros(len(known.names))
    start, found = losses(cases, known.names, none), []
    for k in tqdm(range(len(none)), "along", leave=False, disable=None):
        found.append([losses(cases, known.names, none + at * known.sd * (np.arange(len(none)) == k)) for at in AT])
    told(known.names, known.sd, start, np.array(found), out)


def told(names: tuple[str, ...], sd: np.ndarray, start: np.ndarray, found: np.ndarray, out: Path) -> None:
    """Table and figure of losses `found` [parameter, step, recording], cm: the mean's change from the `start`, and the
    error of that."""
    change = 100 * (found - start) / start.mean()
    mean, doubt = change.mean(2), change.std(2, ddof=1) / np.sqrt(len(start))
    clear = (mean < -2 * doubt).any(1)
    rows = [
        [name, f"{np.exp(one):.2f}", *(f"{m:+.1f} +- {d:.1f}" for m, d in zip(*row)), "yes" if better else "no"]
        for name, one, better, *row in zip(names, sd, clear, mean, doubt)
    ]
    head = ["parameter", "factor of 1 deviation", *(f"{at:+.1f}" for at in AT), "better by two errors"]
    text = (
        f"{len(start)} recordings, loss {start.mean():.3f} cm at the package's numbers. Its change in percent, and the "
        f"standard error of that over recordings, at so many usual deviations from there; {clear.sum()} of {len(rows)} "
        f"parameters are better anywhere by two errors:\n\n{table(head, rows)}"
    )
    write(out, "curves", text, _drawn(names, mean, doubt))


def _drawn(names: tuple[str, ...], mean: np.ndarray, doubt: np.ndarray) -> Figure:
    """A small panel for each parameter."""
    wide = 6
    high = -(-len(names) // wide)
    figure, panels = plt.subplots(
        high, wide, figsize=(12, 1.9 * high), sharex=True, sharey=True, layout="constrained", squeeze=False
    )
    at, middle = np.insert(AT, 2, 0.0), lambda row: np.insert(row, 2, 0.0)
    for panel, name, *row in zip(panels.flat, names, mean, doubt):
        change, error = map(middle, row)
        panel.axhline(0, color="0.7", lw=0.8)
        panel.fill_between(at, change - 2 * error, change + 2 * error, alpha=0.25)
        panel.plot(at, change, "o-", ms=3)
        panel.set_title(name, fontsize=8)
    for panel in panels.flat[len(names) :]:
        panel.axis("off")
    panels.flat[0].set_ylim(-8, 12)
    figure.supxlabel("usual deviations from the package's number")
    figure.supylabel("change of the loss, %; shaded: two errors")
    return figure


def with_found(found: Tuned) -> tuple[Body, Settings]:
    """The package's body and settings with what was found."""
    one = found.problems[0]
    sensors = one.frames.points.origins.shape[-2]
    by = named_changes(human(), found.parameters, one.features, sensors)
    return changed(human(), by), found.settings(Settings())


# 6 parameters: what is tuned, and how long
def left_out(cases: list[Case], what: str, folds: int, steps: int, pull: float, out: Path) -> None:
    """Tuned on all people but those of a fold, and scored on these."""
    fold, rows, found = fold_of(cases, folds), [], []
    for k in range(folds):
        train, test = ([case for case in cases if (fold[case.name] == k) == left] for left in (False, True))
        train = train[: min(len(cases) - list(fold.values()).count(j) for j in range(folds))]  # one program for all
        if not train or not test:
            raise SystemExit("there are fewer people than folds")
        tuned = vj.tune([case.problem for case in train], FREE[what], steps=steps, pull=pull, say=_told)
        found.append(tuned.parameters)
        names, values = zip(*tuned.parameters.items())
        body, settings = with_found(tuned)
        for some, left in ((train, ""), (test, "left out")):
            before, after = (losses(some, names, np.array(values) * by) for by in (0.0, 1.0))
            whole = [score(case.log, case.log.track(body, settings)).error_cm for case in some]
            rows += [
                [case.name, str(k), left, *(f"{x:.3f}" for x in (*at, case.error_cm, now))]
                for case, *at, now in zip(some, before, after, whole)
            ]
        tqdm.write(f"fold {k}: {tuned.before:.5f} -> {tuned.after:.5f}, finished {tuned.finished}")
    means = []
    for left in ("", "left out"):
        some = np.array([[float(x) for x in row[3:]] for row in rows if row[2] == left])
        mean, count = some.mean(0), len(some)
        change = [100 * (some[:, k + 1] - some[:, k]) / mean[k] for k in (0, 2)]
        cells = [f"{c.mean():+.1f} +- {c.std(ddof=1) / np.sqrt(count):.1f}" for c in change]
        means.append(
            [left or "tuned on", *(f"{x:.3f}" for x in mean[:2]), cells[0], *(f"{x:.3f}" for x in mean[2:]), cells[1]]
        )
    head = ["people", "loss, cm", "tuned", "change, %", "joints as tracked, cm", "tuned", "change, %"]
    factors = [[n, *(f"{values.get(n, 0.0):+.3f}" for values in found)] for n in found[0]]
    text = (
        f"{len(cases)} recordings, {folds} folds of people, {steps} steps, pull {pull:g}.\n\n{table(head, means)}\n"
        f"What was found, logarithms of factors (places: shares of the stature), by fold left out:\n\n"
        f"{table(['parameter', *map(str, range(folds))], factors)}"
    )
    write(out, what, text)


def _told(value: float, parameters: dict[str, float]) -> None:
    tqdm.write(f"  {100 * value:.3f} cm")


# 8 parameters: which recordings, what of them, and how long
def main(
    recordings: tyro.conf.Positional[Path],
    parts: tuple[Part, ...] = ("curves", "prediction", "weights", "template"),
    every: int = 1,
    frames: int = 64,
    points: int = 256,
    folds: int = 2,
    steps: int = 15,
    pull: float = 0.005,
    out: Path = Path(__file__).parent,
) -> None:
    """Tables and a figure.

    Args:
        recordings: folder with *.mcap and *.truth.npz of several people.
        parts: of the experiment.
        every: take every N-th recording.
        frames: of a recording that are solved, after the first half second.
        points: of a frame that are solved on.
        folds: of people.
        steps: of a search.
        pull: of the priors, see vj.tune.
        out: folder for curves.md, weights.md and so on.
    """
    cases = prepared(log_files(recordings)[::every], frames, points)
    for part in parts:
        if part == "curves":
            curves(cases, WEIGHTS, out)
        else:
            left_out(cases, part, folds, steps, pull, out)


if __name__ == "__main__":
    tyro.cli(main)
