"""Bodies that are no people: python -m experiments.animals

Dogs of sizes that nobody tells, in a room with a box as high as a dog; made of the body's own limbs. Writes animals.md.
"""

from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from experiments.animals.dogs import EFFORT, SIZES, Take, work
from experiments.common import table, write
from experiments.judged import trials

HEAD = [
    "a dog that", "logs", "mean joint error, cm", "within 10 cm, %", "said to be tracked, %", "withers, cm",
    "each log, cm",
]  # fmt: skip


def main(logs: int = len(SIZES), processes: int = 2, out: Path = Path(__file__).parent) -> None:
    """How well dogs are tracked.

    Args:
        logs: of each kind.
        processes: how many work at once.
        out: folder for animals.md.
    """
    takes = [Take(what, seed) for what in EFFORT for seed in range(logs)]
    found = list(tqdm(trials(work, takes, processes), total=len(takes), leave=False, disable=None))
    rows = []
    for what in (*EFFORT, "all"):
        mine = [f for take, f in zip(takes, found) if what in (take.what, "all")]
        means = [
            f"{np.mean([getattr(f, k) for f in mine]):.1f}" for k in ("error_cm", "within", "tracked", "withers_cm")
        ]
        each = ", ".join(f"{f.error_cm:.1f}" for f in mine) if what != "all" else ""
        rows.append([what, str(len(mine)), *means, each])
    write(out, "animals", table(HEAD, rows))


if __name__ == "__main__":
    tyro.cli(main)
