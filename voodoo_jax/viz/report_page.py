"""Self-contained HTML files: the report of a folder of results, with a row for each log, and that of a fit with its
text and tables, both bodies and the figure; small SVG drawings in them: a body at some times, tracked times, two
bodies."""

import os
import re
from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from importlib import resources
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from voodoo_jax._version import __version__
from voodoo_jax.exporters.frames import forwards, seconds, upright
from voodoo_jax.exporters.limb_shapes import limb_rings, rings, side_of
from voodoo_jax.model.body import Body
from voodoo_jax.records.notes import Html, all_of, filled, is_remark
from voodoo_jax.records.stretches import spread, stretches
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing

CLASSES = {"left": "l", "right": "r", "middle": "m"}  # of outlines, for a page's style sheet
CELL = 100.0  # width of a cell in the drawing's units; numbers are rounded to whole ones
COLUMNS = 120  # of a time line
MARGIN = 0.06  # of the largest extent, around the drawn bodies
MOST_STRETCHES = 4  # of time that are named; of more their number


def strip(tracks: Tracks, count: int = 5) -> str:
    """The body in `count` evenly spread tracked frames side by side, on one scale, seen from its front in the middle
    one; "" without any pose."""
    there = np.isfinite(tracks.translation).all(2).sum(1) > 0
    posed = np.flatnonzero(there & tracks.tracked if (there & tracks.tracked).any() else there)
    if not len(posed):
        return ""
    chosen = posed[spread(len(posed), count)]
    axes = _front(tracks, int(posed[len(posed) // 2]))
    return _drawn([limb_rings(tracks, int(i)) @ axes.T for i in chosen], tracks.body.topology.limbs)


def compared(before: Body, after: Body) -> str:
    """Two bodies with the same limbs in their rest poses over each other, from the front and from the left; the first
    has the class "before"."""
    views = np.array([[[0.0, 1, 0], [0, 0, 1], [-1, 0, 0]], [[-1.0, 0, 0], [0, 0, 1], [0, -1, 0]]])
    there = [
        [rings(b, np.asarray(b.rest.rotation), np.asarray(b.rest.translation)) @ v.T for v in views]
        for b in (after, before)
    ]
    return _drawn(there[0], after.topology.limbs, there[1])


def _drawn(
    bodies: Sequence[Float[np.ndarray, "limb point 3"]],
    limbs: tuple[str, ...],
    others: Sequence[Float[np.ndarray, "limb point 3"]] = (),
) -> str:
    """Draws bodies side by side, and others over them: outlines of their limbs, farthest first; right, up, away,
    metres."""
    seen = [np.concatenate(pair) for pair in zip(bodies, others)] if others else bodies
    every = [points[np.isfinite(points).all(2)] for points in seen]
    extent = np.max([np.ptp(points[:, :2], axis=0) for points in every], axis=0)
    margin = MARGIN * float(extent.max())
    width, height = extent + 2 * margin
    scale = CELL / max(width, 1e-6)
    parts = []
    for k, (body, points) in enumerate(zip(bodies, every)):
        low, high = points.min(0), points.max(0)
        origin = np.array([(low[0] + high[0] - width) / 2, low[1] - margin + height])  # all stand on one line
        shapes = [_outlines(body, limbs, origin, scale)]
        shapes += [_outlines(others[k], limbs, origin, scale, "before")] if others else []
        parts.append(f'<g transform="translate({k * CELL:g},0)">{"".join(chain(*shapes))}</g>')
    view = f"0 0 {CELL * len(bodies):g} {height * scale:.0f}"
    return f'<svg class="strip" viewBox="{view}" role="img">{"".join(parts)}</svg>'


def time_line(tracks: Tracks) -> str:
    """Tracked or not, and the confidence, over time; a bar as wide as its place."""
    time = seconds(tracks)
    if not len(time):
        return ""
    share = time / time[-1] if time[-1] > 0 else np.linspace(0, 1, len(time))
    column = np.minimum((share * COLUMNS).astype(int), COLUMNS - 1)
    rectangles = []
    for start, stop, level in _runs([_level(tracks, np.flatnonzero(column == k)) for k in range(COLUMNS)]):
        rectangles.append(f'<rect class="s{level}" x="{start}" width="{stop - start}" height="8"/>')
    return (
        f'<svg class="line" viewBox="0 0 {COLUMNS} 8" preserveAspectRatio="none" role="img">{"".join(rectangles)}</svg>'
    )


def untracked(tracks: Tracks) -> list[tuple[float, float]]:
    """Intervals in which nothing is tracked: first and last stamp, seconds after the first frame."""
    time = seconds(tracks)
    return [(float(time[a]), float(time[b - 1])) for a, b in stretches(~tracks.tracked)]


def _level(tracks: Tracks, frames: np.ndarray) -> int:
    """-1: no frame, 0: not tracked, 1 to 4: tracked, rising with the confidence."""
    if not len(frames):
        return -1
    if not tracks.tracked[frames].any():
        return 0
    sure = tracks.confidence[frames][tracks.tracked[frames]]
    sure = sure[np.isfinite(sure)]
    return 4 if not len(sure) else 1 + int(min(3, max(0, 4 * float(sure.mean()))))


def _runs(levels: list[int]) -> Iterable[tuple[int, int, int]]:
    """Start, end and value of stretches of one value; a column without a frame belongs to the one before it."""
    filled = np.array(levels)
    for k in range(1, len(filled)):
        filled[k] = filled[k - 1] if filled[k] < 0 else filled[k]
    edges = [0, *(np.flatnonzero(np.diff(filled)) + 1).tolist(), len(filled)]
    return [(a, b, int(filled[a])) for a, b in zip(edges[:-1], edges[1:])]


def _front(tracks: Tracks, i: int) -> Float[np.ndarray, "3 3"]:
    """Rows: right, up and away, for a view of the body's front in frame `i`."""
    turn = upright(tracks)
    up = turn.T[:, 2]
    ahead = forwards(tracks, i)
    away = turn.T[:, 0] if ahead is None else -ahead
    away = away - up * (away @ up)
    if np.linalg.norm(away) < 0.1:  # who lies shows no front: any horizontal direction
        away = turn.T[:, 0]
    away = away / np.linalg.norm(away)
    return np.stack([np.cross(away, up), up, away])


def _outlines(
    body: np.ndarray, limbs: tuple[str, ...], origin: np.ndarray, scale: float, look: str = ""
) -> Iterable[str]:
    """Polygons of limbs; `look` is their class, by default that of their side."""
    for limb in map(int, np.argsort(-body[:, :, 2].mean(1))):
        if not np.isfinite(body[limb]).all():
            continue
        flat = (body[limb, :, :2] - origin) * [scale, -scale]
        try:
            corners = flat[ConvexHull(flat).vertices]
        except QhullError:  # a limb without extent in this view
            continue
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        yield f'<polygon class="{look or CLASSES[side_of(limbs[limb])]}" points="{path}"/>'


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
    found += [(name.replace("_", " "), f"{100 * value:.1f} cm") for name, value in tracks.segment_lengths().items()]
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
