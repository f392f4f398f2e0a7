"""Export formats of tracks: each is a module with a function `write(tracks, path)`, and a line here."""

import os
from collections.abc import Iterable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from voodoo_jax.config.output_style import Style
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.troubles import check_text


class Format(NamedTuple):
    """A format: its file endings, the module and function that write it, and its treatment of gaps."""

    suffix: str  # replaces .tracks.npz
    module: str
    gaps: str  # what is in the file where nothing is tracked
    function: str = "write"
    other_suffixes: tuple[str, ...] = ()
    package: str = ""  # module that has to be installed
    extra: str = ""  # by which this package installs it
    bones: bool = False  # it holds a skeleton, which a Style names


HELD = "repeat the last pose"
FORMATS = {
    "csv": Format(".csv", "table", "are marked as not tracked"),
    "trc": Format(".trc", "trc", "have NaN"),
    "c3d": Format(".c3d", "c3d", "have points with the residual -1", package="ezc3d", extra="c3d"),
    "bvh": Format(".bvh", "bvh", HELD, bones=True),
    "bvh-rigid": Format(".rigid.bvh", "bvh", HELD, function="write_rigid", bones=True),
    "mot": Format(".mot", "mot", "are left out"),
    "gltf": Format(".glb", "gltf", HELD, other_suffixes=(".gltf",), bones=True),
    "usd": Format(".usd", "usd", HELD, other_suffixes=(".usda", ".usdc"), package="pxr", extra="usd", bones=True),
}


class ExportError(ValueError):
    """A format that does not exist or whose package is missing."""


def check_formats(names: Iterable[str]) -> tuple[str, ...]:
    """The names of formats without duplicates; "csv,trc" is two. Raises ExportError with what to do."""
    found = dict.fromkeys(part.strip().lower() for name in names for part in name.split(",") if part.strip())
    for name in found:
        if name not in FORMATS:
            raise ExportError(f"no format '{name}' to export to; there are {', '.join(FORMATS)}")
        how = FORMATS[name]
        if how.package and find_spec(how.package) is None:
            raise ExportError(f'{name} files need another package: pip install "voodoo_jax[{how.extra}]"')
    return tuple(found)


def format_of(path: str | os.PathLike[str]) -> str:
    """The format of a path, by its ending. Raises ExportError."""
    name = Path(path).name.lower()
    ends = {end: key for key, how in FORMATS.items() for end in (how.suffix, *how.other_suffixes)}
    for end in sorted(ends, key=len, reverse=True):
        if name.endswith(end):
            return ends[end]
    raise ExportError(f"'{path}': unknown format. Names end in {', '.join(ends)}")


def export(tracks: Tracks, path: str | os.PathLike[str], format: str = "", style: Style | None = None) -> Path:
    """Writes tracks as a file for other programs, and returns its path.

    **Arguments:** `path` by whose ending the format is chosen: .csv, .trc, .c3d, .bvh, .mot, .glb or .gltf, .usd or
    .usda; `format` another one of exporters.formats.FORMATS; `style` names of joints and bones, and the bind pose. What
    each format holds is in docs/results.md.

    Raises ExportError (a ValueError) for an unknown format, a missing package or tracks without frames; OSError.
    """
    if not len(tracks.time_ns):
        raise ExportError(f"nothing to export: the tracks of {tracks.source} have no frame")
    (name,) = check_formats([format or format_of(path)])
    try:
        check_text(path, name)
    except ValueError as problem:
        raise ExportError(str(problem)) from problem
    how = FORMATS[name]
    tracks, bones = tracks.with_names(style.names) if style else tracks, (style,) if how.bones else ()
    getattr(import_module(f"voodoo_jax.exporters.{how.module}"), how.function)(tracks, path, *bones)
    return Path(path)


def gaps_note(tracks: Tracks, names: Iterable[str]) -> str:
    """A sentence on untracked frames in files of these formats, or nothing."""
    missing, held = int((~tracks.tracked).sum()), [name for name in names if FORMATS[name].gaps == HELD]
    if not missing or not held:
        return ""
    return f"{missing} of {len(tracks.time_ns)} frames are not tracked: in {', '.join(held)} they {HELD}."
