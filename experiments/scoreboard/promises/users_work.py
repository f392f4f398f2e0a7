"""Users' logs against real time: cameras of today, a minute long, several people, markers, stereo."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

from experiments.bench.users_work import Work, kinds, work
from experiments.scoreboard.board import Data, Figure, Promise

SECONDS = 60.0


@dataclass(frozen=True)
class ReplayWork:
    """One kind of log, made and replayed."""

    kind: str
    recordings: Path | None

    def run(self) -> tuple[str, Work]:
        with tempfile.TemporaryDirectory() as folder:
            return self.kind, work(kinds(self.recordings, SECONDS)[self.kind](Path(folder)))


def jobs(data: Data) -> list[ReplayWork]:
    """None when quick: they take minutes."""
    return [] if data.quick else [ReplayWork(kind, data.recordings) for kind in kinds(data.recordings, SECONDS)]


def measure(found: list[tuple[str, Work]]) -> dict[str, float]:
    """Kinds whose recordings are not there are no numbers."""
    times = dict(found)
    told = {
        f"{kind}, times real time": times[kind].times_real_time if kind in times else float("nan") for kind in KINDS
    }
    return told | {"most memory, GB": max(w.memory for w in times.values())}


KINDS = {
    "320x288": 10.0,
    "320x288, three people": None,
    "640x576": 5.0,
    "1280x720": None,
    "markers": None,
    "stereo": None,
}
PROMISE = Promise(
    name="users_work",
    sentence="A minute at 320x288 is to take six seconds, one at 640x576 twelve, on two cores.",
    data="simulated people who walk, 30 Hz, 15 to 60 s; the largest recordings of markers and stereo",
    figures=(
        *(Figure(f"{kind}, times real time", limit, "more", digits=1) for kind, limit in KINDS.items()),
        Figure("most memory, GB", 2.0),
    ),
    jobs=jobs,
    measure=measure,
    details=lambda found: [
        f"{kind}: {w.seconds:.0f} s in {w.wall:.1f} s, {w.processor:.1f} s of processors, {w.memory:.2f} GB"
        for kind, w in found
    ],
    alone=True,
)
