"""Options of a search for settings of the flexible tracker. No JAX here: the command line shows them at once."""

from dataclasses import dataclass

from voodoo_jax.config.bounds import check_bounds

# least and most of each number: a distribution needs some candidates, and a judgement some seeds
BOUNDS: dict[str, tuple[float, float]] = {
    "evaluations": (8, 100_000),
    "seeds": (1, 100),
    "judging_seeds": (1, 100),
    "spread": (1e-3, 3.0),
}
# what may change without a new program; numbers that are 0 are switched off and stay so
SHARES = ("velocity", "depth_share", "hidden_edge", "hidden_surface", "unseen", "follow_level", "follow_up")
NOISE = ("depth_share", "depth_noise", "base_noise", "spread_noise", "motion_noise")
WEIGHTS = ("edge_weight", "surface_weight", "depth_weight", "points_weight", "skin_weight", "hidden_edge",
           "hidden_surface", "unseen")  # fmt: skip
MOTION = ("velocity", "follow_level", "follow_up", "gravity", "mass_base", "mass_variable", "mass_falloff")
GROUPS: dict[str, tuple[str, ...]] = {"noise": NOISE, "weights": WEIGHTS, "motion": MOTION}


@dataclass(frozen=True)
class TuneSettings:
    """What is searched for, and how long."""

    free: tuple[str, ...] = ("noise", "weights")
    """What may change: noise, weights, motion (how much goes on, follows the head, hangs and weighs), or names of
    single settings such as points_weight. What is 0 is switched off and stays so."""
    evaluations: int = 200
    """How many settings are tried; each takes a run through half of the logs for each seed."""
    seeds: int = 2
    """Random numbers with which each is tried: others in each generation, so that none is fitted to."""
    judging_seeds: int = 5
    """Random numbers with which what was found is judged on the logs held back."""
    spread: float = 0.3
    """How widely it begins to look: standard deviation of the logarithm of each number."""


def check_tune(options: TuneSettings) -> None:
    """Raises ValueError for a number with which nothing can be searched for."""
    check_bounds(options, BOUNDS)
