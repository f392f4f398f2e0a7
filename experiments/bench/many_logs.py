"""How much faster than real time is the command, everything included: cold and warm, with one worker and with several?

    python experiments/bench/many_logs.py LOG.mcap ... [--workers 1 2] [--rounds 3]

Each run is the installed package's command in a process of its own: start, imports, reading, finding the person,
tracking there and back, writing. Cold: without any compiled program; warm: with the compile cache that the cold run
has filled. Runs are made in rounds, one of each kind, so that a busy machine hits all alike; the ratio of several
workers to one is the median of the rounds' ratios. Beside the wall time stands the processor time of all processes
together, which a busy machine changes little.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from voodoo_jax.io.log_reader import open_log


@dataclass(frozen=True)
class Measured:
    """One run of the command."""

    wall: float  # seconds
    processor: float  # seconds, of all processes together
    memory: float  # GB, of the largest process


def users_environment() -> dict[str, str]:
    """This process's, but that Python keeps its bytecode as it does for users: else each start compiles all sources."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def recorded_seconds(log: Path) -> float:
    """From a log's first frame to its last."""
    stamps = [frame.time_ns for frame in open_log(log).frames()]
    return (stamps[-1] - stamps[0]) / 1e9


def measured(logs: list[Path], workers: int, cache: Path, python: str = sys.executable) -> Measured:
    """Replays the logs into a folder that is thrown away, by the package that an interpreter has. Raises
    CalledProcessError if one cannot be tracked."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as out:
        words = ["replay", *map(str, logs), "--out", out, "--workers", str(workers), "--compile-cache", str(cache)]
        command = [python, "-P", "-m", "voodoo_jax.cli", *words]
        with tempfile.TemporaryFile() as said:
            process = subprocess.Popen(command, stdout=said, stderr=subprocess.STDOUT, env=users_environment())
            _, status, used = os.wait4(process.pid, 0)  # what it and its workers used
            process.returncode = os.waitstatus_to_exitcode(status)
            if process.returncode:
                said.seek(0)
                raise subprocess.CalledProcessError(process.returncode, command, said.read())
    # Linux counts in kB
    return Measured(time.perf_counter() - began, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e6)


def main(logs: tyro.conf.Positional[tuple[Path, ...]], workers: tuple[int, ...] = (1, 2), rounds: int = 3) -> None:
    """Measures and prints a table.

    Args:
        logs: recordings.
        workers: numbers of workers to compare; the first one is what the others are compared with.
        rounds: runs of each kind.
    """
    length = sum(recorded_seconds(log) for log in logs)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    print(f"{len(logs)} logs, {length:.1f} s recorded, {cores} cores, load average {os.getloadavg()[0]:.1f} before")
    runs: dict[tuple[str, int], list[Measured]] = {}
    for _ in range(rounds):
        for count in workers:
            with tempfile.TemporaryDirectory() as cache:
                for kind in ("cold", "warm"):
                    runs.setdefault((kind, count), []).append(measured(list(logs), count, Path(cache)))
    print("| | workers | wall, s | times real time | processor, s | wall against the first |")
    print("|---|---:|---:|---:|---:|---:|")
    for (kind, count), found in sorted(runs.items(), key=lambda item: item[0]):
        wall = statistics.median(m.wall for m in found)
        spent = statistics.median(m.processor for m in found)
        ratio = statistics.median(first.wall / m.wall for first, m in zip(runs[kind, workers[0]], found))
        print(f"| {kind} | {count} | {wall:.1f} | {length / wall:.2f} | {spent:.1f} | {ratio:.2f} |")
    print(f"load average {os.getloadavg()[0]:.1f} after")


if __name__ == "__main__":
    tyro.cli(main)
