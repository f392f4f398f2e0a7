"""The report of a fit as one HTML file that needs nothing else: its text and tables, both bodies, the figure."""

import os
import re
from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from voodoo_jax.model.body import Body
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.viz.report_page import page
from voodoo_jax.viz.sketch import compared


def write_fit_page(
    report: str, bodies: Sequence[tuple[Body, Body]], figure: bytes, path: str | os.PathLike[str]
) -> Path:
    """Writes the page and returns its path.

    **Arguments:** `report` Markdown of headings, paragraphs and tables; `bodies` of each person before the fit and
    after it; `figure` a PNG.

    Raises OSError.
    """
    title, _, rest = report.partition("\n")
    drawings = "".join(
        f"<h3>person {k}</h3>{compared(*pair)}" if len(bodies) > 1 else compared(*pair)
        for k, pair in enumerate(bodies, 1)
    )
    picture = f'<img alt="loss and parameters" src="data:image/png;base64,{b64encode(figure).decode()}">'
    body = (
        f"<h1>{escape(title.lstrip('# '))}</h1>{''.join(_html(rest))}"
        f"<h2>Bodies</h2><p>Coloured: fitted, left and right; dashed: before. From the front and from the left.</p>"
        f"{drawings}<h2>Loss and parameters</h2>{picture}"
    )
    with replacing(path) as partial:
        partial.write_text(page("fit", title.lstrip("# "), body), encoding="utf-8")
    return Path(path)


def _html(text: str) -> Iterable[str]:
    """Headings, tables and paragraphs of Markdown."""
    blocks = re.split(r"\n\s*\n|\n(?=#)|(?<=\|)\n(?=[^|])", text)
    for kind, block in ((_kind(block), block.strip()) for block in blocks if block.strip()):
        if kind == "heading":
            first, _, rest = block.partition("\n")
            level = len(first) - len(first.lstrip("#"))
            yield f"<h{level}>{escape(first.lstrip('# '))}</h{level}>"
            yield from _html(rest)
        elif kind == "table":
            yield _table(block.splitlines())
        else:
            yield f"<p>{escape(block)}</p>"


def _kind(block: str) -> str:
    return {"#": "heading", "|": "table"}.get(block.strip()[0], "text")


def _table(lines: list[str]) -> str:
    cells = [[escape(cell.strip()) for cell in line.strip().strip("|").split("|")] for line in lines]
    head = "".join(f"<th>{cell}</th>" for cell in cells[0])
    rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in cells[2:])
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
