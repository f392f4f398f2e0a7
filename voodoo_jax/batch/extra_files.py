"""What is made of a log's tracks besides them: exports to other formats."""

import re
from collections.abc import Sequence
from glob import escape
from pathlib import Path

from voodoo_jax.exporters.formats import FORMATS, ExportError, export, gaps_note
from voodoo_jax.exporters.npz import read_tracks_npz
from voodoo_jax.records.tracks import Tracks

TRACKS_NPZ = ".tracks.npz"


def exported_name(npz: str | Path, format: str) -> str:
    """Name of the file that tracks are exported to."""
    return Path(npz).name.removesuffix(TRACKS_NPZ) + FORMATS[format].suffix


def write_exports(tracks: Tracks, npz: Path, formats: Sequence[str]) -> list[str]:
    """Exports tracks and those of the other people of the log, which lie beside them as `<log>.2.tracks.npz` and so on.

    **Arguments:** `npz` the tracks' own file; the exports lie beside it.

    **Returns:** what a user should know: frames that are not tracked, and what could not be written and why.
    """
    notes = [gaps_note(tracks, formats)] if formats else []
    stem = npz.name.removesuffix(TRACKS_NPZ)
    others = [
        path
        for path in sorted(npz.parent.glob(f"{escape(stem)}.*{TRACKS_NPZ}"))
        if re.fullmatch(r"\d+", path.name.removeprefix(f"{stem}.").removesuffix(TRACKS_NPZ))
    ]
    for path in [npz, *others] if formats else []:
        own = tracks if path == npz else read_tracks_npz(path)
        for name in formats:
            try:
                export(own, path.parent / exported_name(path, name), name)
            except (ExportError, OSError) as problem:
                notes.append(f"No {exported_name(path, name)}: {problem}")
    return [note for note in notes if note]
