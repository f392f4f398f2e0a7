"""Fits as jobs: of one recording, of simulated noise, of simulated limbs that are far off, of weights on one half."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.common import halves, human, load_log
from experiments.fit.promises import WRONG, Outcome, fitted_to, recovers_simulated, refuses_noise, wrong
from experiments.fit.weights import tracked
from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.front import fit


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
    """`voodoo-jax fit --folds` of the weights of bands and measurements to the truth of one half of the people; joint
    errors of the other half before, with what is written and with what was found, cm."""

    logs: tuple[Path, ...]
    half: int
    seconds = 600.0

    def run(self) -> tuple[float, float, float]:
        body, settings, parts = human(), Settings(), halves(list(self.logs))
        options = FitSettings(frames=16, folds=4, free=("bands.*.weight", "measurement weights"))
        own = parts[self.half]
        found = fit(body, own, settings, options, [p.with_suffix(".truth.npz") for p in own])
        others = [load_log(p, body, settings) for p in parts[1 - self.half]]
        mean = lambda its, how: float(np.mean([s.error_cm for s in tracked(others, its, how)]))  # noqa: E731
        before, after = mean(body, settings), mean(found.fitted[0], found.tuned)
        return before, after if found.better else before, after
