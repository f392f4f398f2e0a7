"""Other people, other movements: python -m experiments.people BODIES.npz MOTIONS LOGS

BODIES.npz as bodies.py writes it; MOTIONS the folder pybullet_data/data/motions of the package pybullet; LOGS a folder
for the logs, which are made where they are missing (with numba installed: some minutes). Nothing is given, the settings
are the defaults, and none of them was chosen on these logs, if the bodies are of another seed than those that the
built-in human has its shape from (12 in people.md). Writes people.md.
"""

from pathlib import Path

import tyro
from tqdm import tqdm

from experiments.common import table, write
from experiments.judged import HEAD, HONEST_HEAD, Verdict, cells, honest_cells, trials
from experiments.people.making import work
from experiments.people.takes import Take, takes


def row(name: str, found: list[tuple[Take, Verdict]]) -> list[str]:
    """A row of the table."""
    verdicts = [v for _, v in found]
    worst, verdict = max(found, key=lambda f: f[1].score.error_cm)
    what = f"{worst.name}: {verdict.score.error_cm:.1f} cm"
    return [name, str(len(found)), *cells(verdicts), *honest_cells(verdicts), what]


def main(
    bodies: tyro.conf.Positional[Path],
    motions: tyro.conf.Positional[Path],
    logs: tyro.conf.Positional[Path],
    only: str = "",
    seed: int = 6,
    processes: int = 2,
    out: Path = Path(__file__).parent,
) -> None:
    """How well other people and movements are tracked.

    Args:
        bodies: what bodies.py has written.
        motions: folder with humanoid3d_*.txt.
        logs: folder for the logs; those that are there are taken as they are.
        only: the logs whose names begin so.
        seed: of how people turn and where they are; with 5, and bodies of their own seed, the logs that tuned the body.
        processes: how many work at once.
        out: folder for people.md.
    """
    logs.mkdir(parents=True, exist_ok=True)
    jobs = [take for take in takes(bodies, motions, logs, seed) if take.name.startswith(only)]
    rows: dict[str, list[tuple[Take, Verdict]]] = {}
    for take, verdict in zip(jobs, tqdm(trials(work, jobs, processes), total=len(jobs), leave=False, disable=None)):
        rows.setdefault(take.row, []).append((take, verdict))
        tqdm.write(f"{take.name}: {verdict.score.error_cm:.2f} cm, grade {verdict.score.grade}")
    whole = [job for found in rows.values() for job in found]
    lines = [row(name, found) for name, found in {**rows, "all": whole}.items()]
    write(out, "people", table(["movement or people", "logs", *HEAD, *HONEST_HEAD, "worst"], lines))


if __name__ == "__main__":
    tyro.cli(main)
