"""A fit where there is nothing to fit."""

from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.fits import FitNoise


def jobs(data: Data) -> list[FitNoise]:
    """Ten simulated logs; none when quick."""
    return [] if data.quick else [FitNoise(10)]


PROMISE = Promise(
    name="fit_noise",
    sentence="A right body is left alone in nine of ten logs that hold nothing but noise.",
    data="ten simulated people",
    figures=(Figure("left alone, of ten", 9, "more", 1, 0),),
    jobs=jobs,
    measure=lambda found: {"left alone, of ten": sum(found[0])},
)
