"""Stature and segments as tracking finds them."""

import numpy as np

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import TrackLog

PROMISE = Promise(
    name="sizes",
    sentence="Stature is found to 0.4 cm, segment lengths to 0.9 cm.",
    data="the 18 recordings",
    figures=(
        Figure("stature, cm", 0.4, tolerance=0.05),
        Figure("segments, cm", 0.9, tolerance=0.05),
        Figure("worst stature, cm", 1.5, tolerance=0.3),
    ),
    jobs=lambda data: [TrackLog(log) for log in data.logs()],
    measure=lambda logs: {
        "stature, cm": float(np.mean([o.stature_cm for o in logs])),
        "segments, cm": float(np.mean([o.segments_cm for o in logs])),
        "worst stature, cm": float(np.max([o.stature_cm for o in logs])),
    },
)
