"""Which logs are meant; logs and results in object stores: URLs such as s3://bucket/a.mcap, through fsspec.

A log is read from a local copy: it is gone through two to three times and by its index at its end, and every byte is
needed once at least, so that random access over the network would fetch it twice.
"""

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from voodoo_jax.storage.atomic import made_folder
from voodoo_jax.storage.troubles import check_file, small_text

URL_HELP = 'pip install "voodoo_jax[urls]"'
NPZ = ".tracks.npz"  # and those of files with tracks
TRACKS = ".voodoo.mcap"  # how the names of MCAP files of tracks end
ENDINGS = (".mcap", ".mcap.zstd", ".mcap.zst")
SQLITE = ".db3"  # of ROS 2's bags before MCAP
# recordings of other formats that are converted in passing, by io/convert; .json and .csv are by name only, for there
# are others
FOREIGN = (".bag", SQLITE, ".mkv", ".c3d", ".trc", ".skeleton")
# whose files are what their addresses say: no archives, copies or other addresses within them
STORES = (
    "file", "local", "memory", "s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "adl", "http", "https", "hdfs",
    "webhdfs", "oss", "oci", "hf",
)  # fmt: skip
TOGETHER = "+"  # between files that are one recording


def is_url(place: str | os.PathLike[str]) -> bool:
    """Whether a place is a URL and not a path; file:// counts as one."""
    return "://" in os.fspath(place)


