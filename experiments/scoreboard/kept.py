"""The committed figures: experiments/scoreboard.json and the page made of it, scoreboard.md."""

import json
import math
import subprocess
from collections.abc import Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

from experiments.bench.replay_speed import machine
from experiments.common import table
from experiments.scoreboard.board import Before, Measured, Promise, limit_text, rows, verdict

FOLDER = Path(__file__).parents[1]
FILE, PAGE = FOLDER / "scoreboard.json", FOLDER / "scoreboard.md"
HEAD = ["promise", "figure", "limit", "last", "now", "verdict"]
INTRODUCTION = """# Scoreboard

Every promise of this project, measured by `python -m experiments.scoreboard RECORDINGS`, which writes this page and
scoreboard.json. A limit is what is promised; a figure without one is told, not promised. Each promise is a file in
[scoreboard/promises](scoreboard/promises). CI measures a part of each (the second table) and fails where a figure is
worse than here by more than its tolerance.
"""
LIBRARIES = ("jax", "jaxlib", "numpy", "scipy", "opencv-python-headless")


def load() -> dict[str, Any]:
    """The file as it is; empty where there is none."""
    return json.loads(FILE.read_text()) if FILE.exists() else {}


def figures(kept: dict[str, Any], quick: bool, cpu: str) -> dict[str, list[dict[str, float]]]:
    """Values by promise and figure of the full or the quick measurement; NaN: could not be measured. Those of a
    processor of that name alone, or of all that are known: rounding differs between processors, and so do figures."""
    mode = kept.get("quick" if quick else "full", {})
    nan = lambda value: math.nan if value is None else value  # noqa: E731
    found = {}
    for name, one in mode.items():
        by_cpu = by_processor(one)
        chosen = [by_cpu[cpu]] if cpu in by_cpu else by_cpu.values()
        found[name] = [{k: nan(v) for k, v in c["figures"].items()} for c in chosen]
    return found


def by_processor(row: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What is kept of a promise, by the name of the processor on which it was measured; the last one first."""
    return {row["cpu"]: row, **row.get("elsewhere", {})}


def processor() -> str:
    """Name of this machine's processor."""
    return str(machine()["cpu"])


def commit() -> str:
    """The commit that is checked out, marked where files of the package differ from it."""
    git = lambda *words: subprocess.run(["git", *words], cwd=FOLDER, capture_output=True, text=True).stdout.strip()  # noqa: E731
    return git("rev-parse", "--short", "HEAD") + ("+" if git("status", "--porcelain", "--", "../voodoo_jax") else "")


def merged(kept: dict[str, Any], found: Sequence[Measured], quick: bool, everything: bool) -> dict[str, Any]:
    """The file with the promises that were measured put in; promises that are gone are left out if all were asked. The
    last figures of other processors are kept beside those of this one."""
    mode = "quick" if quick else "full"
    before = kept.get(mode, {})
    old, cpu = {} if everything else dict(before), processor()
    stamp = {"commit": commit(), "date": date.today().isoformat()}
    for one in found:
        if one.values:
            number = {k: None if math.isnan(v) else round(v, 6) for k, v in one.values.items()}
            known = by_processor(before[one.promise.name]) if one.promise.name in before else {}
            elsewhere = {c: {k: o[k] for k in (*stamp, "figures")} for c, o in known.items() if c != cpu}
            row = {**stamp, "cpu": cpu, "seconds": round(one.seconds, 1), "figures": number}
            old[one.promise.name] = row | ({"elsewhere": elsewhere} if elsewhere else {})
            if one.details:
                old[one.promise.name]["details"] = list(one.details)
    versions = {name: version(name) for name in LIBRARIES}
    where = {k: v for k, v in machine().items() if k != "load_1min"}
    return {**kept, mode: old, f"{mode}_measured_on": {"machine": where, "versions": versions}}


def write(kept: dict[str, Any], promises: Sequence[Promise]) -> None:
    """Both files. The page shows the full measurement, and the quick one, by which CI judges, below."""
    FILE.write_text(json.dumps(kept, indent=1) + "\n")
    PAGE.write_text(page_text(kept, promises))


def page_text(kept: dict[str, Any], promises: Sequence[Promise]) -> str:
    """The page that README and documentation quote from."""
    parts = [INTRODUCTION]
    for mode, title in (("full", "All"), ("quick", "A part of each, as CI measures it (`--quick`)")):
        values = kept.get(mode, {})
        if not values:
            continue
        lines = []
        for promise in promises:
            if promise.name not in values:
                continue
            one, name = values[promise.name], promise.name
            for f in promise.figures:
                value = one["figures"].get(f.name)
                said = verdict(f, math.nan if value is None else value)
                lines.append([name, f.name, limit_text(f), f.text(value), said, one["commit"], one["date"], one["cpu"]])
                name = ""
        on = kept[f"{mode}_measured_on"]
        where = ", ".join(f"{k} {v}" for k, v in (*on["machine"].items(), *on["versions"].items()))
        head = ["promise", "figure", "limit", "measured", "verdict", "commit", "date", "processor"]
        parts.append(f"## {title}\n\n{table(head, lines, left=2)}\nMeasured on: {where}.\n")
        parts += [
            f"{name}:\n\n" + "".join(f"* {line}\n" for line in one["details"])
            for name, one in values.items()
            if "details" in one
        ]
    parts.append(
        "## What the promises say\n\n" + "".join(f"* **{p.name}**: {p.sentence} ({p.data})\n" for p in promises)
    )
    return "\n".join(parts)


def shown(found: Sequence[Measured], before: Before) -> str:
    """The table that is printed."""
    return table(HEAD, rows(found, before), left=2)
