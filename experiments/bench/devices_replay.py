"""Replay of logs on an accelerator and on the processor: python -m experiments.bench.devices_replay LOG.mcap ...

The command with `--engine batch`, in processes of its own: on the processor, then twice on what JAX finds here (without
and with compiled programs of the run before). Shown are the time of each run, how far the joints of one are from the
other's and, with LOG.truth.npz beside a log, from the truth, and whether the second run on the accelerator gives the
same bits as the first.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from experiments.common import errors, scored, table
from experiments.scoreboard.tracked import read_known
from voodoo_jax.exporters.npz import read_tracks_npz
from voodoo_jax.records.tracks import Tracks

RUNS = {"processor": "cpu", "accelerator, cold": "", "accelerator, warm": ""}  # JAX_PLATFORMS of each


def replay(logs: list[Path], out: Path, cache: Path, platform: str) -> float:
    """Seconds that the command takes for the logs, all included. Raises SystemExit if one cannot be tracked."""
    words = ["replay", *map(str, logs), "--out", str(out), "--engine", "batch", "--compile-cache", str(cache)]
    env = dict(os.environ) | ({"JAX_PLATFORMS": platform} if platform else {})
    began = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "voodoo_jax.cli", *words], env=env, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(
            f"replay on {platform or 'the accelerator'} ended with {done.returncode}:\n{done.stderr[-3000:]}"
        )
    return time.perf_counter() - began


def apart(one: Tracks, other: Tracks) -> tuple[float, float]:
    """Mean and largest distance of the joints, millimetres, where both have the body tracked."""
    both = one.tracked & other.tracked
    distance = 1e3 * np.linalg.norm(np.asarray(one.joints)[both] - np.asarray(other.joints)[both], axis=-1)
    return float(np.nanmean(distance)), float(np.nanmax(distance))


def from_truth(log: Path, tracks: Tracks) -> str:
    """Mean distance of the joints from the truth, cm; nothing where there is none."""
    if not log.with_suffix(".truth.npz").exists():
        return ""
    truth = read_known(log.with_suffix(".truth.npz"))
    return f"{100 * np.nanmean(errors(truth, tracks)[scored(truth)]):.2f}"


def main(logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG...")]) -> None:
    """Prints a table.

    Args:
        logs: recordings.
    """
    with tempfile.TemporaryDirectory() as folder:
        here, seconds = Path(folder), {}
        for name, platform in RUNS.items():
            seconds[name] = replay(list(logs), here / name, here / f"programs-{platform or 'other'}", platform)
        found = {
            name: {log.stem: read_tracks_npz(here / name / f"{log.stem}.tracks.npz") for log in logs} for name in RUNS
        }
    print(", ".join(f"{name} {taken:.1f} s" for name, taken in seconds.items()))
    rows, paths = [], {log.stem: log for log in logs}
    for stem, on_processor in found["processor"].items():
        cold, warm = found["accelerator, cold"][stem], found["accelerator, warm"][stem]
        same = np.array_equal(np.asarray(cold.joints), np.asarray(warm.joints), equal_nan=True)
        mean, most = apart(on_processor, cold)
        from_it = [from_truth(paths[stem], each) for each in (on_processor, cold)]
        rows.append([stem, f"{mean:.3f}", f"{most:.3f}", *from_it, "same bits" if same else "differ"])
    head = ["log", "joints apart, mean mm", "largest, mm", "processor from truth, cm", "accelerator, cm", "reruns"]
    print(table(head, rows))


if __name__ == "__main__":
    tyro.cli(main)
