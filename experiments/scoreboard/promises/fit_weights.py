"""Weights of bands and measurements, tuned on one half of the people by `fit --folds`, scored on the other."""

import numpy as np

from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.fits import TuneWeights


def jobs(data: Data) -> list[TuneWeights]:
    """Both ways round on every other recording; none when quick."""
    logs = tuple(data.logs()[::2])
    return [] if data.quick or not logs else [TuneWeights(logs, half) for half in (0, 1)]


def measure(found: list[tuple[float, float, float]]) -> dict[str, float]:
    """Of the halves that were not tuned on."""
    before, written, found_there = (float(np.mean([one[k] for one in found])) for k in range(3))
    return {
        "default weights, cm": before,
        "what is written, cm": written,
        "what was found, written or not, cm": found_there,
        "written minus default, cm": written - before,
    }


PROMISE = Promise(
    name="fit_weights",
    sentence="Weights tuned by gradient on some people (fit --folds) are written only where they do no harm on others.",
    data="every other of the 18 recordings, in halves by person",
    figures=(
        Figure("default weights, cm", None),
        Figure("what is written, cm", None),
        Figure("what was found, written or not, cm", None),
        Figure("written minus default, cm", 0.0, tolerance=0.02),
    ),
    jobs=jobs,
    measure=measure,
)
