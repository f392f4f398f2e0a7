"""Users' logs against real time: cameras of today, up to a minute long, several people, markers, stereo.

A promise for each kind of log, so that they can be measured one by one: to render and track them all takes long.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.bench.users_work import Work, kinds, work
from experiments.scoreboard.board import Data, Figure, Promise

SECONDS = 60.0
WALK = "simulated people who walk, 30 Hz, "
# by kind of log: times real time that are wanted (None: it is told), what is said of it, and of what it is measured
KINDS: dict[str, tuple[float | None, str, str]] = {
    "320x288": (10.0, "A minute of one person at 320x288 is to take six seconds on two cores.", WALK + "60 s"),
    "320x288_three_people": (None, "How fast three people are is told, not promised.", WALK + "30 s"),
    "640x576": (5.0, "Half a minute at 640x576 is to take six seconds on two cores.", WALK + "30 s"),
    "1280x720": (None, "How fast large images are is told, not promised.", WALK + "15 s"),
    "markers": (None, "How fast markers are is told, not promised.", "the largest recording of markers"),
    "stereo": (None, "How fast stereo pairs are is told, not promised.", "the largest recording of stereo pairs"),
}


@dataclass(frozen=True)
class ReplayWork:
    """One kind of log, made and replayed."""

    kind: str
    recordings: Path | None

    def run(self) -> Work:
        with tempfile.TemporaryDirectory() as folder:
            return work(*kinds(self.recordings, SECONDS)[self.kind](Path(folder)))


def jobs(data: Data, kind: str) -> list[ReplayWork]:
    """None when quick, for they take minutes, and none where the recordings are not there."""
    there = () if data.quick else kinds(data.recordings, SECONDS)
    return [ReplayWork(kind, data.recordings)] if kind in there else []


def measure(found: Sequence[Work]) -> dict[str, float]:
    (w,) = found
    return {"times real time": w.times_real_time, "of one core": w.per_core, "memory, GB": w.memory}


def promise(kind: str) -> Promise:
    """That of one kind of log."""
    limit, sentence, data = KINDS[kind]
    return Promise(
        name=f"users_work/{kind}",
        sentence=sentence,
        data=data,
        figures=(
            Figure("times real time", limit, "more", digits=1),
            Figure("of one core", None, "more", digits=1),
            Figure("memory, GB", 2.0),
        ),
        jobs=lambda data: jobs(data, kind),
        measure=measure,
        details=lambda found: [
            f"{w.seconds:.0f} s in {w.wall:.1f} s, {w.processor:.1f} s of processors" for w in found
        ],
        alone=True,
    )


PROMISES = tuple(map(promise, KINDS))
