"""report.html: replay.jsonl and the tracks of a folder, for a browser."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from urllib.parse import quote

from voodoo_jax.batch.extra_files import VIEW, exported_name
from voodoo_jax.batch.log_job import remove_partials
from voodoo_jax.batch.summary_file import rows_in
from voodoo_jax.exporters.formats import FORMATS
from voodoo_jax.exporters.npz import read_tracks_npz
from voodoo_jax.storage.urls import NPZ, TRACKS, delivered, fetched, is_url, joined, within
from voodoo_jax.viz.report_page import Row, person_cells, write_report_page

NAME = "report.html"


def write_report(folder: str, summary: str) -> str:
    """Writes the report of all logs with results in a folder (path or URL), and returns its path.

    `summary` names the replay.jsonl of this run; those of other parts of an array job are read besides, if the folder
    is no URL. Raises OSError.
    """
    names = [summary]
    if not is_url(folder):
        names += sorted(p.name for p in Path(folder).glob("replay*.jsonl") if p.name != summary)
    logs: dict[str, list[dict[str, Any]]] = {}
    for name in names:
        for log, rows in rows_in(joined(folder, name)).items():
            logs.setdefault(log, rows)
    logs = {log: rows for log, rows in logs.items() if os.path.dirname(log) not in logs}  # a bag and a file of it
    ordered = sorted(logs, key=lambda log: (os.path.basename(log), log))
    title = f"Tracks in {Path(folder).name if not is_url(folder) else folder}"
    if not is_url(folder):
        remove_partials(Path(folder) / NAME)
    with delivered(folder) as made:
        write_report_page((_row(logs[log], folder) for log in ordered), Path(made) / NAME, title)
    return joined(folder, NAME)


def _row(rows: list[dict[str, Any]], folder: str) -> Row:
    """One log, with the tracks of all its people."""
    main = rows[0]
    people, troubles = [], []
    for row in rows:
        if not row["tracks"]:
            continue
        try:
            if not within(row["tracks"], folder):  # whoever wrote that line does not say what is fetched
                raise ValueError(f"'{row['tracks']}' is not in the folder of this report")
            with fetched(row["tracks"]) as path:
                tracks = read_tracks_npz(path)
        except (ValueError, OSError) as problem:
            troubles.append(f"The tracks cannot be read: {problem}")
            continue
        people.append(person_cells(tracks, row["person"] if len(rows) > 1 else 0))
    error = " ".join([main["error"], *troubles]).strip()
    links = tuple(_links(main["tracks"], folder)) if people else ()
    return Row(os.path.basename(main["log"]), main["status"], error, links, tuple(people))


def _links(npz: str, folder: str) -> Iterable[tuple[str, str]]:
    """Links to the files of a log."""
    if not npz:
        return
    stem = npz.removesuffix(NPZ)
    names = {"3D view": stem + VIEW, "picture": f"{stem}.png", "Foxglove": stem + TRACKS, "tracks": npz}
    names |= {name: joined(os.path.dirname(npz), exported_name(npz, name)) for name in FORMATS}
    for word, place in names.items():
        if is_url(place):
            if word in ("Foxglove", "tracks"):  # what is there for certain
                yield word, place
        elif os.path.exists(place):
            yield word, quote(os.path.relpath(place, folder))
