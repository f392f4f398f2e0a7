"""What a replay costs, in units of a fixed work: python -m experiments.bench.work_ratios RECORDINGS

Short logs of the kinds of users_work and of the recordings, replayed by the command as users run it, all included,
after a run that compiles. Before and after each run stands calibration.py's work; the ratio of processor seconds is
to the mean of the two, and of some rounds the median counts. So another machine, and what else a machine does, hardly
matter. `--python` names interpreters that have other versions of the package, measured in turns with this one;
`--remembered` adds the ratios to work_history.json, as of versions of such names.
"""

import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import tyro

from experiments.bench.many_logs import measured, users_environment
from experiments.bench.replay_speed import machine
from experiments.bench.users_work import CLIP, camera, clip, there_and_back
from experiments.common import table
from voodoo_jax.compile.cache_dir import cache_folder
from voodoo_jax.simulate.mcap import write_simulation

HISTORY = Path(__file__).with_name("work_history.json")
CALIBRATION = Path(__file__).with_name("calibration.py")
SIMULATED = {"320x288": 10.0, "640x576": 5.0}  # seconds
PART = 4  # of the recordings
PATTERNS = {
    "three people": "people/three-one-enters.mcap",
    "markers": "markers/markers-*.mcap",
    "stereo": "stereo/stereo-walk-right.mcap",
}
NAMES = (*SIMULATED, "recordings", *PATTERNS)


@dataclass(frozen=True)
class Kind:
    """Logs that one command replays."""

    name: str
    logs: tuple[Path, ...]
    workers: int = 1


def simulated(folder: Path) -> list[Kind]:
    """One person before a camera of 640x576 pixels, and before one whose pixels are every second of these."""
    whole = clip(camera(640, 576, 75, 65), 1, CLIP / 2)
    c = whole.camera
    view = replace(c, width=c.width // 2, height=c.height // 2, fx=c.fx / 2, fy=c.fy / 2, cx=c.cx / 2, cy=c.cy / 2)
    seen = {"320x288": replace(whole, camera=view, depth=whole.depth[:, ::2, ::2]), "640x576": whole}
    return [
        Kind(name, (write_simulation(there_and_back(seen[name], seconds), folder / f"{name}.mcap"),))
        for name, seconds in SIMULATED.items()
    ]


def recorded(recordings: Path) -> list[Kind]:
    """Of real people and rendered ones: some of the recordings, three people, markers, stereo pairs."""
    logs = sorted(p for p in recordings.glob("*.mcap") if p.with_suffix(".truth.npz").exists())
    found = [Kind("recordings", tuple(logs[:: max(1, len(logs) // PART)][:PART]), 2)]
    for name, pattern in PATTERNS.items():
        found.append(Kind(name, tuple(sorted(recordings.glob(pattern)))))
    return [kind for kind in found if kind.logs]


def calibrated() -> float:
    """Processor seconds of the fixed work, in a process of its own."""
    command = [sys.executable, "-P", str(CALIBRATION)]
    said = subprocess.run(command, stdout=subprocess.PIPE, env=users_environment(), check=True, text=True).stdout
    return sum(json.loads(said).values())


Spent = Callable[[Kind], float]  # processor seconds of a replay


def in_turns(kinds: Sequence[Kind], replays: Mapping[str, Spent], rounds: int) -> dict[str, dict[str, float]]:
    """Medians of the ratios by version and kind of log."""
    found: dict[str, dict[str, list[float]]] = {version: {} for version in replays}
    for kind in kinds:
        for spent in replays.values():
            spent(kind)  # compiles
    for _ in range(rounds):
        before = calibrated()
        for kind in kinds:
            for version, spent in replays.items():
                seconds, after = spent(kind), calibrated()
                ratio = seconds / ((before + after) / 2)
                found[version].setdefault(kind.name, []).append(ratio)
                before = after
    return {version: {k: statistics.median(r) for k, r in ratios.items()} for version, ratios in found.items()}


def replay_of(python: str, cache: Path) -> Spent:
    """The command of the package that an interpreter has."""
    return lambda kind: measured(list(kind.logs), kind.workers, cache, python).processor


def ratios(recordings: Path | None, rounds: int = 3, pythons: Sequence[str] = ()) -> dict[str, dict[str, float]]:
    """Ratios by version (this one is "", others are named by their interpreters) and kind of log."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        caches = {"": Path(cache_folder("") or folder / "programs")}
        caches |= {python: folder / f"programs{k}" for k, python in enumerate(pythons)}
        kinds = [*simulated(folder), *(recorded(recordings) if recordings else [])]
        replays = {python: replay_of(python or sys.executable, cache) for python, cache in caches.items()}
        return in_turns(kinds, replays, rounds)


def remember(version: str, found: Mapping[str, float], path: Path = HISTORY) -> None:
    """Adds a version's ratios to the history."""
    known = json.loads(path.read_text()) if path.exists() else []
    where = {k: v for k, v in machine().items() if k != "load_1min"}
    row = {"version": version, "date": date.today().isoformat(), "machine": where}
    known.append(row | {"ratios": {name: round(value, 3) for name, value in found.items()}})
    path.write_text(json.dumps(known, indent=1) + "\n")


def main(
    recordings: tyro.conf.Positional[Path | None] = None,
    python: tuple[str, ...] = (),
    remembered: tuple[str, ...] = (),
    rounds: int = 3,
) -> None:
    """Prints a table.

    Args:
        recordings: folder with the recordings; without it simulated logs alone are measured.
        python: interpreters with other versions of the package.
        remembered: names of the versions, of the others first and then of this one, under which the ratios are added to
            work_history.json.
        rounds: runs of each kind of log.
    """
    found = ratios(recordings, rounds, python)
    order = [*python, ""]
    head = ["log", *(p or "this" for p in order)]
    rows = [[kind, *(f"{found[p][kind]:.2f}" for p in order)] for kind in found[""]]
    print(table(head, rows))
    for version, p in zip(remembered, order):
        remember(version, found[p])


if __name__ == "__main__":
    tyro.cli(main)
