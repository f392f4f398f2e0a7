"""Files that appear under their name only when they are complete."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: str | os.PathLike[str], ending: str = "") -> Iterator[Path]:
    """Gives a temporary path in the same folder; it becomes `path` at the end, or is removed if anything was raised.

    `ending` is how the temporary name ends, for libraries that tell formats by it.
    """
    target = Path(path)
    # with the process id: two runs that write the same file do not write into each other's
    partial = target.with_name(f".{target.name}.{os.getpid()}.tmp{ending}")
    try:
        yield partial
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)
