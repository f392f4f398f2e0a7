"""The limits that hold here: what is asked for beyond them is refused (see io/limits.py, docs/limits.md)."""

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
