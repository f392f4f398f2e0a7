"""What each ingredient gives: python -m experiments.ablation [RECORDINGS]

One thing at a time is taken away from the default settings or changed (variants.py), on every recording, and again with
every third frame kept. Rows are printed and written as they come: a run that is ended early keeps them. Writes
ablation.md and ablation.png.
"""

from fnmatch import fnmatch
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.ablation.variants import VARIANTS, Job, work
from experiments.bench.replay_speed import machine
from experiments.common import DEMO, log_files, machine_line, table, write
from experiments.judged import HEAD, Verdict, cells, mean_of, trials

STEPS = (1, 3)


def row(name: str, whole: list[Verdict], third: list[Verdict]) -> list[str]:
    """Cells of a variant."""
    sizes = [f"{mean_of(whole, k):.2f}" for k in ("segments_cm", "stature_cm")]
    speed = sum(v.frames for v in whole) / max(sum(v.seconds for v in whole), 1e-9)
    error, _, grades, _ = cells(third)
    return [name, *cells(whole), *sizes, f"{mean_of(whole, 'steps'):.1f}", f"{speed:.0f}", error, grades]


def text(done: dict[str, list[list[Verdict]]], logs: int, note: str) -> str:
    """The table and what it was taken on."""
    head = ["variant", *HEAD, "segments, cm", "stature, cm", "steps per frame", "frames/s"]
    head += ["every third frame: mean, cm", "lost / acceptable / good"]
    return f"{logs} recordings. {note}\n{table(head, [row(name, *found) for name, found in done.items()])}"


def draw(done: dict[str, list[list[Verdict]]]) -> Figure:
    """Mean error by variant."""
    figure, panel = plt.subplots(figsize=(8, 0.24 * len(done) + 1.2), layout="constrained")
    means = [[float(np.mean([v.score.error_cm for v in found[k]])) for found in done.values()] for k in (0, 1)]
    place = np.arange(len(done))
    for mean, colour, label in zip(means, ("tab:blue", "tab:orange"), ("all frames", "every third frame")):
        panel.plot(mean, place, "o", color=colour, ms=5, label=label)
        panel.axvline(mean[0], color=colour, lw=0.8, zorder=0)
    panel.set(xscale="log", xlabel="mean joint error, cm", yticks=place, yticklabels=list(done))
    ticks = [t for t in (0.5, 1, 2, 3, 5, 10, 20, 50, 100) if min(map(min, means)) / 2 < t < 2 * max(map(max, means))]
    panel.set_xticks(ticks, [f"{t:g}" for t in ticks])
    panel.set_xticks([], minor=True)
    panel.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=2, fontsize=8)
    return figure


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    logs: str = "*",
    only: str = "*",
    every: int = 1,
    frames: int = 0,
    processes: int = 2,
    out: Path = Path(__file__).parent,
) -> None:
    """What each ingredient gives.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        logs: names of the recordings to take, with * and ?.
        only: names of the variants to do, with * and ?.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        processes: how many work at once.
        out: folder for ablation.md and ablation.png.
    """
    files = [f for f in log_files(recordings) if fnmatch(f.stem, logs)][::every]
    names, before = [n for n in VARIANTS if fnmatch(n, only)], machine()
    jobs = [Job(name, file, step, frames) for name in names for step in STEPS for file in files]
    done: dict[str, list[list[Verdict]]] = {}
    found: list[Verdict] = []
    for job, verdict in zip(jobs, tqdm(trials(work, jobs, processes), total=len(jobs), leave=False, disable=None)):
        found.append(verdict)
        if len(found) < len(STEPS) * len(files):
            continue
        done[job.variant], found = [found[: len(files)], found[len(files) :]], []
        tqdm.write(" | ".join(row(job.variant, *done[job.variant])))
        out.mkdir(parents=True, exist_ok=True)
        (out / "ablation.md").write_text(text(done, len(files), machine_line(before)))
    write(out, "ablation", text(done, len(files), machine_line(before)), draw(done))


if __name__ == "__main__":
    tyro.cli(main)
