"""Files made from a log's tracks: exports to other formats, a view in a browser."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from voodoo_jax.config.options import Settings
from voodoo_jax.config.output_style import Style
from voodoo_jax.exporters.formats import FORMATS, export, gaps_note
from voodoo_jax.records.notes import SENTENCE, plain
from voodoo_jax.records.tracks import Tracks, given_from
from voodoo_jax.storage.urls import NPZ, person_place

VIEW = ".html"
MOST = 9  # people beside the main one of whom a killed run's files are looked for


def exported_name(npz: str | Path, format: str) -> str:
    """Name of an exported file of tracks."""
    return Path(npz).name.removesuffix(NPZ) + FORMATS[format].suffix


def extra_files(npz: Path, formats: Sequence[str]) -> list[Path]:
    """Files beside the tracks of a log, also those of its other people."""
    people = [npz, *(Path(person_place(str(npz), person)) for person in range(2, 2 + MOST))]
    exported = [path.with_name(exported_name(path, name)) for path in people for name in formats]
    return [npz.with_name(npz.name.removesuffix(NPZ) + VIEW), *people[1:], *exported]


def write_exports(people: Sequence[Tracks], npz: Path, formats: Sequence[str], style: Style) -> list[str]:
    """Exports the tracks of all people of a log, beside `npz`, the main person's file.

    **Returns:** what a user should know: frames that are not tracked, and what could not be written and why.
    """
    notes = [note] if (note := gaps_note(people[0], formats)) else []
    for own in people:
        path = Path(person_place(str(npz), own.person))
        for name in formats:
            target = path.parent / exported_name(path, name)
            notes += attempted(target.name, lambda own=own, target=target, name=name: export(own, target, name, style))
    return notes


def write_view(people: Sequence[Tracks], npz: Path, settings: Settings, log: str) -> list[str]:
    """Writes `<log>.html` beside the tracks, which reads the log once more. Returns why that failed, or nothing."""
    from voodoo_jax.io.log_reader import open_log
    from voodoo_jax.viz.html_view import write_html

    target = npz.with_name(npz.name.removesuffix(NPZ) + VIEW)

    def write() -> None:
        reader = open_log(log, replace(settings.read, images=True))
        write_html([given_from(one, -reader.origin) for one in people], reader.frames(), target)

    return attempted(target.name, write)


def attempted(what: str, make: Callable[[], object]) -> list[str]:
    """Makes a file from tracks that exist already. Returns why that failed, as a sentence, or nothing."""
    from voodoo_jax.io.container import LogError

    try:
        make()
    except Exception as problem:
        known = isinstance(problem, (ValueError, OSError, LogError))
        text = str(problem) if known else f"unexpected {type(problem).__name__}: {problem}"
        return [f"No {what}: {plain(text, SENTENCE)}"]
    return []
