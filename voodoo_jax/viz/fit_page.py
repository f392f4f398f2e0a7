"""The report of a fit as one self-contained HTML file: its text and tables, both bodies, the figure."""

import os
import re
from base64 import b64encode
from collections.abc import Iterable, Sequence
from pathlib import Path

from voodoo_jax.model.body import Body
from voodoo_jax.records.notes import Html, all_of, filled
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.viz.sketch import compared
from voodoo_jax.viz.template import page


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
