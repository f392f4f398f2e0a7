"""The report of a folder of results as one HTML file that needs nothing else: a row for each log."""

import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from pathlib import Path

import numpy as np

from voodoo_jax._version import __version__
from voodoo_jax.exporters.frames import seconds
from voodoo_jax.model.body import segment_lengths
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.viz.sketch import strip, time_line, untracked

MOST_STRETCHES = 4  # of time that are named; of more their number
UNSURE = 3  # joints that are named: the least sure ones
DOUBT = 0.9  # joints are in doubt that are expected off in more than one of ten frames


@dataclass(frozen=True)
class Row:
    """What the report tells of one log. Links are relative to the report."""

    name: str
    status: str  # tracked, nothing tracked, failed
    error: str = ""
    links: tuple[tuple[str, str], ...] = ()  # word and address
    people: tuple[str, ...] = field(default=())  # what person_cells makes of the tracks of each


def person_cells(tracks: Tracks, number: int = 0) -> str:
    """The cells of one person: drawings, what was found, what is in doubt; `number`: among several, 0: alone."""
    who = f"<b>person {number}</b>" if number else ""
    drawn = strip(tracks) or '<p class="none">no pose</p>'
    found = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in _found(tracks))
    doubts = "".join(f"<li>{escape(text)}</li>" for text in _doubts(tracks))
    return (
        f'<td class="seen">{who}{drawn}{time_line(tracks)}</td><td><table class="found">{found}</table></td>'
        f"<td><ul>{doubts}</ul></td>"
    )


def write_report_page(rows: Iterable[Row], path: str | os.PathLike[str], title: str) -> Path:
    """Writes the report of these logs and returns its path. Raises OSError."""
    rows = list(rows)
    counts = {word: sum(row.status == word for row in rows) for word in ("tracked", "nothing tracked", "failed")}
    about = ", ".join(f"{count} {word}" for word, count in counts.items() if count) or "no log"
    about = f"{len(rows)} logs: {about}; voodoo_jax {__version__}"
    text = page("report", title, _file("report.html"), ABOUT=about, ROWS="".join(map(_row, rows)))
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return Path(path)


def page(name: str, title: str, body: str, **parts: str) -> str:
    """A page of its own, with the style of all pages and that of viz/NAME.css; `parts` (HTML) stand in the body in
    place of @WORDS@."""
    styles = _file("page.css") + _file(f"{name}.css")
    text = _file("page.html")
    for word, part in ({"STYLE": styles, "BODY": body.rstrip("\n"), "TITLE": escape(title)} | parts).items():
        text = text.replace(f"@{word}@", part)
    return text


def _file(name: str) -> str:
    return resources.files("voodoo_jax.viz").joinpath(name).read_text(encoding="utf-8")


def _row(row: Row) -> str:
    links = " ".join(f'<a href="{escape(address)}">{escape(word)}</a>' for word, address in row.links)
    told = f'<p class="error">{escape(row.error)}</p>' if row.error else ""
    state = row.status.split()[0]
    head = (
        f'<td class="log" rowspan="{max(1, len(row.people))}"><b>{escape(row.name)}</b>'
        f'<span class="state {state}">{escape(row.status)}</span><p>{links}</p>{told}</td>'
    )
    first, *others = row.people or ('<td colspan="3" class="none">no tracks</td>',)
    lines = [f"<tr>{head}{first}</tr>", *(f"<tr>{cells}</tr>" for cells in others)]
    return f'<tbody class="{state}">{"".join(lines)}</tbody>\n'


def _found(tracks: Tracks) -> list[tuple[str, str]]:
    """Names and values of what was found."""
    time, body = seconds(tracks), tracks.body
    known = tracks.residual[np.isfinite(tracks.residual)]
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
    """What a user should look at: times without a pose, joints that are least sure, what the tracker says itself."""
    doubts = []
    if gaps := untracked(tracks):
        named = [f"{a:.1f} s" if b - a < 0.05 else f"{a:.1f} to {b:.1f} s" for a, b in gaps[:MOST_STRETCHES]]
        more = f" and {len(gaps) - MOST_STRETCHES} more" if len(gaps) > MOST_STRETCHES else ""
        doubts.append(f"not tracked: {', '.join(named)}{more}")
    if tracks.joint_confidence is not None and tracks.tracked.any():
        values = tracks.joint_confidence[tracks.tracked].astype(float)
        known = np.isfinite(values)
        mean = np.where(known, values, 0).sum(0) / np.maximum(known.sum(0), 1)
        order = [i for i in np.argsort(mean) if known[:, i].any() and mean[i] < DOUBT][:UNSURE]
        if order:
            words = [f"{tracks.joint_names[i]} ({100 * mean[i]:.0f} %)" for i in order]
            doubts.append(f"least sure to be within 10 cm: {', '.join(words)}")
    return [*doubts, *tracks.notes]
