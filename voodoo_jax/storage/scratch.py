"""Temporary files for what is too much for memory: on a disk, where the user keeps caches.

Where the system keeps temporary files may be memory itself (a RAM disk), which would gain nothing.
"""

import os
import tempfile
from collections.abc import Iterator
from typing import IO

import platformdirs

NAMED = ("TMPDIR", "TEMP", "TMP")  # by which users say where temporary files go; Python's tempfile


def _folders() -> Iterator[str | None]:
    """Where they may be, best first; None: where the system keeps temporary files."""
    if not any(os.environ.get(name) for name in NAMED):
        try:
            folder = platformdirs.user_cache_path("voodoo_jax", appauthor=False)
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            yield str(folder)
        except (OSError, RuntimeError):  # read-only; no HOME, and a user whom the system does not know
            pass
    yield None


def scratch_file() -> IO[bytes]:
    """An open file without a name, which goes when it is closed. Raises OSError where none can be made."""
    *first, last = _folders()
    for folder in first:
        try:
            return tempfile.TemporaryFile(dir=folder)
        except OSError:
            continue
    return tempfile.TemporaryFile(dir=last)


def scratch_named(suffix: str) -> tuple[int, str]:
    """A new file of this user alone: its descriptor and its path; who asks removes it. Raises OSError."""
    *first, last = _folders()
    for folder in first:
        try:
            return tempfile.mkstemp(prefix="voodoo-", suffix=suffix, dir=folder)
        except OSError:
            continue
    return tempfile.mkstemp(prefix="voodoo-", suffix=suffix, dir=last)
