"""A fit that begins from the body that comes with the package."""

from collections.abc import Sequence

import numpy as np

from experiments.fit.promises import Outcome
from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.fits import FitLogs

TOGETHER = ("walk-happy", "bow-active")  # one person; the README's two lines


def jobs(data: Data) -> list[FitLogs]:
    """Every recording by itself, and two of one person together; quick: one."""
    logs = data.logs()
    pair = tuple(p for p in logs if p.stem in TOGETHER)
    alone = [FitLogs((p,), True) for p in (logs[:1] if data.quick else logs)]
    return alone + ([FitLogs(pair, True)] if len(pair) == 2 and not data.quick else [])


def measure(found: Sequence[list[Outcome]]) -> dict[str, float]:
    """What users are left with, beside what they had: with a fitted body if it is written."""
    every = [one for some in found for one in some]
    return {
        "joints, worst log, cm worse": max(o.joints_after - o.joints_before for o in every),
        "segments, worst log, cm worse": max(o.segments_after - o.segments_before for o in every),
        "joints, mean, cm": float(np.mean([o.joints_after for o in every])),
        "written": sum(o.written for o in every),
    }


PROMISE = Promise(
    name="fit_right",
    sentence="A fit leaves no log worse: it writes a body only if that is better than the one it began from.",
    data="the 18 recordings one by one, two of one person together",
    figures=(
        Figure("joints, worst log, cm worse", 0.05, tolerance=0.05),
        Figure("segments, worst log, cm worse", 0.0, tolerance=0.05),
        Figure("joints, mean, cm", None),
        Figure("written", None, digits=0),
    ),
    jobs=jobs,
    measure=measure,
)
