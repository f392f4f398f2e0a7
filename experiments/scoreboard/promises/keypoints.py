"""Key points of several calibrated cameras alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import voodoo_jax as vj
from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.tracked import compared, read_known, recording_of


@dataclass(frozen=True)
class Everybody:
    """How far the nearest person that was found is from each whose truth is known, cm."""

    log: Path
    seconds = 60.0

    def run(self) -> list[float]:
        found = vj.track_people(vj.human(), recording_of(self.log))
        truths = sorted(self.log.parent.glob(f"{self.log.stem}*.truth.npz"))
        return [min(compared(one, read_known(truth)).error_cm for one in found) for truth in truths]


def measure(found: Sequence[list[float]]) -> dict[str, float]:
    """Of logs of one person, and of several."""
    alone, several = ([x for x in found if (len(x) > 1) == more] for more in (False, True))
    return {
        "one person, cm": max((x[0] for x in alone), default=float("nan")),
        "the worst of several, cm": max((max(x) for x in several), default=float("nan")),
    }


def jobs(data: Data) -> list[Everybody]:
    """A job for each log."""
    return [Everybody(log) for log in data.logs("real/keypoints")]


PROMISE = Promise(
    name="keypoints",
    sentence="From key points of several calibrated cameras joints are 2.4 cm off, and people are told apart.",
    data="the recordings in real/keypoints/ (four cameras, OpenPose), beside Pose2Sim's own triangulation",
    figures=(Figure("one person, cm", 2.4, tolerance=0.2), Figure("the worst of several, cm", 4.0, tolerance=0.5)),
    jobs=jobs,
    measure=measure,
)
