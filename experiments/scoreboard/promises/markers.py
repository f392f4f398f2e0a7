"""Optical markers alone."""

import numpy as np

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import Outcome, TrackLog, accuracy


def measure(logs: list[Outcome]) -> dict[str, float]:
    """Joints and segments."""
    return {**accuracy(logs), "segments, cm": float(np.nanmean([o.segments_cm for o in logs]))}


PROMISE = Promise(
    name="markers",
    sentence="From optical markers alone joints are 1.7 cm from Plug-in Gait's.",
    data="the three recordings in markers/",
    figures=(
        Figure("joints, cm", 1.8, tolerance=0.1),
        Figure("lost", 0, tolerance=0, digits=0),
        Figure("segments, cm", 1.5, tolerance=0.1),
    ),
    jobs=lambda data: [TrackLog(log) for log in data.logs("markers")],
    measure=measure,
)
