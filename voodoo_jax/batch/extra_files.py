"""What is made of a log's tracks besides them: exports to other formats, a view in a browser."""

import re
from collections.abc import Sequence
from glob import escape
from pathlib import Path

from voodoo_jax.config.options import Settings
from voodoo_jax.exporters.formats import FORMATS, ExportError, export, gaps_note
from voodoo_jax.exporters.npz import read_tracks_npz
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.urls import NPZ

VIEW = ".html"


def exported_name(npz: str | Path, format: str) -> str:
    """Name of the file that tracks are exported to."""
    return Path(npz).name.removesuffix(NPZ) + FORMATS[format].suffix


def people_of(tracks: Tracks, npz: Path) -> list[tuple[Path, Tracks]]:
    """Tracks of a log and those of its other people, which lie beside them as `<log>.2.tracks.npz` and so on."""
    stem = npz.name.removesuffix(NPZ)
    others = [
        path
        for path in npz.parent.glob(f"{escape(stem)}.*{NPZ}")
        if re.fullmatch(r"\d+", path.name.removeprefix(f"{stem}.").removesuffix(NPZ))
    ]
    number = lambda path: int(path.name.removesuffix(NPZ).rsplit(".", 1)[1])  # noqa: E731
    return [(npz, tracks), *((path, read_tracks_npz(path)) for path in sorted(others, key=number))]


def write_exports(tracks: Tracks, npz: Path, formats: Sequence[str]) -> list[str]:
    """Exports the tracks of all people of a log, beside `npz`, the file of `tracks`.

    **Returns:** what a user should know: frames that are not tracked, and what could not be written and why.
    """
    notes = [gaps_note(tracks, formats)]
    for path, own in people_of(tracks, npz) if formats else []:
        for name in formats:
            try:
                export(own, path.parent / exported_name(path, name), name)
            except (ExportError, OSError) as problem:
                notes.append(f"No {exported_name(path, name)}: {problem}")
    return [note for note in notes if note]


def write_view(tracks: Tracks, npz: Path, settings: Settings, log: str) -> list[str]:
    """Writes `<log>.html` beside the tracks, reading the log once more; why that did not work, or nothing."""
    from voodoo_jax.io.log_reader import LogError, open_log
    from voodoo_jax.viz.html_view import write_html

    target = npz.with_name(npz.name.removesuffix(NPZ) + VIEW)
    try:
        write_html([own for _, own in people_of(tracks, npz)], open_log(log, settings.read).frames(), target)
    except (ValueError, OSError, LogError) as problem:
        return [f"No {target.name}: {problem}"]
    return []
