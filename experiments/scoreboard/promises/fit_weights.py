"""Weights of bands and measurements, tuned on one half of the people."""

import numpy as np

from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.fits import TuneWeights


def jobs(data: Data) -> list[TuneWeights]:
    """Both ways round on every other recording; none when quick."""
    logs = tuple(data.logs()[::2])
    return [] if data.quick or not logs else [TuneWeights(logs, half) for half in (0, 1)]


def measure(found: list[tuple[float, float]]) -> dict[str, float]:
    """Of the halves that were not tuned on."""
    before, after = (float(np.mean([one[k] for one in found])) for k in (0, 1))
    return {"default weights, cm": before, "tuned on the others, cm": after, "tuned minus default, cm": after - before}


PROMISE = Promise(
    name="fit_weights",
    sentence="Weights tuned by gradient on some people do no harm on others.",
    data="every other of the 18 recordings, in halves by person",
    figures=(
        Figure("default weights, cm", None),
        Figure("tuned on the others, cm", None),
        Figure("tuned minus default, cm", 0.05, tolerance=0.05),
    ),
    jobs=jobs,
    measure=measure,
)
