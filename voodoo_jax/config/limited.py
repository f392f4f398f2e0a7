"""The limits in force; inputs beyond them are refused (see io/limits.py, docs/limits.md)."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from voodoo_jax.config.options import LimitSettings

USUAL = LimitSettings()
_now: ContextVar[LimitSettings] = ContextVar("limits", default=USUAL)


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
