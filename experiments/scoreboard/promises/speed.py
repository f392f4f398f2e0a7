"""The command against real time, and a step of the kernels against NumPy and C on equal work."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

from experiments.bench.gate import ratios
from experiments.bench.many_logs import measured, recorded_seconds
from experiments.bench.same_work import measure as equal_work
from experiments.bench.work import from_demo, save
from experiments.common import DEMO
from experiments.scoreboard.board import Data, Figure, Promise
from voodoo_jax.compile.cache_dir import cache_folder

POINTS = 1000


@dataclass(frozen=True)
class ReplayLogs:
    """The command on some logs, once to fill the compile cache and once measured."""

    logs: tuple[Path, ...]

    def run(self) -> float:
        cache = Path(cache_folder("") or tempfile.mkdtemp())
        measured(list(self.logs), 2, cache)
        wall = measured(list(self.logs), 2, cache).wall
        return sum(recorded_seconds(log) for log in self.logs) / wall


@dataclass(frozen=True)
class EqualWork:
    """Six steps a frame of the papers' solver, beside dense C (if there is a compiler) and NumPy."""

    rounds: int

    def run(self) -> dict[str, float]:
        with tempfile.TemporaryDirectory() as folder:
            work = Path(folder) / "work.npz"
            save(from_demo((POINTS,)), work)
            keys = ("library", "library_batch", "c", "c_both", "numpy")
            rows = equal_work(work, POINTS, keys, self.rounds, 0.5)
        rates = {key: row["fps"] for key, row in rows.items() if "fps" in row}
        return {name.split("@")[0]: value for name, value in ratios(rates, POINTS).items()}


def jobs(data: Data) -> list[ReplayLogs | EqualWork]:
    """All recordings, or some; the demo where there are none."""
    logs = data.part(data.logs(), 2) or [DEMO / "demo.mcap"]
    return [ReplayLogs(tuple(logs)), EqualWork(3 if data.quick else 7)]


def measure(found: list) -> dict[str, float]:
    """A missing contender (no C compiler) is not a number."""
    work = found[1]
    nan = float("nan")
    return {
        "replay, times real time, warm": found[0],
        "step, one stream, of dense C": work.get("library/c", nan),
        "step, batch, of dense C on both cores": work.get("library_batch/c_both", nan),
        "step, batch, times NumPy": work.get("library_batch/numpy", nan),
    }


PROMISE = Promise(
    name="speed",
    sentence="On two cores 68 s of logs take 8 s; a step is half as fast as dense C and ten times as fast as NumPy.",
    data="the 18 recordings; equal work made from the demo",
    figures=(
        Figure("replay, times real time, warm", 8.0, "more", digits=1),
        Figure("step, one stream, of dense C", 0.4, "more"),
        Figure("step, batch, of dense C on both cores", 0.4, "more"),
        Figure("step, batch, times NumPy", 10.0, "more", digits=1),
    ),
    jobs=jobs,
    measure=measure,
    alone=True,
)
