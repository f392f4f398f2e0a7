"""Several sensors in one log."""

from collections.abc import Sequence

import numpy as np

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.simulated import TwoCameras

TAKES = (
    TwoCameras("wave", 1.78, 90.0, beside=False), TwoCameras("walk", 1.65, 180.0, beside=True),
    TwoCameras("bow", 1.9, 135.0, beside=True), TwoCameras("wave", 1.6, 200.0, beside=False),
)  # fmt: skip


def measure(takes: Sequence[tuple[float, float]]) -> dict[str, float]:
    """With both, and how much more that is than with one."""
    both, one = np.transpose(takes)
    return {
        "joints, two cameras, cm": float(both.mean()),
        "joints, one camera, cm": float(one.mean()),
        "two minus one at worst, cm": float((both - one).max()),
    }


PROMISE = Promise(
    name="several_sensors",
    sentence="Sensors of other rates and places add up: with two cameras nobody is tracked worse than with one.",
    data="simulated people between two cameras",
    figures=(
        Figure("joints, two cameras, cm", 2.0, tolerance=0.12),
        Figure("joints, one camera, cm", None),
        Figure("two minus one at worst, cm", 0.0, tolerance=0.2),
    ),
    jobs=lambda data: data.part(TAKES, 1),
    measure=measure,
)
