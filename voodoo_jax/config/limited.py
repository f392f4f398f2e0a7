"""Limits for one log: data beyond them is refused with a message, before memory or time is spent on it; and the numbers
between which settings, bodies and changes lie: what is beyond cannot be computed with, or is no body.

With the data kept between passes, they keep reading below 2 GB (docs/limits.md). They are thread-local, so decoders
need no argument for them.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar

from voodoo_jax.config.options import LimitSettings

__all__ = ["PLACE", "QUATERNION", "TIME", "limited", "limits", "too_large"]

# Nanoseconds, the year 2116: differences of two such times fit into 64 bits.
TIME = 1 << 62
# Metres: the earth's centre is 6.4e6 m away. Above, not even float64 has the hundredth of a micrometre.
PLACE = 1e8
# Lengths of quaternions that are taken for one of length 1 with rounding: drivers round to 3 digits at worst.
QUATERNION = 1e-3, 1e3
LARGEST = 1e6  # seconds, metres and weights: what float32 still computes with
LEAST = 1e-6  # of what must be above 0, a limb's sizes in metres among them
SIZES = 1e-3, 1e3  # metres, of a body as a whole: far beyond what depth sensors see
USUAL = LimitSettings()
_now: ContextVar[LimitSettings] = ContextVar("limits", default=USUAL)


def check_bounds(options: object, bounds: Mapping[str, tuple[float, float]]) -> None:
    """Raises ValueError for an option of a command that is not between its least and greatest value."""
    for name, (low, high) in bounds.items():
        if not low <= (value := getattr(options, name)) <= high:
            raise ValueError(f"--{name.replace('_', '-')} {value}: must be from {low:g} to {high:g}")


def limits() -> LimitSettings:
    """Those that hold here."""
    return _now.get()


@contextmanager
def limited(to: LimitSettings) -> Iterator[None]:
    """Other limits hold for what is read inside, in this thread."""
    before = _now.set(to)
    try:
        yield
    finally:
        _now.reset(before)


def too_large(what: str, size: int, limit: str, unit: str = "bytes") -> str:
    """The sentence's end for something that is larger than a limit, "" for what is not."""
    most = getattr(limits(), limit)
    return f"{what} {size} {unit}, more than the {most} that are allowed (--limits.{limit})" if size > most else ""
