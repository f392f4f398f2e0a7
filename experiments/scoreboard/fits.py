"""Fits as jobs: of one recording, of simulated noise, of simulated limbs that are far off, of weights on one half."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from experiments.common import halves, human, load_log
from experiments.fit.promises import WRONG, Outcome, fitted_to, recovers_simulated, refuses_noise, wrong
from experiments.fit.weights import tracked
from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.fit import Seen, fit_tracked
from voodoo_jax.fitting.folds import with_bands
from voodoo_jax.fitting.frames import Truth


@dataclass(frozen=True)
class FitLogs:
    """`voodoo-jax fit` on recordings of one person, begun from the usual body or from one 8 % too long."""

    logs: tuple[Path, ...]
    right: bool
    seconds = 40.0

    def run(self) -> list[Outcome]:
        return fitted_to(self.logs, human() if self.right else wrong(human(), WRONG))


@dataclass(frozen=True)
class FitNoise:
    """A fit of a right body to simulated logs that differ from it by the sensor's noise only: which leave it alone."""

    count: int
    seconds = 120.0

    def run(self) -> list[bool]:
        return refuses_noise(self.count)


@dataclass(frozen=True)
class FitSimulated:
    """Segments that are 15 % off, fitted to a simulated person: what is left of it by segment, cm."""

    noise: bool
    seconds = 300.0

    def run(self) -> dict[str, float]:
        return recovers_simulated(self.noise)


@dataclass(frozen=True)
class TuneWeights:
    """Weights of bands and measurements tuned to the truth of one half of the people; joint errors of the other half
    before and after, cm."""

    logs: tuple[Path, ...]
    half: int
    seconds = 300.0

    def run(self) -> tuple[float, float]:
        body, settings, parts = human(), Settings(), halves(list(self.logs))
        own, others = ([load_log(p, body, settings) for p in parts[k]] for k in (self.half, 1 - self.half))
        seen = [Seen(log.track(body, settings), log.people, log.scene) for log in own]
        truths = [Truth(log.stamps, log.names, log.joints) for log in own]
        # as experiments/fit/weights: every person has a body of its own, bands and weights are common, narrow priors
        options = FitSettings(frames=16, persons="each", looseness=0.3)
        found = fit_tracked(
            seen, settings, replace(options, free=("bands.*.weight", "measurement weights")), truths
        )  # fmt: skip
        mean = lambda scores: float(np.mean([s.error_cm for s in scores]))  # noqa: E731
        tuned = with_bands(body, found.starts[0], found.fitted[0])
        return mean(tracked(others, body, settings)), mean(tracked(others, tuned, found.tuned))
