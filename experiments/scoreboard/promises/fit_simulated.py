"""Simulated limbs that are far off."""

from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.fits import FitSimulated


def jobs(data: Data) -> list[FitSimulated]:
    """Without and with noise; none when quick."""
    return [] if data.quick else [FitSimulated(False), FitSimulated(True)]


PROMISE = Promise(
    name="fit_simulated",
    sentence="Simulated segments that are 15 % off come back to 0.5 cm without noise and to 1 cm with the camera's.",
    data="a simulated person who bends and stretches, seen as a whole",
    figures=(
        Figure("without noise, worst segment, cm", 0.5, tolerance=0.1),
        Figure("with noise, worst segment, cm", 1.0, tolerance=0.2),
    ),
    jobs=jobs,
    measure=lambda found: {
        f"{word} noise, worst segment, cm": max(map(abs, one.values())) for word, one in zip(("without", "with"), found)
    },
)
