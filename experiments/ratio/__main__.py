"""What the weight of the bands does (r of Knoop 2007, sec. 4.3): python -m experiments.ratio [RECORDINGS]

Tracks every recording with solve.ratio = 0.1 ... 1.5 and both solvers; the person is told apart once per recording.
Writes ratio.md and ratio.png.
"""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.figure import Figure

from experiments.common import DEMO, MEAN_HEAD, Score, human, load_logs, mean_row, sweep, table, write
from voodoo_jax.config.options import Settings

RATIOS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 1.0, 1.5)
PAPERS = (0.4, 0.7)  # what the papers recommend


def draw(results: dict[tuple, list[Score]], title: str) -> Figure:
    """Error, share within 10 cm and grade over r, one line per solver."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    names = {
        "error_cm": "mean joint error, cm",
        "within": "joints within 10 cm, %",
        "grade": "mean grade (0 lost, 2 good)",
    }
    for panel, (name, label) in zip(axes, names.items()):
        panel.axvspan(*PAPERS, color="0.9", label="the papers' 0.4 to 0.7")
        for solver in dict.fromkeys(s for s, _ in results):
            means = {r: np.mean([getattr(one, name) for one in v]) for (s, r), v in results.items() if s == solver}
            panel.plot(list(means), list(means.values()), "o-", label=solver)
        panel.set(xlabel="weight of the bands r (solve.ratio)", ylabel=label)
        panel.grid(True, alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    figure.suptitle(title, fontsize=9)
    return figure


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    ratios: tuple[float, ...] = RATIOS,
    solvers: tuple[Literal["coupled", "per_limb"], ...] = ("coupled", "per_limb"),
    every: int = 1,
    frames: int = 0,
    out: Path = Path(__file__).parent,
) -> None:
    """Error over the weight of the bands.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        ratios: values of solve.ratio.
        solvers: solvers to compare.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        out: folder for ratio.md and ratio.png.
    """
    body, base = human(), Settings()
    logs = load_logs(recordings, body, base, every, frames)
    variants = {(s, r): replace(base, solve=replace(base.solve, solver=s, ratio=r)) for s in solvers for r in ratios}
    results = sweep(logs, body, variants)
    rows = [[solver, f"{ratio:g}", *mean_row(scores)] for (solver, ratio), scores in results.items()]
    figure = draw(results, f"{len(logs)} recordings, depth and features; default r = {base.solve.ratio:g}")
    write(out, "ratio", table(["solver", "r", *MEAN_HEAD], rows, 1), figure)


if __name__ == "__main__":
    tyro.cli(main)
