"""Self-contained HTML files: the report of a folder of results, with a row for each log, and that of a fit with its
text and tables, both bodies and the figure."""

import os
import re
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import numpy as np

from voodoo_jax._version import __version__
from voodoo_jax.exporters.frames import seconds
from voodoo_jax.model.body import Body, segment_lengths
from voodoo_jax.records.notes import Html, all_of, filled
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.viz.sketch import compared, strip, time_line, untracked

MOST_STRETCHES = 4  # of time that are named; of more their number


def write_fit_page(
    report: str, bodies: Sequence[tuple[Body, Body]], figure: bytes, path: str | os.PathLike[str]
) -> Path:
    """Writes the page and returns its path.

    **Arguments:** `report` Markdown of headings, paragraphs and tables; `bodies` of each person before the fit and
    after it; `figure` a PNG.

    Raises OSError.
    """
    title, _, rest = report.partition("\n")
    drawings = all_of(
        filled("@HEAD@@BODIES@", HEAD=filled("<h3>person @K@</h3>", K=k) if len(bodies) > 1 else "",
               BODIES=Html(compared(*pair)))
        for k, pair in enumerate(bodies, 1)
    )  # fmt: skip
    body = filled(
        "<h1>@TITLE@</h1>@TEXT@<h2>Bodies</h2><p>Coloured: fitted, left and right; dashed: before. From the front and "
        'from the left.</p>@DRAWINGS@<h2>Loss and parameters</h2><img alt="loss and parameters" '
        'src="data:image/png;base64,@FIGURE@">',
        TITLE=title.lstrip("# "), TEXT=all_of(_html(rest)), DRAWINGS=drawings, FIGURE=b64encode(figure).decode(),
    )  # fmt: skip
    with replacing(path) as partial:
        partial.write_text(page("fit", title.lstrip("# "), body), encoding="utf-8")
    return Path(path)


def _html(text: str) -> Iterable[Html]:
    """HTML of headings, tables and paragraphs in Markdown."""
    blocks = re.split(r"\n\s*\n|\n(?=#)|(?<=\|)\n(?=[^|])", text)
    for kind, block in ((_kind(block), block.strip()) for block in blocks if block.strip()):
        if kind == "heading":
            first, _, rest = block.partition("\n")
            level = len(first) - len(first.lstrip("#"))
            yield filled("<h@N@>@TEXT@</h@N@>", N=level, TEXT=first.lstrip("# "))
            yield from _html(rest)
        elif kind == "table":
            yield _table(block.splitlines())
        else:
            yield filled("<p>@TEXT@</p>", TEXT=block)


def _kind(block: str) -> str:
    return {"#": "heading", "|": "table"}.get(block.strip()[0], "text")


def _table(lines: list[str]) -> Html:
    cells = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines]
    head = all_of(filled("<th>@CELL@</th>", CELL=cell) for cell in cells[0])
    rows = all_of(
        filled("<tr>@CELLS@</tr>", CELLS=all_of(filled("<td>@CELL@</td>", CELL=cell) for cell in row))
        for row in cells[2:]
    )
    return filled("<table><thead><tr>@HEAD@</tr></thead><tbody>@ROWS@</tbody></table>", HEAD=head, ROWS=rows)


def template(name: str) -> Html:
    """Text of a file of this package."""
    return Html(resources.files("voodoo_jax.viz").joinpath(name).read_text(encoding="utf-8"))


def page(name: str, title: str, body: Html) -> Html:
    """A self-contained page, with the common style and that of viz/NAME.css."""
    styles = Html(template("page.css") + template(f"{name}.css"))
    return filled(template("page.html"), STYLE=styles, BODY=Html(body.rstrip("\n")), TITLE=title)


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
    """Points to check: times without a pose, and the tracker's notes."""
    doubts = []
    if gaps := untracked(tracks):
        named = [f"{a:.1f} s" if b - a < 0.05 else f"{a:.1f} to {b:.1f} s" for a, b in gaps[:MOST_STRETCHES]]
        more = f" and {len(gaps) - MOST_STRETCHES} more" if len(gaps) > MOST_STRETCHES else ""
        doubts.append(f"not tracked: {', '.join(named)}{more}")
    return [*doubts, *tracks.notes]
