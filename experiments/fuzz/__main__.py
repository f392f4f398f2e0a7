"""Damaged and hostile logs, and what becomes of them: python -m experiments.fuzz [--count 2000] [--seed 1]

Each is read and tracked in a process that is watched. Ends with 1 if something must not have come of one of them.
"""

import json
import os
import random
import re
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import tyro

from experiments.common import DEMO, table
from experiments.fuzz.contents import everything
from experiments.fuzz.judged import faults
from experiments.fuzz.kinds import Input
from experiments.fuzz.logs import Base, base_of, written
from experiments.fuzz.trying import Mode, Watched

FRAMES = 15  # of the sound log: half a second


def sound(base: Base, kind: str) -> bytes:
    """The sound log that those of a kind are made of."""
    name = f"{'points' if kind == 'cloud' else kind}/sound"
    return next((one.make() for one in everything(base, 0) if one.name == name), None) or written(base.log)


def chosen(base: Base, seed: int, count: int, only: str = "") -> list[Input]:
    """So many inputs at most, of all kinds: where there are not enough, more of what is made by chance."""
    inputs = everything(base, seed)
    for more in range(1, 100):
        if len(inputs) < count:
            others = [one for one in everything(base, seed + more) if one.by_chance]
            inputs += [replace(one, name=f"{one.name}, seed {seed + more}") for one in others]
    some = [one for one in inputs if re.search(only, one.name)]
    random.Random(seed).shuffle(some)
    return some[:count]


def tried(inputs: list[Input], base: Base, mode: Mode) -> Iterator[tuple[Input, dict[str, Any], list[str]]]:
    """Of each input what came of it, and what of that must not have."""
    clean: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder, Watched(mode, Path(folder)) as watched:
        path = Path(folder) / "x.mcap"
        for one in inputs:
            if one.kind not in clean:
                path.write_bytes(sound(base, one.kind))
                clean[one.kind] = watched.ask(path)
            path.write_bytes(one.make())
            found = watched.ask(path)
            wrong = faults(one, found, clean[one.kind])
            if any("voodoo_owned" in name for name in os.listdir(folder)):
                wrong.append("escaped")
            yield one, found, wrong


def rows(results: list[tuple[Input, dict[str, Any], list[str]]]) -> list[list[str]]:
    """A row for each kind."""
    out = []
    for kind in sorted({one.kind for one, _, _ in results}):
        mine = [(found, wrong) for one, found, wrong in results if one.kind == kind]
        refused = sum(bool(found.get("error")) for found, _ in mine)
        peak = max(found.get("peak", 0) for found, _ in mine) / 1e9
        longest = max(found.get("seconds", 0) - 2 * found.get("compiling", 0) for found, _ in mine)
        bad = sum(bool(wrong) for _, wrong in mine)
        out.append([kind, str(len(mine)), str(refused), f"{peak:.2f}", f"{longest:.1f}", str(bad)])
    return out


def main(
    count: int = 2000,
    seed: int = 1,
    only: str = "",
    mode: Mode = "track",
    log: Path | None = None,
    out: Path | None = None,
) -> None:
    """Tries damaged and hostile logs.

    Args:
        count: how many at most; each seed changes the bytes of some kinds, and which are chosen.
        seed: of what is random.
        only: a regular expression for names of inputs.
        mode: read them only, or track as replay does.
        log: a sound log with one depth camera to begin with (16 bits); none: the demo.
        out: folder for logs that failed, and results.jsonl.
    """
    base = base_of(log or DEMO / "demo.mcap", FRAMES)
    results, began = [], time.monotonic()
    for one, found, wrong in tried(chosen(base, seed, count, only), base, mode):
        results.append((one, found, wrong))
        if wrong:
            print(
                f"FAILED {one.name}: {', '.join(wrong)}: {found.get('error') or found.get('trace', '')[-300:]}",
                flush=True,
            )
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            with open(out / "results.jsonl", "a") as file:
                file.write(json.dumps({"name": one.name, "wrong": wrong, **found}) + "\n")
            if wrong:
                (out / f"{re.sub(r'[^a-z0-9]+', '_', one.name.lower())[:100]}.mcap").write_bytes(one.make())
    print(table(["kind", "logs", "refused", "memory, GB", "longest, s", "failed"], rows(results)))
    failed = sum(bool(wrong) for _, _, wrong in results)
    print(f"{len(results)} logs in {time.monotonic() - began:.0f} s, {failed} failed")
    raise SystemExit(int(failed > 0))


if __name__ == "__main__":
    tyro.cli(main)
