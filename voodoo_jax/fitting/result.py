"""What a fit found, and how each recording was judged before and after."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.judge import Judged, Verdict
from voodoo_jax.fitting.sizes import Size
from voodoo_jax.model.body import Body


@dataclass(frozen=True)
class Fit:
    """What a fit found. `x`, `sd`, `prior_sd` as in Parameters: logarithms of factors, or shares of the scale."""

    body: Body  # of the first person: the fitted one where that is better, else the one before
    bodies: tuple[Body, ...]  # of every person
    fitted: tuple[Body, ...]  # what was found, better or not
    starts: tuple[Body, ...]  # before the fit
    verdict: Verdict
    names: tuple[str, ...]
    x: Float64[np.ndarray, " all"]
    sd: Float64[np.ndarray, " all"]
    spread: Float64[np.ndarray, " all"]  # between parts of the recordings, see gauss_newton.spread
    prior_sd: Float64[np.ndarray, " all"]
    stays: Bool[np.ndarray, " all"]  # what the recordings do not tell, and what therefore stayed
    sizes: tuple[tuple[Size, ...], ...]  # of every person: what a tape would tell, before and after
    losses: tuple[float, ...]
    finished: bool  # stopped by itself
    judged: tuple[Judged, ...]
    settings: FitSettings
    tuned: Settings  # the settings with what was found of the solve's options and of the features' weights

    @property
    def better(self) -> bool:
        """Whether the fitted body is better than the one before; if not, `body` is the one before."""
        return self.verdict.better

    @property
    def report(self) -> str:
        """The report as Markdown."""
        from voodoo_jax.fitting.report import report_text  # which takes what stands here

        return report_text(self)

    def undetermined(self) -> list[str]:
        """Parameters that the data do not tell: they stayed where they were."""
        return [name for name, stays in zip(self.names, self.stays) if stays]
