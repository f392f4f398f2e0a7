"""Converts logs of other formats temporarily."""

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from voodoo_jax.io.container import LogError, Place
from voodoo_jax.io.convert.errors import ConvertError
from voodoo_jax.io.convert.sources import convert, is_foreign


@contextmanager
def as_mcap(log: Place, types: Sequence[str] = ()) -> Iterator[tuple[Any, list[str]]]:
    """The log as MCAP, itself or a temporary copy, and notes of the conversion.

    **Arguments:** `types` as read.types. Raises LogError.
    """
    if not isinstance(log, str | os.PathLike) or not is_foreign(log):
        yield log, []
        return
    with tempfile.TemporaryDirectory(prefix="voodoo-") as folder:
        target = os.path.join(folder, f"{os.path.basename(os.path.abspath(log))}.mcap")
        try:
            notes = convert(log, target, types=types)
        except (ConvertError, OSError) as problem:
            raise LogError(str(problem)) from problem
        yield target, notes
