"""Which way is up of markers alone: laboratories have y up as often as z."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import voodoo_jax as vj
from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.tracked import recording_of

# seen in the recordings: the axis along which people stand; the logs themselves say z of all of them
UPWARDS = {
    "expert-sit-to-stand": "y", "lear-walk": "y", "rajagopal-walk": "y", "sprint-3.5ms": "y", "isb-44-markers": "z",
    "pig-child-walk": "z", "vicon-treadmill": "z",
}  # fmt: skip
CHEAP = ("lear-walk", "pig-child-walk")


@dataclass(frozen=True)
class Upwards:
    """By how many degrees up is another way."""

    log: Path
    seconds = 12.0

    def run(self) -> float:
        up = vj.track(vj.human(), recording_of(self.log)).up
        assert up is not None
        return float(np.degrees(np.arccos(np.clip(up["xyz".index(UPWARDS[self.log.stem])], -1, 1))))


def jobs(data: Data) -> list[Upwards]:
    """A job for each log; quick: one of either kind."""
    logs = [] if data.recordings is None else sorted((data.recordings / "real/markers").glob("*.mcap"))
    return [Upwards(log) for log in logs if log.stem in UPWARDS and (log.stem in CHEAP or not data.quick)]


def measure(found: Sequence[float]) -> dict[str, float]:
    """The worst of them."""
    return {"off, degrees": max(found), "wrong, logs": sum(x > 15 for x in found)}


PROMISE = Promise(
    name="up",
    sentence="Markers alone tell which way is up, by who stands on their feet.",
    data="seven recordings in real/markers/, four with y up; their frames would have z up",
    figures=(Figure("off, degrees", 5.0, tolerance=2.0, digits=1), Figure("wrong, logs", 0, tolerance=0, digits=0)),
    jobs=jobs,
    measure=measure,
)
