"""Optical markers of other laboratories and sets."""

from collections.abc import Sequence

import numpy as np

from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.tracked import Outcome, TrackLog

NOT_METRES = "bts-helen-hayes"  # its lengths are a third of a person's: it is there for the names of its markers only
CHEAP = ("lear-walk", "pig-child-walk")


def jobs(data: Data) -> list[TrackLog]:
    """A job for each log that has a truth in metres; quick: a set that is known, and one that is not."""
    logs = [log for log in data.logs("real/markers") if log.stem != NOT_METRES]
    return [TrackLog(log) for log in logs if log.stem in CHEAP or not data.quick]


def measure(logs: Sequence[Outcome]) -> dict[str, float]:
    """How far off, and how many are wrong unsaid."""
    errors = [o.error_cm for o in logs]
    return {
        "joints, cm": float(np.mean(errors)),
        "worst log, cm": max(errors),
        "logs beyond 3 cm": sum(e > 3 for e in errors),
        "wrong unsaid, logs": sum(o.wrong_unsaid for o in logs),
    }


PROMISE = Promise(
    name="real_markers",
    sentence="Marker sets of other laboratories are tracked to 2.5 cm.",
    data="the recordings with a truth in real/markers/, but for one that is not in metres",
    figures=(
        Figure("joints, cm", 2.5, tolerance=2.0, digits=1),
        Figure("worst log, cm", 3.0, tolerance=5.0, digits=1),
        Figure("logs beyond 3 cm", 0, tolerance=0, digits=0),
        Figure("wrong unsaid, logs", 0, tolerance=0, digits=0),
    ),
    jobs=jobs,
    measure=measure,
)
