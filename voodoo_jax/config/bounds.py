"""Between which numbers of settings, bodies and changes lie: what is beyond cannot be computed with, or is no body."""

from collections.abc import Mapping

LARGEST = 1e6  # seconds, metres and weights: what float32 still computes with
LEAST = 1e-6  # of what must be above 0, a limb's sizes in metres among them
SIZES = 1e-3, 1e3  # metres, of a body as a whole: far beyond what depth sensors see


def check_bounds(options: object, bounds: Mapping[str, tuple[float, float]]) -> None:
    """Raises ValueError for an option of a command that is not between its least and greatest value."""
    for name, (low, high) in bounds.items():
        if not low <= (value := getattr(options, name)) <= high:
            raise ValueError(f"--{name.replace('_', '-')} {value}: must be from {low:g} to {high:g}")
