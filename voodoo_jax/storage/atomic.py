"""Files that appear under their name only when they are complete, and folders for them."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from voodoo_jax.storage.troubles import WHILE_WRITING, not_written


@contextmanager
def replacing(path: str | os.PathLike[str], ending: str = "") -> Iterator[Path]:
    """Yields a temporary path in the same folder; it becomes `path` at the end, or is removed after an exception.
    `ending` is the suffix of the temporary name, for libraries that choose a format by it. Raises NotWritten if the
    system refuses to write it.
    """
    target = Path(path)
    partial = _partial(target, ending)
    try:
        made_new(partial)
        yield partial
        moved(partial, target)
    except OSError as problem:
        ours = problem.filename == str(partial) or problem.filename is None and problem.errno in WHILE_WRITING
        if ours:
            raise not_written(problem, target) from problem
        raise
    finally:
        with suppress(OSError):  # a disk that cannot be written any more
            partial.unlink(missing_ok=True)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raises NotWritten if `replacing` could not write a file of this name, as far as this can be known before there is
    any content."""
    target = Path(path)
    try:
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        partial = _partial(target)
        made_new(partial)
        partial.unlink(missing_ok=True)
    except OSError as problem:
        raise not_written(problem, target) from problem


def made_folder(path: str | os.PathLike[str]) -> Path:
    """The folder, made if it is missing. Raises NotWritten."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise not_written(problem, path) from problem
    return Path(path)


def begun(path: str | os.PathLike[str]) -> Path:
    """A temporary path in the same folder, with an empty file, for callers that move it to `path` by `moved`. Raises
    NotWritten."""
    partial = _partial(Path(path))
    try:
        made_new(partial)
    except OSError as problem:
        raise not_written(problem, path) from problem
    return partial


def moved(partial: Path, target: Path) -> None:
    """Moves a complete file to its place; replaces a file or link of this name, and nothing else. Raises OSError."""
    if target.exists() and not target.is_file() and not target.is_dir():  # a pipe or a device
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(partial))
    os.replace(partial, target)


def made_new(partial: Path) -> None:
    """Creates an empty file and replaces an old one; a link there is not followed."""
    partial.unlink(missing_ok=True)
    open(partial, "xb").close()


def _partial(target: Path, ending: str = "") -> Path:
    # with the process id: two runs that write the same file do not write into each other's
    return target.with_name(f".{target.name}.{os.getpid()}.tmp{ending}")
