"""MCAP files in all their layouts."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

from experiments.fuzz.conformance import count_right
from experiments.scoreboard.board import Figure, Promise


@dataclass(frozen=True)
class Layouts:
    """Reads the files of MCAP's conformance tests; how many are read right, of how many."""

    def run(self) -> tuple[int, int]:
        with tempfile.TemporaryDirectory() as folder:
            return count_right(Path(folder))


PROMISE = Promise(
    name="layouts",
    sentence="MCAP files are read whatever their layout: chunked or not, packed or not, with or without an index.",
    data="the 416 files of MCAP's conformance tests, and 616 of them with chunks in lz4 and zstd, made anew",
    figures=(
        Figure("files read wrong", 0, tolerance=0, digits=0),
        Figure("files", None, "more", digits=0),
    ),
    jobs=lambda data: [Layouts()],
    measure=lambda found: {"files read wrong": found[0][1] - found[0][0], "files": found[0][1]},
)
