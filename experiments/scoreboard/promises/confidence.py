"""What joint_confidence is worth."""

import numpy as np

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import Outcome, TrackLog
from experiments.trust.__main__ import rank

STEP = 5  # every fifth frame: enough goes wrong there to tell good from bad


def said_and_right(logs: list[Outcome]) -> tuple[np.ndarray, np.ndarray]:
    """Of all joints that something is said of: the probability that was said, and whether it was within 10 cm."""
    said, error = (np.concatenate([getattr(o, k).ravel() for o in logs]) for k in ("confidence", "error"))
    known = np.isfinite(said) & np.isfinite(error)
    return said[known], error[known] < 0.1


def measure(logs: list[Outcome]) -> dict[str, float]:
    """Calibration over all, how well right is told from wrong, and logs that are wrong unsaid."""
    said, right = said_and_right(logs)
    return {
        "said minus right, % (absolute)": 100 * abs(float(said.mean() - right.mean())),
        "right trusted more than wrong, %": 100 * rank(said, right),
        "wrong unsaid, logs": sum(o.wrong_unsaid for o in logs),
    }


PROMISE = Promise(
    name="confidence",
    sentence="Joint confidence is right: what is said and what is within 10 cm differ by at most a point.",
    data="the 18 recordings, as they are and every fifth frame",
    figures=(
        Figure("said minus right, % (absolute)", 1.0, tolerance=0.5),
        Figure("right trusted more than wrong, %", 95.0, "more", 1.5, 1),
        Figure("wrong unsaid, logs", 0, tolerance=0, digits=0),
    ),
    jobs=lambda data: [TrackLog(log) for log in data.logs()] + [TrackLog(log, step=STEP) for log in data.logs()],
    measure=measure,
)
