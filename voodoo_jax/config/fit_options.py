"""Options of a fit. No JAX here: the command line shows them at once."""

from dataclasses import dataclass
from typing import Literal

from voodoo_jax.config.limited import check_bounds

# least and most of each number: with fewer frames or points nothing is determined, with more memory ends
BOUNDS: dict[str, tuple[float, float]] = {
    "folds": (0, 1000),
    "frames": (1, 100_000),
    "points": (1, 8192),
    "steps": (1, 10_000),
    "iterations": (1, 10_000),
    "rounds": (1, 100),
    "noise": (1e-6, 1e3),
    "looseness": (1e-6, 1e6),
    "stiffness": (1e-6, 1e6),
}


def check_fit(options: "FitSettings") -> None:
    """Raises ValueError for a number that no fit can be made with."""
    check_bounds(options, BOUNDS)


@dataclass(frozen=True)
class FitSettings:
    """Parameters, data and duration of a fit."""

    free: tuple[str, ...] = ("segments",)
    """Parameters to fit: segments (the reported lengths; of people upper arms, forearms, thighs, shanks), shape (scale
    and modes of variation at one stature, if the body file has [[mode]] tables), scale, lengths,
    radii, "joint centres", bands, "measurement weights", or patterns of names such as lengths.*thigh, radii.chest.top,
    bands.*.weight, bands.*.axes.x, anchors.hip.y, solve.ratio."""
    mirrored: bool = True
    """Change left and right equally."""
    persons: Literal["one", "each"] = "one"
    """one: all logs show the same person; each: every log shows another person and gets its own body. Bands,
    measurement weights and settings are common to all logs either way."""
    folds: int = 0
    """Cross-validation for parameters that people share (bands, measurement weights, solve.*), with logs of several
    people. In their order, logs form this number of folds; each is tracked with parameters fitted to the others, and
    only improvements are written. Every log has its own person. 0: stretches held back in each log decide."""
    frames: int = 24
    """Frames of each log to fit to, spread over the well tracked ones of every third stretch of time; the other
    stretches are held back."""
    points: int = 256
    """Points of a frame that determine its pose; as many others determine the loss."""
    steps: int = 30
    """ICP steps before the Newton steps, in each frame and each step of the fit."""
    iterations: int = 12
    """Largest number of steps of a round; it ends earlier if the loss hardly decreases."""
    rounds: int = 1
    """Rounds of tracking and fitting. More than one helps only if sizes are wrong by a tenth or more, since these give
    wrong poses: then take 3."""
    noise: float = 0.035
    """Distance of a person's surface from the body's cylinders (standard deviation, metres); a smaller one trusts the
    log more and the priors less. The default fits rendered people of known sizes (experiments/fit)."""
    looseness: float = 1.0
    """Factor that widens all priors; with folds, by four times as much."""
    stiffness: float = 20.0
    """Stiffness of the bands while sizes are fitted, relative to tracking (soft bands stretch to absorb wrong lengths).
    Use 1 if bands or solve are free."""
    markers: bool = False
    """Use all named 3D points of the logs for the loss and none for the poses; otherwise half for each."""
