"""Logs of other formats, converted in passing."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from voodoo_jax.io.container import LogError
from voodoo_jax.io.convert.errors import ConvertError
from voodoo_jax.io.convert.sources import convert, is_foreign


@contextmanager
def as_mcap(log: str) -> Iterator[tuple[str, list[str]]]:
    """Path of a log as MCAP, itself or a copy that is removed at the end, and what the conversion left out.

    Raises LogError.
    """
    if not is_foreign(log):
        yield log, []
        return
    with tempfile.TemporaryDirectory(prefix="voodoo-") as folder:
        target = os.path.join(folder, f"{os.path.basename(log)}.mcap")
        try:
            notes = convert(log, target)
        except (ConvertError, OSError) as problem:
            raise LogError(str(problem)) from problem
        yield target, notes
