"""What replays cost, in units of a fixed work of the same kinds: no change may make them dearer unseen."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.bench.work_ratios import NAMES, ratios
from experiments.scoreboard.board import Data, Figure, Promise

SLACK = 0.15  # of a ratio; medians of three runs in turns differ by a third of that


@dataclass(frozen=True)
class Ratios:
    """Short logs of each kind, three rounds."""

    recordings: Path | None

    def run(self) -> dict[str, float]:
        return ratios(self.recordings)[""]


def measure(found: Sequence[dict[str, float]]) -> dict[str, float]:
    """By kind of log; not a number where there are no recordings."""
    return {name: found[0].get(name, math.nan) for name in NAMES}


def jobs(data: Data) -> list[Ratios]:
    """The same whether quick or not."""
    return [Ratios(data.recordings)]


PROMISE = Promise(
    name="work_ratios",
    sentence="No change makes a replay dearer by more than 15 % unseen: processor seconds over those of a fixed work.",
    data="10 s at 320x288, 5 s at 640x576, 4 of the recordings, three people, markers, stereo pairs",
    figures=tuple(Figure(name, None, tolerance=SLACK, relative=True) for name in NAMES),
    jobs=jobs,
    measure=measure,
    alone=True,
)
