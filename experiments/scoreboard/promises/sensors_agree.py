"""Sensors whose transforms contradict each other."""

from collections.abc import Sequence

import numpy as np

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.simulated import MisplacedCamera

NEAR, OBLIQUE, SIDE = (0.5, -1.2, 25.0), (0.8, -2.2, 45.0), (3.0, -3.0, 90.0)
TAKES = (
    MisplacedCamera("wave", 1.75, 120.0, NEAR), MisplacedCamera("walk", 1.6, 200.0, SIDE),
    MisplacedCamera("wave", 1.7, 160.0, NEAR, (0.1, 0.06, -0.02), (4.0, 0.0)),
    MisplacedCamera("walk", 1.85, 190.0, NEAR, (-0.05, 0.09, 0.03), (-3.0, 1.0)),
    MisplacedCamera("bow", 1.65, 150.0, NEAR, (0.04, -0.02, 0.0), (1.5, 0.5)),
    MisplacedCamera("walk", 1.7, 170.0, OBLIQUE, (0.08, 0.08, 0.0), (-4.0, 0.0)),
    MisplacedCamera("wave", 1.8, 100.0, OBLIQUE, (0.0, -0.1, 0.05), (0.0, 2.0)),
    MisplacedCamera("bow", 1.9, 180.0, SIDE, (-0.1, 0.05, 0.05), (2.0, -2.0)),
)  # fmt: skip
OFF = 10.0  # cm: a joint that is farther off is wrong


def measure(takes: Sequence[tuple[float, float, bool, float]]) -> dict[str, float]:
    """Cameras that are where the log says (two), and others."""
    before, after, said, sure = np.transpose(takes).astype(float)
    good, bad = before < 0.1, before >= 0.1
    wrong = bad & (after > OFF)
    return {
        "moved though right, cm": float(after[good].max(initial=0.0)),
        "as the log says, cm": float(before[bad].mean()) if bad.any() else 0.0,
        "as read, cm": float(after[bad].mean()) if bad.any() else 0.0,
        "made worse, cm": float((after - before).max()),
        "put right, %": 100.0 * float(np.mean(after[bad] < 0.5 * before[bad])) if bad.any() else 100.0,
        "wrong and not doubted": float(np.sum(wrong & (sure > 0.5))),
        "wrong and unsaid": float(np.sum(wrong & (said == 0))),
    }


PROMISE = Promise(
    name="sensors_agree",
    sentence="Two sensors whose transforms contradict each other are put right or doubted, right ones are not.",
    data="simulated people before two cameras, two of eight pairs right",
    figures=(
        Figure("moved though right, cm", 0.1, tolerance=0.1),
        Figure("as the log says, cm", None),
        Figure("as read, cm", None),
        Figure("made worse, cm", 1.0, tolerance=1.0),
        Figure("put right, %", None),
        Figure("wrong and not doubted", 0.0),
        Figure("wrong and unsaid", 0.0),
    ),
    jobs=lambda data: data.part(TAKES, 2),
    measure=measure,
)
