"""Settings chosen on one half of the people, scored on the other half: python -m experiments.halves RECORDINGS

People are told from each other by the stature in the truth and dealt out in turn. Each setting of trial.py is changed
alone on all recordings; each half takes, of every setting, the value with the smallest mean joint error on its own
recordings (the default where none gains a hundredth of a centimetre), all together, and is scored on the other half.
The defaults themselves were chosen on all recordings: what a half's own choice loses against them on the other half
says how much of that is chance. Writes halves.md.
"""

from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from tqdm import tqdm

from experiments.bench.replay_speed import machine
from experiments.common import load_dims, log_files, machine_line, table, write
from experiments.halves.trial import TRIED, Choice, Job, work
from experiments.judged import HEAD, Verdict, cells, trials

GAIN = 0.01  # centimetres: less is no reason to leave the default


def halves(files: list[Path]) -> tuple[list[Path], list[Path]]:
    """The recordings of every other person, and those of the others; people in the order of their statures."""
    stature = {}
    for file in files:
        stature[file] = round(load_dims(file)["stature"], 3)
    people = sorted(set(stature.values()))
    first, second = ([f for f in files if people.index(stature[f]) % 2 == k] for k in (0, 1))
    return first, second


def chosen(files: list[Path], errors: dict[tuple[Choice, Path], float]) -> Choice:
    """Of every setting the value that is best on these recordings."""
    mean = lambda choice: float(np.mean([errors[choice, f] for f in files]))  # noqa: E731
    found = []
    for name, values in TRIED.items():
        best = min(values, key=lambda v: mean(((name, v),)))
        if mean(((name, best),)) < mean(()) - GAIN:
            found.append((name, best))
    return tuple(found)


def text_of(choice: Choice) -> str:
    """The settings in words."""
    return ", ".join(f"{name} {value:g}" for name, value in choice) or "default"


def main(
    recordings: tyro.conf.Positional[Path],
    kinds: tuple[Literal["fusion", "depth"], ...] = ("fusion", "depth"),
    every: int = 1,
    frames: int = 0,
    processes: int = 2,
    out: Path = Path(__file__).parent,
) -> None:
    """Settings chosen on one half of the people, scored on the other half.

    Args:
        recordings: folder with *.mcap and *.truth.npz of at least two people.
        kinds: with the 2D features, or with depth only.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        processes: how many work at once.
        out: folder for halves.md.
    """
    files, before = log_files(recordings)[::every], machine()
    parts = halves(files)
    if not all(parts):
        raise SystemExit(f"{recordings} has recordings of one person only: there are no halves.")
    verdicts: dict[tuple[Choice, bool, Path], Verdict] = {}

    def run(asked: list[tuple[Choice, bool, Path]]) -> None:
        asked = [a for a in dict.fromkeys(asked) if a not in verdicts]
        jobs = [Job(choice, file, features, frames) for choice, features, file in asked]
        bar = tqdm(trials(work, jobs, processes), total=len(jobs), leave=False, disable=None)
        verdicts.update(zip(asked, bar))

    alone = [((name, value),) for name, values in TRIED.items() for value in values]
    sections = []
    for features in (kind == "fusion" for kind in kinds):
        tried: list[Choice] = [(), *alone]
        run([(c, features, f) for c in tried for f in files])
        errors = {(c, f): v.score.error_cm for (c, with_them, f), v in verdicts.items() if with_them == features}
        rows = [[text_of(c), *(cells([verdicts[c, features, f] for f in part])[0] for part in parts)] for c in tried]
        effect = table(["changed alone", *(f"half {k}, cm" for k in "AB")], rows)
        rows = []
        for k, (own, other) in enumerate((parts, parts[::-1])):
            choice = chosen(own, errors)
            run([(choice, features, f) for f in files])
            names = f"chosen on {'AB'[k]}", f"scored on {'BA'[k]}"
            for label, c in (("default", ()), (f"{names[0]}: {text_of(choice)}", choice)):
                rows.append([label, names[1], *cells([verdicts[c, features, f] for f in other])])
        both = [verdicts[chosen(parts[1 - k], errors), features, f] for k in (0, 1) for f in parts[k]]
        rows.append(["every half with the other's choice", "scored on all", *cells(both)])
        rows.append(["default", "scored on all", *cells([verdicts[(), features, f] for f in files])])
        title = "depth and 2D features" if features else "depth only"
        sections.append(f"## {title}\n\n{table(['settings', 'on', *HEAD], rows)}\n\n{effect}")
        people = f"A: {len(parts[0])}, B: {len(parts[1])} recordings."
        write(out, "halves", f"{people} {machine_line(before)}\n\n" + "\n\n".join(sections))


if __name__ == "__main__":
    tyro.cli(main)
