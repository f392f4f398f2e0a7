"""Contenders' processes as seen from the measurement."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.bench.peers.contenders import CONTENDERS, Contender

ROOT = Path(__file__).parents[3]


@dataclass(frozen=True)
class Rate:
    """One round of one contender, over all its processes."""

    fps: float  # frames per second
    fps_of_processor: float  # frames per second of processor time: what a busy machine changes less


class Child:
    """A contender that waits in its processes."""

    def __init__(self, key: str, work: Path, points: int):
        self.contender: Contender = CONTENDERS[key]
        # a pinned process has one core: a library that starts a thread for each core of the machine would only wait
        one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"} if self.contender.pinned else {}
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        self.processes = [
            subprocess.Popen(
                [sys.executable, "-m", "experiments.bench.peers.serve", key, str(work), str(points),
                 str(core if self.contender.pinned else -1)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ | one | {"PYTHONPATH": path},
            )
            for core in range(self.contender.cores)
        ]  # fmt: skip
        self.ready = [self._read(p) for p in self.processes]

    @property
    def missing(self) -> str:
        """Why the contender cannot run; empty: it can."""
        return str(self.ready[0].get("missing", ""))

    @property
    def compile_s(self) -> float:
        """Seconds that the first run took longer than the second."""
        return float(self.ready[0]["compile_s"])

    @property
    def places(self) -> np.ndarray:
        """Where the limbs are after the last frame [limb, 3], metres."""
        return np.array(self.ready[0]["t"])

    def run(self, seconds: float) -> Rate:
        """Runs in all processes at once, each for about that long."""
        for process in self.processes:
            self._write(process, f"{seconds}\n")
        found = [self._read(p) for p in self.processes]
        return Rate(*(sum(f[k] for f in found) for k in ("fps", "fps_of_processor")))

    def close(self) -> None:
        """Ends the processes."""
        for process in self.processes:
            if process.poll() is None:
                process.stdin.close()  # pyright: ignore[reportOptionalMemberAccess]
            process.wait(60)

    def _write(self, process: subprocess.Popen, line: str) -> None:
        process.stdin.write(line)  # pyright: ignore[reportOptionalMemberAccess]
        process.stdin.flush()  # pyright: ignore[reportOptionalMemberAccess]

    def _read(self, process: subprocess.Popen) -> dict:
        for line in process.stdout:  # pyright: ignore[reportOptionalIterable]
            if line.startswith("{"):
                return json.loads(line)
        raise RuntimeError(f"{self.contender.label} ended with status {process.wait()}")
