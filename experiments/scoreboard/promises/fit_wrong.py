"""A fit that begins from a body whose upper arms, forearms, thighs and shanks are each 8 % too long."""

from collections.abc import Sequence

import numpy as np

from experiments.fit.promises import Outcome
from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.fits import FitLogs


def jobs(data: Data) -> list[FitLogs]:
    """Every recording by itself; quick: one."""
    logs = data.logs()
    return [FitLogs((p,), False) for p in (logs[:1] if data.quick else logs)]


def measure(found: Sequence[list[Outcome]]) -> dict[str, float]:
    """How often it writes, and what is left of the segments' error."""
    every = [one for some in found for one in some]
    before, after = (float(np.mean([getattr(o, k) for o in every])) for k in ("segments_before", "segments_after"))
    return {
        "written, %": 100 * float(np.mean([o.written for o in every])),
        "segments before, cm": before,
        "segments after, cm": after,
        "segments, after of before": after / before,
        "joints before, cm": float(np.mean([o.joints_before for o in every])),
        "joints after, cm": float(np.mean([o.joints_after for o in every])),
    }


PROMISE = Promise(
    name="fit_wrong",
    sentence="Lengths that are 8 % wrong are mended from one log, in 15 of 18 at least: half of it is gone.",
    data="the 18 recordings one by one",
    figures=(
        Figure("written, %", 83.0, "more", 6.0, 0),
        Figure("segments before, cm", None),
        Figure("segments after, cm", None, tolerance=0.2),
        Figure("segments, after of before", 0.5, tolerance=0.06),
        Figure("joints before, cm", None),
        # of one log (quick) 1.56 with one thread, 1.95 with two, 1.73 on another processor, by the same code
        Figure("joints after, cm", None, tolerance=0.45),
    ),
    jobs=jobs,
    measure=measure,
)
