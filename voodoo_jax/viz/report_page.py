"""The report of a folder of results as one self-contained HTML file: a row for each log."""

import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from voodoo_jax._version import __version__
from voodoo_jax.exporters.frames import seconds
from voodoo_jax.model.body import segment_lengths
from voodoo_jax.records.markup import Html, all_of, filled
from voodoo_jax.records.notes import is_remark
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.viz.sketch import strip, time_line, untracked
from voodoo_jax.viz.template import page, template

MOST_STRETCHES = 4  # of time that are named; of more their number


@dataclass(frozen=True)
class Row:
    """A log's entry in the report. Links are relative to the report."""

    name: str
    status: str  # tracked, nothing tracked, failed
    error: str = ""
    links: tuple[tuple[str, str], ...] = ()  # word and address
    people: tuple[Html, ...] = field(default=())  # what person_cells makes of the tracks of each


def person_cells(tracks: Tracks, number: int = 0) -> Html:
    """The cells of one person: drawings, results, doubts; `number`: among several, 0: alone."""
    who = filled("<b>person @N@</b>", N=number) if number else ""
    drawn = Html(strip(tracks) or '<p class="none">no pose</p>')
    found = all_of(filled("<tr><th>@NAME@</th><td>@VALUE@</td></tr>", NAME=n, VALUE=v) for n, v in _found(tracks))
    doubts = all_of(filled("<li>@TEXT@</li>", TEXT=text) for text in _doubts(tracks))
    return filled(
        '<td class="seen">@WHO@@DRAWN@@LINE@</td><td><table class="found">@FOUND@</table></td>'
        "<td><ul>@DOUBTS@</ul></td>",
        WHO=who, DRAWN=drawn, LINE=Html(time_line(tracks)), FOUND=found, DOUBTS=doubts,
    )  # fmt: skip


def write_report_page(rows: Iterable[Row], path: str | os.PathLike[str], title: str) -> Path:
    """Writes the report of these logs and returns its path. Raises OSError."""
    rows = list(rows)
    counts = {word: sum(row.status == word for row in rows) for word in ("tracked", "nothing tracked", "failed")}
    about = ", ".join(f"{count} {word}" for word, count in counts.items() if count) or "no log"
    about = f"{len(rows)} logs: {about}; voodoo_jax {__version__}"
    body = filled(template("report.html"), TITLE=title, ABOUT=about, ROWS=all_of(map(_row, rows)))
    text = page("report", title, body)
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return Path(path)


def _row(row: Row) -> Html:
    links = [filled('<a href="@TO@">@WORD@</a>', TO=address, WORD=word) for word, address in row.links]
    error = filled('<p class="error">@TEXT@</p>', TEXT=row.error) if row.error else ""
    state = row.status.split()[0]
    first, *others = row.people or (Html('<td colspan="3" class="none">no tracks</td>'),)
    return filled(
        '<tbody class="@STATE@"><tr><td class="log" rowspan="@COUNT@"><b>@NAME@</b><span class="state @STATE@">@STATUS@'
        "</span><p>@LINKS@</p>@TOLD@</td>@FIRST@</tr>@OTHERS@</tbody>\n",
        STATE=state, COUNT=max(1, len(row.people)), NAME=row.name, STATUS=row.status, LINKS=Html(" ".join(links)),
        TOLD=error, FIRST=first, OTHERS=all_of(filled("<tr>@CELLS@</tr>", CELLS=cells) for cells in others),
    )  # fmt: skip


def _found(tracks: Tracks) -> list[tuple[str, str]]:
    """Names and values of the results."""
    time, body = seconds(tracks), tracks.body
    residual = tracks.evidence.residual
    known = residual[np.isfinite(residual)]
    length = float(time[-1]) if len(time) else 0.0
    found = [
        ("frames", f"{len(time)} in {length:.1f} s"),
        ("tracked", f"{100 * float(tracks.tracked.mean()) if len(time) else 0:.1f} %"),
        ("body", body.name),
        (body.scale_name, f"{float(body.scale):.3f} m"),
    ]
    found += [(name.replace("_", " "), f"{100 * value:.1f} cm") for name, value in segment_lengths(body).items()]
    if len(known):
        found.append(("residual", f"{1000 * float(known.mean()):.0f} mm"))
    sure = tracks.confidence[tracks.tracked]
    sure = sure[np.isfinite(sure)]
    if len(sure):
        found.append(("joints within 10 cm", f"{100 * float(sure.mean()):.0f} % expected"))
    return found


def _doubts(tracks: Tracks) -> list[str]:
    """Points to check: times without a pose, and the tracker's notes that ask for something."""
    doubts = []
    if gaps := untracked(tracks):
        named = [f"{a:.1f} s" if b - a < 0.05 else f"{a:.1f} to {b:.1f} s" for a, b in gaps[:MOST_STRETCHES]]
        more = f" and {len(gaps) - MOST_STRETCHES} more" if len(gaps) > MOST_STRETCHES else ""
        doubts.append(f"not tracked: {', '.join(named)}{more}")
    return [*doubts, *(note for note in tracks.notes if not is_remark(note))]
