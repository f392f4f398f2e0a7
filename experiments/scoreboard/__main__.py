"""Every promise that the project makes, measured: python -m experiments.scoreboard RECORDINGS

Prints a table (promise, limit, last figure, now, verdict) and writes experiments/scoreboard.md and scoreboard.json.
"""

import sys
import time
from fnmatch import fnmatch
from pathlib import Path

import tyro

from experiments.scoreboard import kept
from experiments.scoreboard.board import Data, fallen
from experiments.scoreboard.promises import all_promises
from experiments.scoreboard.run import measure


def main(
    recordings: tyro.conf.Positional[Path | None] = None,
    only: tuple[str, ...] = ("*",),
    quick: bool = False,
    gate: bool = False,
    dry: bool = False,
    others: Path | None = None,
    draw: int = 1,
    processes: int = 2,
) -> None:
    """Measures what the project promises.

    Args:
        recordings: folder with recordings and their truth; without it what can be simulated is measured.
        only: names of promises, with * and ?.
        quick: a part of each promise, in minutes.
        gate: compare with the committed figures, write nothing, and end with 1 if a promise has fallen. Promises of
            which no figure can fall, those of time and memory, are left out.
        dry: write nothing.
        others: folder with dataset-1_*.bvh, and bodies-<draw>.npz as `experiments/people/bodies.py bodies-<draw>.npz
            <draw> 24 recorded` writes it where anny is installed: of these the promise "others" is measured.
        draw: seed of who moves how in those, and from where they are seen: another one draws others.
        processes: how many work at once.
    """
    began = time.perf_counter()
    if recordings is not None and not recordings.is_dir():
        raise SystemExit(f"{recordings} is not a folder; give the one that holds the recordings, or none")
    everything = all_promises()
    chosen = [p for p in everything if any(fnmatch(p.name, pattern) for pattern in only)]
    if not chosen:
        raise SystemExit(f"no promise is named {' or '.join(only)}; there are: {', '.join(p.name for p in everything)}")
    if gate and (told := [p.name for p in chosen if not p.gates]):
        print(f"Left out, for no figure of theirs can fall: {', '.join(told)}.")
        chosen = [p for p in chosen if p.gates]
    found = measure(chosen, Data(recordings and recordings.resolve(), quick, others, draw), processes)
    old = kept.load()
    before = kept.figures(old, quick, kept.processor())
    print(kept.shown(found, before))
    for one in found:
        if one.why:
            print(f"{one.promise.name}: {one.why}")
        if one.details:
            print("\n  ".join([f"{one.promise.name}:", *one.details]))
    worse = fallen(found, before)
    print("\n".join(["Fallen since the committed scoreboard:", *worse] if worse else ["No promise has fallen."]))
    print(f"{len(found)} promises in {time.perf_counter() - began:.0f} s")
    if gate:
        sys.exit(int(bool(worse)))
    if not dry:
        kept.write(kept.merged(old, found, quick, len(chosen) == len(everything)), everything)
        print(f"written: {kept.PAGE}, {kept.FILE}")


if __name__ == "__main__":
    tyro.cli(main)
