"""Which logs are meant; logs and results in object stores: URLs such as s3://bucket/a.mcap, through fsspec.

A log is read from a local copy: it is gone through two to three times and by its index at its end, and every byte is
needed once at least, so that random access over the network would fetch it twice.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

URL_HELP = 'pip install "voodoo_jax[urls]"'
NPZ = ".tracks.npz"  # and those of files with tracks
TRACKS = ".voodoo.mcap"  # how the names of MCAP files of tracks end


def is_url(place: str | os.PathLike[str]) -> bool:
    """Whether a place is a URL and not a path; file:// counts as one."""
    return "://" in os.fspath(place)


def file_system(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it. Raises ValueError with what to install."""
    protocol = url.split("://", 1)[0]
    try:
        import fsspec
    except ImportError as problem:
        raise ValueError(f"{url}: URLs need the package fsspec: {URL_HELP}") from problem
    try:
        return fsspec.core.url_to_fs(url)
    except ImportError as problem:
        raise ValueError(f"{url}: {protocol}:// needs another package for fsspec: {problem}") from problem
    except ValueError as problem:
        raise ValueError(f"{url}: fsspec cannot use it: {problem}") from problem


def expanded(place: str | os.PathLike[str]) -> list[str]:
    """The place as text; for a folder the logs in it and in the folders below, in order of their names, but for tracks
    that were written there; for a URL with *, ? or [ all that it matches. Raises ValueError if there are none."""
    place = os.fspath(place)
    if os.path.isdir(place):
        inside = sorted(str(path) for path in Path(place).rglob("*.mcap") if path.is_file())
        if logs := [path for path in inside if not path.endswith(TRACKS) and not Path(path).name.startswith(".")]:
            return logs
        raise ValueError(f"'{place}' is a folder without any .mcap log in it; name the logs, or the folder they are in")
    if not is_url(place) or not any(mark in place for mark in "*?["):
        return [place]
    system, path = file_system(place)
    try:
        found = sorted(system.glob(path))
    except Exception as problem:  # every store has its own errors
        raise ValueError(f"{place}: cannot be listed: {type(problem).__name__}: {problem}") from problem
    if not found:
        raise ValueError(f"{place}: no log matches; look at the names in the store, or at your access to it")
    return [system.unstrip_protocol(name) for name in found]


def person_place(npz: str, person: int) -> str:
    """Where the tracks of another person of a log are; `npz`: those of the main one, `<log>.tracks.npz`."""
    return npz if person == 1 else f"{npz.removesuffix(NPZ)}.{person}{NPZ}"


def removed(place: str) -> None:
    """Removes a file, if it is there. Raises OSError."""
    if not is_url(place):
        Path(place).unlink(missing_ok=True)
        return
    system, path = file_system(place)
    if system.exists(path):
        system.rm_file(path)


def joined(folder: str, name: str) -> str:
    """A file in a folder, either of them a path or a URL; the folder if the name is empty."""
    return f"{folder.rstrip('/')}/{name}".rstrip("/") if is_url(folder) else str(Path(folder) / name)


def byte_size(place: str) -> int:
    """Bytes of a file; 0 if it is not there."""
    try:
        if not is_url(place):
            return os.stat(place).st_size
        system, path = file_system(place)
        return int(system.size(path) or 0)
    except Exception:  # what is wrong with it is said when it is read
        return 0


@runtime_checkable
class Readable(Protocol):
    """An open file of any store."""

    def read(self, size: int = -1, /) -> bytes: ...
    def seek(self, offset: int, whence: int = 0, /) -> int: ...


@contextmanager
def opened(place: str) -> Iterator[Any]:
    """A file opened for reading at any place of it: a Readable. Raises OSError."""
    if not is_url(place):
        with open(place, "rb") as stream:
            yield stream
        return
    system, path = file_system(place)
    with system.open(path, "rb") as stream:
        yield stream


@contextmanager
def fetched(place: str) -> Iterator[str]:
    """A local path of a file: its own, or that of a copy that is removed at the end. Raises OSError, ValueError."""
    if not is_url(place):
        yield place
        return
    system, path = file_system(place)
    with tempfile.TemporaryDirectory(prefix="voodoo-") as folder:
        local = os.path.join(folder, path.rstrip("/").rsplit("/", 1)[-1])
        system.get_file(path, local)
        yield local


@contextmanager
def delivered(folder: str) -> Iterator[Path]:
    """A local folder for results, made if it is missing; for a URL what was written there is sent at the end, in the
    order of writing. Raises OSError, ValueError."""
    if not is_url(folder):
        Path(folder).mkdir(parents=True, exist_ok=True)
        yield Path(folder)
        return
    system, path = file_system(folder)
    with tempfile.TemporaryDirectory(prefix="voodoo-") as made:
        yield Path(made)
        system.makedirs(path, exist_ok=True)
        for file in sorted(Path(made).iterdir(), key=lambda file: file.stat().st_mtime_ns):
            system.put_file(str(file), f"{path.rstrip('/')}/{file.name}")
