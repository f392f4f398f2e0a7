"""Temporary storage on disk for points and features of long logs: the user's cache folder, never a RAM disk."""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, TypeVar

T = TypeVar("T")
VARIABLE = "VOODOO_JAX_SCRATCH"  # names another folder; processes that this one starts have it, too
IN_MEMORY = ("tmpfs", "ramfs", "devtmpfs", "hugetlbfs")  # file systems of Linux


def nameless_file() -> IO[bytes]:
    """Opens a file without a name, which disappears when it is closed or this process ends. Creates missing folders,
    tries several in turn, and skips RAM disks. Raises OSError without a suitable disk."""
    return _first(lambda folder: tempfile.TemporaryFile(dir=folder))


def named_file(suffix: str) -> tuple[int, str]:
    """A new file of this user alone in one of the same folders: its descriptor and its path; the caller removes it."""
    return _first(lambda folder: tempfile.mkstemp(prefix="voodoo-", suffix=suffix, dir=folder))


def _first(made: Callable[[str], T]) -> T:
    trouble: OSError = FileNotFoundError("no folder on a disk for data that does not fit into memory")
    for folder in _folders():
        try:
            Path(folder).mkdir(mode=0o700, parents=True, exist_ok=True)
            if not in_memory(folder):
                return made(folder)
        except OSError as problem:
            trouble = problem
    raise trouble


def _folders() -> Iterator[str]:
    if asked := os.environ.get(VARIABLE, ""):
        yield os.path.expanduser(asked)
        return
    import platformdirs

    with suppress(RuntimeError):  # no HOME, and a user whom the system does not know, as in containers
        yield str(platformdirs.user_cache_path("voodoo_jax", appauthor=False) / "scratch")
    with suppress(OSError):
        yield tempfile.gettempdir()
    if os.name == "posix":
        yield "/var/tmp"  # where files outlive a restart, by the Filesystem Hierarchy Standard


def in_memory(folder: str) -> bool:
    """Whether a folder is on a RAM disk, as /tmp may be; False if unknown."""
    kinds: dict[str, str] = {}
    with suppress(OSError, IndexError, UnicodeDecodeError):
        for line in Path("/proc/self/mounts").read_text().splitlines():  # later lines lie over earlier ones
            words = line.split(" ")
            kinds[words[1].replace("\\040", " ")] = words[2]
    place = Path(os.path.realpath(folder))
    return next((kinds[str(at)] in IN_MEMORY for at in (place, *place.parents) if str(at) in kinds), False)
