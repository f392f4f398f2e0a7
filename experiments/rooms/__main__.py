"""Other rooms: python -m experiments.rooms BODIES.npz MOTIONS

People among furniture, all drawn at random, and how much of them is found, before anything is tracked. BODIES.npz and
MOTIONS as for experiments/people. Writes rooms.md.
"""

from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from experiments.common import table, write
from experiments.judged import trials
from experiments.rooms.furnished import Draw, Found, work

FEW, WRONG = 0.85, 0.9  # a room in which less of the person is found, or less of what is found is right, is bad
HEAD = ["camera", "rooms", "found of the person, %", "right of what is found, %", "bad rooms", "which"]


def row(name: str, found: list[Found]) -> list[str]:
    """A row of the table."""
    bad = [f for f in found if f.share < FEW or f.right < WRONG]
    which = "; ".join(f"{f.seed} ({f.what}): {100 * f.share:.0f}, {100 * f.right:.0f}" for f in bad)
    means = (f"{100 * np.mean([getattr(f, of) for f in found]):.1f}" for of in ("share", "right"))
    return [name, str(len(found)), *means, str(len(bad)), which]


def main(
    bodies: tyro.conf.Positional[Path],
    motions: tyro.conf.Positional[Path],
    first: int = 0,
    count: int = 200,
    processes: int = 2,
    out: Path = Path(__file__).parent,
) -> None:
    """How well people are told from furniture.

    Args:
        bodies: what experiments/people/bodies.py has written.
        motions: folder with humanoid3d_*.txt.
        first: number of the first room; each number is another room.
        count: how many rooms.
        processes: how many work at once.
        out: folder for rooms.md.
    """
    jobs = [Draw(seed, bodies, motions) for seed in range(first, first + count)]
    found = list(tqdm(trials(work, jobs, processes), total=count, leave=False, disable=None))
    cameras = list(dict.fromkeys(f.camera for f in found))
    rows = [row(camera, [f for f in found if f.camera == camera]) for camera in cameras]
    write(out, "rooms", table(HEAD, [*rows, [*row("all", found)[:-1], ""]]))


if __name__ == "__main__":
    tyro.cli(main)
