"""What is survived, and what is honestly reported as lost: python -m experiments.stress [RECORDINGS]

Changed recordings: every change of changes.py on every log. Simulated scenes: those of scenes.py. Nothing is given, the
settings are the defaults. A time counts in the scores while the person is wholly in view; claims count at all times.
Rows are printed and written as they come: a run that is ended early keeps them. Writes stress.md and stress.png.
"""

from fnmatch import fnmatch
from pathlib import Path

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
from voodoo_jax.settings import Settings

COLOURS = ("tab:red", "tab:orange", "tab:green")
HONEST = 99.0  # percent of the claims


def rows(results: dict[str, list[Verdict]]) -> list[list[str]]:
    """Cells of the table."""
    return [[row, str(len(found)), *cells(found), *honest_cells(found)] for row, found in results.items()]


def text(changed: dict[str, list[Verdict]], simulated: dict[str, list[Verdict]]) -> str:
    """Both tables."""
    head = [*HEAD, *HONEST_HEAD]
    parts = [table(["recordings, changed", "logs", *head], rows(changed))] if changed else []
    parts += [table(["simulated", "scenes", *head], rows(simulated))] if simulated else []
    return "\n".join(parts)


def draw(results: dict[str, list[Verdict]]) -> Figure:
    """Error and honesty by row, coloured by the worst grade."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(10, 0.24 * len(results) + 1.3), sharey=True, layout="constrained"
    )
    names, place = list(results), np.arange(len(results))
    worst = [COLOURS[min(v.score.grade for v in results[n])] for n in names]
    left.barh(place, [np.mean([v.score.error_cm for v in results[n]]) for n in names], color=worst)
    left.set(xscale="log", xlabel="mean joint error, cm", yticks=place, yticklabels=names)
    left.axvline(3, color="0.6", lw=0.8, zorder=0)
    for label, colour in zip(("a log lost", "a log acceptable", "all good"), COLOURS):
        left.barh([0], [0], color=colour, label=label)
    for name, y in zip(names, place):
        found = results[name]
        right.plot([np.mean([v.tracked for v in found])], [y], "s", color="0.6", ms=5)
        right.plot([np.nanmean([np.nan if np.isnan(v.honest) else v.honest for v in found])], [y], "k.", ms=6)
    right.plot([], [], "s", color="0.6", ms=5, label="frames said to be tracked, %")
    right.plot([], [], "k.", ms=6, label="of these pelvis within 20 cm, %")
    right.axvline(HONEST, color="0.6", lw=0.8, zorder=0)
    right.set(xlabel="percent", xlim=(-3, 103))
    left.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=5, fontsize=8)
    return figure


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    logs: str = "*",
    only: str = "*",
    frames: int = 0,
    processes: int = 2,
    out: Path = Path(__file__).parent,
) -> None:
    """What is survived.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        logs: names of the recordings to take, with * and ?.
        only: names of the rows to do, with * and ?.
        frames: cut recordings and scenes after so many frames; 0: whole.
        processes: how many work at once.
        out: folder for stress.md and stress.png.
    """
    files = [f for f in log_files(recordings) if fnmatch(f.stem, logs)]
    wanted = lambda names: [n for n in names if fnmatch(n, only)]  # noqa: E731
    jobs = [Job(row, None, frames) for row in wanted(scenes())]
    jobs += [Job(row, f, frames) for row in wanted(changes(human(), Settings())) for f in files]
    changed: dict[str, list[Verdict]] = {}
    simulated: dict[str, list[Verdict]] = {}
    bar = tqdm(zip(jobs, trials(work, jobs, processes)), total=len(jobs), leave=False, disable=None)
    for job, verdict in bar:
        these, count = (simulated, 1) if job.log is None else (changed, len(files))
        these.setdefault(job.row, []).append(verdict)
        if len(these[job.row]) == count:
            tqdm.write(" | ".join(rows({job.row: these[job.row]})[0]))
            out.mkdir(parents=True, exist_ok=True)
            (out / "stress.md").write_text(text(changed, simulated))
    write(out, "stress", text(changed, simulated), draw(changed | simulated))


if __name__ == "__main__":
    tyro.cli(main)
