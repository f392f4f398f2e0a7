"""One scan, as a scanner or a depth camera gives it."""

from collections.abc import Sequence

import numpy as np

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.simulated import Scan

TAKES = (
    Scan(1.60, 5.0, 0.4, 1), Scan(1.72, 40.0, -1.0, 1), Scan(1.85, 90.0, 0.1, 1), Scan(1.55, 10.0, 2.8, 2),
    Scan(1.78, 60.0, 1.5, 3), Scan(1.68, 90.0, -0.6, 3), Scan(1.90, 90.0, -2.2, 4), Scan(1.64, 150.0, 0.3, 2),
)  # fmt: skip


def measure(takes: Sequence[tuple[float, float, float]]) -> dict[str, float]:
    """Of scans of single people."""
    joints, tracked, sure = np.transpose(takes)
    return {
        "joints, cm": float(joints.mean()),
        "worst, cm": float(joints.max()),
        "said to be tracked, %": 100 * float(tracked.mean()),
        "within 5 cm, %": 100 * float((joints < 5).mean()),
        "wrong and sure": float(((joints > 10) & (sure > 0.8)).sum()),
    }


PROMISE = Promise(
    name="single_scan",
    sentence="A person is found and fitted in a single cloud of points, of one camera or several joined.",
    data="simulated people, arms down, apart, stretched out and raised; clouds of one to four cameras in one file",
    figures=(
        Figure("joints, cm", None),
        Figure("worst, cm", None),
        Figure("said to be tracked, %", 100, better="more"),
        Figure("within 5 cm, %", 85, better="more"),
        Figure("wrong and sure", 0),
    ),
    jobs=lambda data: data.part(TAKES, 2),
    measure=measure,
)
