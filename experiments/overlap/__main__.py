"""What becomes of points in several limbs' boxes: python -m experiments.overlap [RECORDINGS]

Tracks every recording with each rule (solve.overlap), limbs' boxes near and far (solve.limb_enlarge) and both solvers;
the person is told apart once per recording. Writes overlap.md.
"""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Literal

import tyro

from experiments.common import DEMO, MEAN_HEAD, human, load_logs, mean_row, sweep, table, write
from voodoo_jax.config.options import Settings


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    rules: tuple[Literal["exclusive", "shared", "adjacent"], ...] = ("exclusive", "shared", "adjacent"),
    enlarge: tuple[float, ...] = (0.05, 0.35),
    solvers: tuple[Literal["coupled", "per_limb"], ...] = ("coupled", "per_limb"),
    every: int = 1,
    frames: int = 0,
    out: Path = Path(__file__).parent,
) -> None:
    """Error by overlap rule.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        rules: values of solve.overlap.
        enlarge: values of solve.limb_enlarge, metres.
        solvers: solvers to compare.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        out: folder for overlap.md.
    """
    body, base = human(), Settings()
    logs = load_logs(recordings, body, base, every, frames)
    variants = {
        (s, rule, e): replace(base, solve=replace(base.solve, solver=s, overlap=rule, limb_enlarge=e))
        for s, rule, e in product(solvers, rules, enlarge)
    }
    results = sweep(logs, body, variants)
    rows = [[solver, rule, f"{e:g}", *mean_row(scores)] for (solver, rule, e), scores in results.items()]
    write(out, "overlap", table(["solver", "overlap rule", "limb_enlarge, m", *MEAN_HEAD], rows, 2))


if __name__ == "__main__":
    tyro.cli(main)
