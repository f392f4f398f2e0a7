"""Options of a fit. No JAX here: the command line shows them at once."""

from dataclasses import dataclass
from typing import Literal

from voodoo_jax.config.bounds import check_bounds

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
    """What is fitted to what, and how long."""

    free: tuple[str, ...] = ("segments",)
    """What may change: segments (the lengths that are reported: of people upper arms, forearms, thighs, shanks), shape
    (scale and the main ways in which people of one stature differ, if the body file has [[mode]] tables), scale,
    lengths, radii, "joint centres", bands, "measurement weights", or patterns of names such as lengths.*thigh,
    radii.chest.top, bands.*.weight, bands.*.axes.x, anchors.hip.y, solve.ratio."""
    mirrored: bool = True
    """Left and right change alike."""
    persons: Literal["one", "each"] = "one"
    """one: all logs show the same person; each: every log another one, with a body of its own. Bands, measurement
    weights and settings are common to all logs either way."""
    folds: int = 0
    """For what people have in common (bands, measurement weights, solve.*), over logs of several people: cut the logs
    into so many runs, in the order given, track each run with what the others gave, and write only what is better
    there. Every log then has a person of its own. 0: time held back in each log judges."""
    frames: int = 24
    """Frames of each log that are fitted to, spread over the well tracked ones of every third run of time; the others
    are held back and judge."""
    points: int = 256
    """Points of a frame that its pose is solved on; as many others judge."""
    steps: int = 30
    """ICP steps before the Newton steps, in each frame and each step of the fit."""
    iterations: int = 12
    """Most steps of a round; it ends by itself before, where the loss hardly falls any more."""
    rounds: int = 1
    """After each round but the last the logs are tracked anew with the body found so far: wrong sizes make wrong poses,
    which no step from there leaves. Say 3 where the body is far off, by a tenth and more; else it gains nothing."""
    noise: float = 0.035
    """How far a person's surface is from the body's cylinders (standard deviation, metres); smaller trusts the log more
    and the priors less. The default is what lengths of rendered people of known sizes ask for (experiments/fit)."""
    looseness: float = 1.0
    """Widens all priors by this factor; with folds, where logs left out judge, by four times as much."""
    stiffness: float = 20.0
    """How many times stiffer than in tracking the bands are while sizes are fitted: soft ones give way to a wrong
    length, so that the points hardly tell. 1 where bands or solve are free."""
    markers: bool = False
    """Named 3D points of the logs judge the fit and hold no pose; otherwise half of them do."""