def file_system(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it. Raises ValueError with what to install."""
    protocol = url.split("://", 1)[0]
    if protocol not in STORES or "::" in url:
        raise ValueError(f"{url}: unsupported URL; supported are {', '.join(STORES)}")
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


def log_parts(place: str) -> list[str]:
    """The files of one recording: those of a bag's folder in order, those of a text such as a.mcap+b.mcap, or the place
    itself."""
    if is_url(place):
        return [place]
    if os.path.isdir(place):
        return _bag_files(place)
    several = place.split(TOGETHER)
    if len(several) > 1 and not os.path.exists(place) and all(os.path.isfile(part) for part in several):
        return several
    return [place]


def log_name(place: str) -> str:
    """The name of a recording without its ending; results have this name."""
    first = log_parts(place)[0] if TOGETHER in place else place
    name = first.replace("\\", "/").rstrip("/").rsplit("/", 1)[-1]
    for end in (".zstd", ".zst", ".mcap"):
        name = name.removesuffix(end)
    return name


def bag_of(path: str) -> tuple[str, list[str]]:
    """The folder that holds a file together with others of the same recording, and all these files; "" if none."""
    folder = os.path.dirname(os.path.abspath(path))
    files = _bag_files(folder)
    return (folder, files) if len(files) > 1 and os.path.abspath(path) in map(os.path.abspath, files) else ("", [])


def _bag_files(folder: str) -> list[str]:
    """Files of a rosbag2 recording in order, by metadata.yaml or else by name; files that are missing are left out.
    Empty if the folder is not a bag."""
    there: list[str] = []
    with suppress(OSError):  # none, or one that must not be looked into, which is said when it is read
        there = sorted(name for name in os.listdir(folder) if _is_log(name) or _is_foreign(name, SQLITE))
    metadata = os.path.join(folder, "metadata.yaml")
    if os.path.isfile(metadata):
        text = small_text(metadata, "replace")
        block = re.search(r"relative_file_paths:\s*(\[[^\]]*\]|(?:\s*-\s*[^\n]+\n?)+)", text)
        named = (
            re.findall(r"[^\s,\[\]\"']+(?: [^\s,\[\]\"']+)*", re.sub(r"(?m)^\s*-\s*", "", block[1])) if block else []
        )
        known = [os.path.basename(name) for name in named]
        found = [f for name in known for f in (name, name + ".zstd", name.removesuffix(".zstd")) if f in there]
        return [os.path.join(folder, name) for name in dict.fromkeys(found)]
    # a recorder that was stopped hard writes no metadata: NAME/NAME_0.mcap, NAME/NAME_1.mcap, ...
    stem, number = os.path.basename(os.path.abspath(folder)), {}
    for name in there:
        if match := re.fullmatch(re.escape(stem) + r"_(\d+)\.(mcap(\.zstd)?|db3)", name):
            number[int(match[1])] = name
    whole = len(number) == len(there) and sorted(number) == list(range(len(number)))
    return [os.path.join(folder, number[k]) for k in sorted(number)] if whole else []


def _is_log(name: str) -> bool:
    return name.endswith(ENDINGS) and not name.endswith(TRACKS) and not name.startswith(".")


def _is_foreign(name: str, endings: str | tuple[str, ...] = FOREIGN) -> bool:
    return name.lower().endswith(endings) and not name.startswith(".")


def _foreign_in(folder: str, names: list[str]) -> list[str]:
    """Recordings of other formats among the files of a folder, without exports of tracks."""
    there = {name.removesuffix(NPZ) for name in names if name.endswith(NPZ)}
    return [
        os.path.join(folder, name) for name in names if _is_foreign(name) and os.path.splitext(name)[0] not in there
    ]


def _inside(folder: str, above: frozenset[str] = frozenset()) -> list[str]:
    """All recordings in a folder and its subfolders: bags of several files by their folder, else files. A folder
    without permission stands for itself: the error is raised when it is read."""
    own = os.path.realpath(folder)
    if own in above:  # a link that leads back up
        return []
    try:
        if len(_bag_files(folder)) > 1:
            return [folder]
        names = os.listdir(folder)
    except OSError:
        return [folder]
    found = [os.path.join(folder, name) for name in names]
    below = [log for path in found if os.path.isdir(path) for log in _inside(path, above | {own})]
    logs = [path for path in found if _is_log(os.path.basename(path))] + _foreign_in(folder, names)
    return [path for path in logs if os.path.isfile(path)] + below


def expanded(place: str | os.PathLike[str]) -> list[str]:
    """The place as text; for a folder the logs in it and in the folders below, in order of their names, but for tracks
    that were written there (a bag of several files is one log: its folder); for a URL with *, ? or [ all that it
    matches. Raises ValueError if there are none."""
    place = os.fspath(place)
    if os.path.isdir(place):
        if logs := sorted(_inside(place)):
            return logs
        raise ValueError(
            f"'{place}' is a folder without logs ({', '.join((*ENDINGS[:1], *FOREIGN))}): name the logs, or "
            "the folder they are in; folders of images, or of point clouds, become logs by voodoo-jax convert"
        )
    if len(several := log_parts(place)) > 1:
        return [TOGETHER.join(os.path.abspath(part) for part in several)]
    if not is_url(place) or not any(mark in place for mark in "*?["):
        return [place]
    system, path = file_system(place)
    try:
        found = sorted(system.glob(path))
    except Exception as problem:  # every store has its own errors
        raise ValueError(f"{place}: cannot be listed: {type(problem).__name__}: {problem}") from problem
    if not found:
        raise ValueError(f"{place}: no log matches; check the names in the store, and your access to it")
    return [system.unstrip_protocol(name) for name in found]


def person_place(npz: str, person: int) -> str:
    """Path of the tracks of another person of a log; `npz`: path of the main person's, `<log>.tracks.npz`."""
    return npz if person == 1 else f"{npz.removesuffix(NPZ)}.{person}{NPZ}"


def removed(place: str) -> None:
    """Removes a file if it exists. Raises OSError."""
    if not is_url(place):
        Path(place).unlink(missing_ok=True)
        return
    system, path = file_system(place)
    if system.exists(path):
        system.rm_file(path)


def joined(folder: str, name: str) -> str:
    """A file in a folder, each a path or a URL; the folder if the name is empty."""
    return f"{folder.rstrip('/')}/{name}".rstrip("/") if is_url(folder) else str(Path(folder) / name)


def within(place: str, folder: str) -> bool:
    """Whether a file is in a folder or its subfolders, each a path or a URL; links are resolved."""
    if is_url(folder) or is_url(place):
        return place.startswith(folder.rstrip("/") + "/") and ".." not in place.split("/")
    real = os.path.realpath(folder)
    return os.path.commonpath([os.path.realpath(place), real]) == real


def byte_size(place: str) -> int:
    """Size of a file in bytes; 0 if it does not exist."""
    try:
        if not is_url(place):
            return sum(os.stat(part).st_size for part in log_parts(place))
        system, path = file_system(place)
        return int(system.size(path) or 0)
    except Exception:  # what is wrong with it is said when it is read
        return 0


@contextmanager
def opened(place: str) -> Iterator[Any]:
    """Opens a file of any store for reading at any position. Raises OSError."""
    if not is_url(place):
        check_file(place)
        with open(place, "rb") as stream:
            yield stream
        return
    system, path = file_system(place)
    with system.open(path, "rb") as stream:
        yield stream


@contextmanager
def fetched(place: str) -> Iterator[str]:
    """A local path of a file: its own, or that of a copy, which is removed at the end. Raises OSError, ValueError."""
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
    """A local folder for results, created if it is missing; for a URL its files are uploaded at the end, in the order
    of writing. Raises OSError, ValueError."""
    if not is_url(folder):
        yield made_folder(folder)
        return
    system, path = file_system(folder)
    with tempfile.TemporaryDirectory(prefix="voodoo-") as made:
        yield Path(made)
        system.makedirs(path, exist_ok=True)
        for file in sorted(Path(made).iterdir(), key=lambda file: file.stat().st_mtime_ns):
            system.put_file(str(file), f"{path.rstrip('/')}/{file.name}")
