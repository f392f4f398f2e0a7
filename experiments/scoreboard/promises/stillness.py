"""Who stands still does not tremble."""

from collections.abc import Sequence

import numpy as np

from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.simulated import StandingStill

AWAY = (2.5, 3.5)  # metres
STATURES = (1.75, 1.6, 1.9)  # metres


def jobs(data: Data) -> list[StandingStill]:
    """Three people at both distances; quick: one."""
    return [StandingStill(stature, away) for away in AWAY for stature in STATURES[: 1 if data.quick else None]]


def measure(found: Sequence[float]) -> dict[str, float]:
    """Means at each distance."""
    return {f"at {away} m, mm": float(one) for away, one in zip(AWAY, np.reshape(found, (len(AWAY), -1)).mean(1))}


PROMISE = Promise(
    name="stillness",
    sentence="Simulated people who stand still tremble by 0.9 mm at 2.5 m and 1.2 mm at 3.5 m (r.m.s.).",
    data="three simulated people at both distances",
    figures=(
        Figure("at 2.5 m, mm", 0.95, tolerance=0.1),
        Figure("at 3.5 m, mm", 1.25, tolerance=0.15),
    ),
    jobs=jobs,
    measure=measure,
)
