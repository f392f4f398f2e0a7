"""The whole step on equal work, contenders in turns: python -m experiments.bench.same_work [WORK.npz] [--gate]

Every contender waits in processes of its own and runs when it is its turn, in rounds, so that a busy machine hits all
alike. Without a file the work is made from the demo recording.
"""

import json
import os
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import matplotlib.pyplot as plt
import numpy as np
import tyro
from tqdm import tqdm

from experiments.bench.gate import BASELINE, check, ratios
from experiments.bench.peers.children import Child, Rate
from experiments.bench.peers.contenders import CONTENDERS
from experiments.bench.replay_speed import machine
from experiments.bench.work import from_demo, load, save


def measure(work: Path, points: int, keys: tuple[str, ...], rounds: int, seconds: float) -> dict[str, dict]:
    """Rows by contender, of one number of points."""
    children = {}
    for key in tqdm(keys, desc=f"{points} points: compile", leave=False, disable=None):
        children[key] = Child(key, work, points)
    try:
        here = {k: c for k, c in children.items() if not c.missing}
        rates: dict[str, list[Rate]] = {key: [] for key in here}
        for _ in tqdm(range(rounds), desc=f"{points} points: rounds", leave=False, disable=None):
            for key, child in here.items():
                rates[key].append(child.run(seconds))
        rows = {key: {"missing": child.missing} for key, child in children.items() if child.missing}
        for key, child in here.items():
            rows[key] = {name: [getattr(r, name) for r in rates[key]] for name in ("fps", "fps_of_processor")}
            rows[key]["compile_s"] = child.compile_s
            if "c" in here:
                rows[key]["from_c_mm"] = 1e3 * float(np.abs(child.places - here["c"].places).max())
        return rows
    finally:
        for child in children.values():
            child.close()


def table(rows: dict[str, dict], points: int) -> str:
    """Markdown rows of one number of points."""
    lines = []
    for key, row in rows.items():
        who = CONTENDERS[key]
        if "missing" in row:
            lines.append(f"| {who.label} | {points} | not measured: {row['missing']} | | | | |")
            continue
        fps = row["fps"]
        both = who.cores == 2 or not who.pinned
        of = rows.get("c_both" if both else "c", {}).get("fps", [])
        share = f"{np.median(np.divide(fps, of)):.3f}" if of else ""
        off = f"{row['from_c_mm']:.3f}" if "from_c_mm" in row and who.same else ""
        lines.append(
            f"| {who.label} | {points} | {max(fps):.0f} | {np.median(fps):.0f} | {share} | {off} "
            f"| {row['compile_s']:.1f} |"
        )
    return "\n".join(lines)


HEAD = (
    "| contender | points | best, frames/s | median, frames/s | of C on as many cores, median of rounds "
    "| largest distance from C's limbs, mm | compile, s |\n|---|---:|---:|---:|---:|---:|---:|"
)


def plot(found: dict[int, dict[str, dict]], where: Path, title: str) -> None:
    """Median frames per second over points, a line for each contender."""
    figure, axes = plt.subplots(figsize=(8, 5), layout="constrained")
    for key, who in CONTENDERS.items():
        line = [(n, np.median(rows[key]["fps"])) for n, rows in found.items() if "fps" in rows.get(key, {})]
        if line:
            axes.plot(*zip(*line), "o-" if "library" in who.module else "o--", label=who.label)
    axes.set(xscale="log", yscale="log", xlabel="points per frame", ylabel="frames per second, median")
    axes.set_xticks(sorted(found), [str(n) for n in sorted(found)])
    axes.minorticks_off()
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize=7)
    figure.suptitle(title, fontsize=9)
    figure.savefig(where, dpi=110)
    plt.close(figure)


def main(
    work: tyro.conf.Positional[Path | None] = None,
    points: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N...")] = (500, 1000, 2000, 4000),
    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...")] = tuple(CONTENDERS),
    rounds: int = 7,
    seconds: float = 1.0,
    gradient: bool = True,
    gate: bool = False,
    set_baseline: bool = False,
    out: Path = Path(__file__).parent / "out",
) -> int:
    """Measures, prints a table, writes same_work.json and same_work.png; returns the exit status.

    Args:
        work: arrays of the work; none: made from the demo recording.
        points: points per frame.
        only: contenders, by their names in peers/contenders.py.
        rounds: turns of every contender, at least 5.
        seconds: length of a turn.
        gradient: measures value and gradient too, at 1000 points.
        gate: status 1 if a ratio has fallen by more than a quarter below baseline.json.
        set_baseline: writes this run's ratios to baseline.json.
        out: folder for results.
    """
    if rounds < 5:
        raise SystemExit("--rounds must be at least 5: fewer say little on a shared machine")
    info = machine()
    print(", ".join(f"{key} {value}" for key, value in info.items()), HEAD, sep="\n", flush=True)
    found, shares = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        if work is None:
            work = Path(folder) / "work.npz"
            save(from_demo(points), work)
        for n in points:
            found[n] = measure(work, n, only, rounds, seconds)
            print(table(found[n], n), flush=True)
            shares |= ratios({key: row["fps"] for key, row in found[n].items() if "fps" in row}, n)
        cost = None
        if gradient and 1000 in points:
            from experiments.bench.peers.gradient import measure as measure_gradient

            cost = asdict(measure_gradient(load(work), 1000))
            print("gradient at 1000 points, 16 frames: " + ", ".join(f"{k} {v:.2f}" for k, v in cost.items()))
    info |= {"load_1min_after": round(os.getloadavg()[0], 2)}
    print("ratios: " + ", ".join(f"{k} {v}" for k, v in shares.items()))
    print(f"load average {info['load_1min']} before, {info['load_1min_after']} after")
    out.mkdir(parents=True, exist_ok=True)
    result = {"machine": info, "rounds": rounds, "seconds": seconds, "ratios": shares, "gradient": cost, "rows": found}
    (out / "same_work.json").write_text(json.dumps(result, indent=1) + "\n")
    plot(found, out / "same_work.png", f"6 steps a frame, 10 limbs; {info['cpu']}, {info['cores']} cores")
    if set_baseline:
        BASELINE.write_text(json.dumps({"machine": info, "ratios": shares}, indent=1) + "\n")
    return check(shares, str(info["cpu"])) if gate else 0


if __name__ == "__main__":
    raise SystemExit(tyro.cli(main))
