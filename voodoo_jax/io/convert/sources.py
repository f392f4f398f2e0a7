"""The table of convertible formats and their converters; converts logs temporarily."""

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from voodoo_jax.config.limited import limited, limits
from voodoo_jax.config.options import LimitSettings
from voodoo_jax.io.container import LogError, Place
from voodoo_jax.io.convert.errors import LIBRARY, ConvertError
from voodoo_jax.records.notes import SENTENCE, as_few, plain
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.storage.guard import Refused, Room, guarded
from voodoo_jax.storage.troubles import NotReadable, check_file, opened_file

if TYPE_CHECKING:
    from voodoo_jax.storage.guarded import Answer

FASTEST, SLOWEST = 1e6, 1e-6  # files a second
# what files of each extension are; the module and function that convert one, and what it is given besides
FILES: dict[str, tuple[str, ...]] = {
    ".bag": ("ROS 1 bag", "ros_bags", "convert", "types"),
    ".db3": ("ROS 2 bag (SQLite)", "ros_bags", "convert", "types"),
    ".mkv": ("Azure Kinect or Femto", "kinect_video", "convert", "camera"),
    ".c3d": ("C3D", "markers", "convert_c3d"),
    ".trc": ("TRC", "markers", "convert_trc"),
    ".pcd": ("a point cloud", "clouds", "convert", "rate"),
    ".ply": ("a point cloud", "clouds", "convert", "rate"),
    ".json": ("skeletons of a Kinect, Nuitrack or ZED", "skeletons", "convert"),
    ".skeleton": ("NTU RGB+D", "skeletons", "convert"),
    ".csv": ("Motive, or columns NAME_x", "markers", "convert_table", "rate"),
}


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


def is_foreign(path: str | os.PathLike[str]) -> bool:
    """Whether a file, or the folder of an SQLite bag, can be converted automatically, by its extension; other folders
    must be named for conversion."""
    path = Path(path)
    return (path.suffix.lower() in FILES and path.is_file()) or (path.is_dir() and any(path.glob("*.db3")))


def convert(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    camera: str | os.PathLike[str] | None = None,
    rate: float = 0.0,
    types: Sequence[str] = (),
) -> list[str]:
    """Writes a recording of another format as an MCAP log; writes no file if this fails.

    **Arguments:** `source` a ROS 1 bag (.bag, also RealSense's), an SQLite bag of ROS 2 (.db3, or its folder), a
    recording of an Azure Kinect or Femto (.mkv), C3D, TRC, skeletons (.json of a Kinect, Nuitrack or ZED, .skeleton of
    NTU RGB+D), tables of points (.csv of Motive, or with columns NAME_x, NAME_y, NAME_z), a point cloud (.pcd, .ply),
    or a folder of these or of depth images; `camera` the images' camera file (see depth_images.py); `rate` files, or
    rows of a table, per second, if there are no times; `types` files with message definitions (.msg), for bags without
    them.

    A separate process reads it (storage/guard.py). **Returns:** notes on data left out or changed. Raises ConvertError,
    also instead of replacing a log that convert did not make, and OSError.
    """
    if not 0 <= rate <= FASTEST or 0 < rate < SLOWEST:
        raise ConvertError(
            f"--rate {rate}: must be from {SLOWEST:g} to {FASTEST:g} Hz, or 0: the files' names are times"
        )
    source, target = Path(source), Path(target)
    module, function, *more = _reader(source)
    given = {"camera": os.fspath(camera) if camera else None, "rate": rate, "types": list(map(os.fspath, types))}
    # a definition stands beside those that it uses
    folders = [os.path.dirname(os.path.realpath(place)) for place in types]
    readable = [*(os.path.realpath(place) for place in (source, camera) if place), *folders]
    _check_ours(target)
    most = limits()
    sizes = [entry.stat().st_size for entry in os.scandir(source)] if source.is_dir() else [source.stat().st_size]
    room = Room(most.memory, most.seconds * (1 + (sum(sizes) >> 30)), most.log_bytes + most.log_times * sum(sizes))
    task = [module, function, str(source), {name: given[name] for name in more}, asdict(most)]
    with replacing(target) as partial, open(partial, "wb") as stream:
        try:
            imports = [f"voodoo_jax.io.convert.{module}"]
            notes = guarded("voodoo_jax.io.convert.sources:converted", task, readable, room, stream.write, imports)
        except Refused as problem:
            text = str(problem) if f"'{source}" in str(problem) else f"'{source}' cannot be converted: {problem}"
            raise ConvertError(plain(text, SENTENCE)) from problem
    return list(as_few(notes))


# 6 parameters: those of the task, and where its answer goes
def converted(module: str, function: str, source: str, given: dict, allowed: dict, answer: "Answer") -> list[str]:
    """Converts a recording, within the confined process."""
    convert: Any = getattr(import_module(f"voodoo_jax.io.convert.{module}"), function)
    given = {name: Path(value) if value and name == "camera" else value for name, value in given.items()}
    try:
        with limited(LimitSettings(**allowed)):
            return convert(Path(source), answer, *given.values())
    except (ConvertError, OSError, MemoryError):
        raise
    except Exception as problem:  # each kind of file has its own
        raise ConvertError(f"unexpected {type(problem).__name__}: {problem}") from problem


def _check_ours(target: Path) -> None:
    """Raises ConvertError for a file that no conversion has made."""
    try:
        with opened_file(target) as stream:
            head = stream.read(len(LIBRARY) + 64)
    except FileNotFoundError:
        return
    except NotReadable as problem:
        raise ConvertError(f"'{target}' cannot be replaced: {problem}") from problem
    if head and LIBRARY.encode() not in head:
        raise ConvertError(f"'{target}' exists, and was not made by convert: name another --out")


def _reader(source: Path) -> tuple[str, ...]:
    """Module and function that convert it, and what they are given besides."""
    if not source.exists():
        raise ConvertError(f"there is no file or folder '{source}'")
    if source.is_dir():
        endings = {path.suffix.lower() for path in source.iterdir()}
        if ".db3" in endings:
            return "ros_bags", "convert", "types"
        if ".mcap" in endings:
            raise ConvertError(f"'{source}' has MCAP logs: give it to replay directly")
        if endings & {".pcd", ".ply"}:
            return "clouds", "convert", "rate"
        return "depth_images", "convert", "camera", "rate"
    try:
        check_file(source)
    except NotReadable as problem:
        raise ConvertError(f"'{source}' cannot be read: {problem}") from problem
    kind = source.suffix.lower()
    if kind not in FILES:
        known = ", ".join(f"{name} ({end})" for end, (name, *_) in FILES.items())
        known += ", folders of a ROS 2 bag, of depth images (PNG) or of point clouds (PCD, PLY)"
        raise ConvertError(f"'{source}': unsupported file; supported are {known}")
    return FILES[kind][1:]
