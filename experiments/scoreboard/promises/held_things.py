"""Things that are picked up and put down."""

from collections.abc import Sequence

import numpy as np

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.simulated import PickedUp

TAKES = (PickedUp(1.7, known=False), PickedUp(1.7, known=True), PickedUp(1.85, known=False))


def measure(takes: Sequence[tuple[float, float, float]]) -> dict[str, float]:
    """Means over the takes."""
    joints, ends, median = np.mean(takes, 0)
    return {
        "joints, cm": float(joints),
        "ends of the stick, median, cm": float(median),
        "ends of the stick, mean, cm": float(ends),
    }


PROMISE = Promise(
    name="held_things",
    sentence="Things that are picked up and put down are tracked with the body: joints to 3 cm, a stick to 6 cm.",
    data="simulated people who wave with a stick for a while",
    figures=(
        Figure("joints, cm", 3.0, tolerance=0.2),
        Figure("ends of the stick, median, cm", 6.0, tolerance=0.5),
        Figure("ends of the stick, mean, cm", None, tolerance=1.0),
    ),
    jobs=lambda data: data.part(TAKES, 1),
    measure=measure,
)
