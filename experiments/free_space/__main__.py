"""Does a depth camera's free space tell where a limb is wrong? python -m experiments.free_space [RECORDINGS]

A ray that meets something far behind a limb says that the limb is not there. Recordings, as they are and made harder,
are tracked from depth alone; then every limb is asked: which share of it do rays pass through, which share is hidden,
and what does the tracker say of itself? Writes free_space.md.
"""

from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from experiments.bench.replay_speed import machine
from experiments.common import DEMO, log_files, machine_line, table, write
from experiments.free_space.looked import Job, Looked, work
from experiments.judged import trials

CHANGED = ("as they are", "every third frame", "three times the noise")
WRONG = 0.1  # metres: a joint that is farther off is wrong
SPREADS = (0.035, 0.05, 0.08)  # metres


def rows_of(change: str, found: list[Looked]) -> tuple[list[str], list[list[str]]]:
    """A row on free space, and rows on what the tracker says."""
    error, free, hidden, spread = (
        np.concatenate([getattr(f, name) for f in found]) for name in ("error", "free", "hidden", "spread")
    )
    wrong = error > WRONG
    percent = lambda mask: f"{100 * mask.mean():.1f}" if len(mask) else "-"  # noqa: E731
    through = free >= 0.25
    first = [change, str(len(error)), percent(wrong), percent(through), percent(wrong[through])]
    first += [percent(through[wrong]), percent(hidden[wrong] >= 0.5), percent(hidden[~wrong] >= 0.5)]
    more = []
    for low, high in zip((0.0, *SPREADS), (*SPREADS, np.inf)):
        mine = (spread >= low) & (spread < high)
        more.append([change, f"{100 * low:.1f} to {100 * high:.1f}", percent(mine), percent(wrong[mine])])
    return first, more


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    every: int = 1,
    frames: int = 0,
    processes: int = 2,
    out: Path = Path(__file__).parent,
) -> None:
    """Whether free space tells where a limb is wrong.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        processes: how many work at once.
        out: folder for free_space.md.
    """
    files, before = log_files(recordings)[::every], machine()
    jobs = [Job(change, file, frames) for change in CHANGED for file in files]
    found = list(tqdm(trials(work, jobs, processes), total=len(jobs), leave=False, disable=None))
    rows = [rows_of(change, found[k * len(files) : (k + 1) * len(files)]) for k, change in enumerate(CHANGED)]
    head = ["recordings", "joints", "wrong (over 10 cm), %", "a quarter of the limb in free space, %"]
    head += ["of these wrong, %", "of the wrong in free space, %", "of the wrong hidden, %", "of the right hidden, %"]
    said = ["recordings", "spread that the tracker tells, cm", "share of the joints, %", "of these wrong, %"]
    text = f"{len(files)} recordings, depth only. {machine_line(before)}\n\n{table(head, [first for first, _ in rows])}"
    write(out, "free_space", f"{text}\n\n{table(said, [row for _, more in rows for row in more])}\n")


if __name__ == "__main__":
    tyro.cli(main)
