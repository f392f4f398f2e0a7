"""What is survived, and what is honestly reported as lost: python -m experiments.stress [RECORDINGS]

Changed recordings: every change of changes.py on every log. Simulated scenes: those of scenes.py. Nothing is given, the
settings are the defaults. A time counts in the scores while the person is wholly in view; claims count at all times.
Rows are printed and written as they come: a run that is ended early keeps them. Writes stress.md and stress.png.
"""

from fnmatch import fnmatch
from pathlib import Path
from typing import Literal

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.common import DEMO, human, log_files, table, write
from experiments.judged import HEAD, HONEST_HEAD, Verdict, cells, honest_cells, trials
from experiments.stress.changes import changes
from experiments.stress.scenes import scenes
from experiments.stress.trial import Job, work
from voodoo_jax.config.options import Settings

CHANGES, SCENES = tuple(changes(human(), Settings())), tuple(scenes())
COLOURS = ("tab:red", "tab:orange", "tab:green")
HONEST = 99.0  # percent of the claims


def cells_of(jobs: list[Job], found: list[Verdict]) -> list[str]:
    """A row of the table."""
    worst = int(np.argmax([v.score.error_cm for v in found]))
    log = jobs[worst].log
    name = f"{log.stem}: {found[worst].score.error_cm:.1f} cm" if log else "-"
    return [jobs[0].row, str(len(found)), *cells(found), *honest_cells(found), name]


def text(rows: dict[str, list[str]]) -> str:
    """Both tables."""
    parts = []
    for what, count, names in (("recordings, changed", "logs", CHANGES), ("simulated", "scenes", SCENES)):
        if these := [rows[n] for n in names if n in rows]:
            parts.append(table([what, count, *HEAD, *HONEST_HEAD, "worst"], these))
    return "\n".join(parts)


def kept(file: Path) -> dict[str, list[str]]:
    """The rows of a table that is there already."""
    lines = file.read_text().splitlines() if file.exists() else []
    found = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in lines if line.startswith("| ")]
    return {row[0]: row for row in found if row[0] in (*CHANGES, *SCENES)}


def draw(rows: dict[str, list[str]]) -> Figure:
    """Error and honesty by row, coloured by the worst grade."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 0.24 * len(rows) + 1.3), sharey=True, layout="constrained")
    place, head = np.arange(len(rows)), ["row", "count", *HEAD, *HONEST_HEAD]
    column = lambda name: [row[head.index(name)] for row in rows.values()]  # noqa: E731
    number = lambda name: [float(cell) if cell != "-" else np.nan for cell in column(name)]  # noqa: E731
    worst = [next(g for g, n in enumerate(cell.split(" / ")) if n != "0") for cell in column(HEAD[2])]
    left.barh(place, number(HEAD[0]), color=[COLOURS[g] for g in worst])
    left.set(xscale="log", xlabel=HEAD[0], yticks=place, yticklabels=list(rows))
    for label, colour in zip(("a log lost", "a log acceptable", "all good"), COLOURS):
        left.barh([0], [0], color=colour, label=label)
    right.plot(number(HONEST_HEAD[0]), place, "s", color="0.6", ms=5, label=HONEST_HEAD[0])
    right.plot(number(HONEST_HEAD[1]), place, "k.", ms=6, label=HONEST_HEAD[1])
    right.plot(number(HEAD[3]), place, "rx", ms=5, label=HEAD[3])
    right.axvline(HONEST, color="0.6", lw=0.8, zorder=0)
    right.set(xlabel="percent", xlim=(-3, 103))
    left.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=6, fontsize=7)
    return figure


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    kinds: tuple[Literal["simulated", "changed"], ...] = ("simulated", "changed"),
    logs: str = "*",
    every: int = 1,
    only: str = "*",
    frames: int = 0,
    processes: int = 2,
    keep: bool = False,
    out: Path = Path(__file__).parent,
) -> None:
    """What is survived.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        kinds: which of both tables.
        logs: names of the recordings to take, with * and ?.
        every: take every N-th of them.
        only: names of the rows to do, with * and ?.
        frames: cut recordings and scenes after so many frames; 0: whole.
        processes: how many work at once.
        keep: keep the rows of stress.md that are not done anew.
        out: folder for stress.md and stress.png.
    """
    files = [f for f in log_files(recordings) if fnmatch(f.stem, logs)][::every]
    jobs = [Job(row, None, frames) for row in SCENES if "simulated" in kinds and fnmatch(row, only)]
    jobs += [Job(row, f, frames) for row in CHANGES if "changed" in kinds and fnmatch(row, only) for f in files]
    rows = kept(out / "stress.md") if keep else {}
    done: list[tuple[Job, Verdict]] = []
    for job, verdict in zip(jobs, tqdm(trials(work, jobs, processes), total=len(jobs), leave=False, disable=None)):
        done.append((job, verdict))
        if len(done) < (len(files) if job.log else 1):
            continue
        rows[job.row] = cells_of([j for j, _ in done], [v for _, v in done])
        tqdm.write(" | ".join(rows[job.row]))
        for other, found in done:
            if found.score.grade == 0 or found.honest < HONEST:
                log, cm, honest = other.log or other.row, found.score.error_cm, found.honest
                tqdm.write(f"    {log}: grade {found.score.grade}, {cm:.1f} cm, {honest:.0f} % of the claims true")
        done = []
        out.mkdir(parents=True, exist_ok=True)
        (out / "stress.md").write_text(text(rows))
    write(out, "stress", text(rows), draw({n: rows[n] for n in (*CHANGES, *SCENES) if n in rows}))


if __name__ == "__main__":
    tyro.cli(main)
