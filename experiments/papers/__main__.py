"""The papers' results on recordings of ours, beside their own: python -m experiments.papers RECORDINGS

RECORDINGS is a folder of *.mcap with a *.truth.npz beside each; stereo pairs are looked for in its folder `stereo`.
Writes tables and pictures here, and docs/papers.md, the page that holds them. `--parts` does some parts again and takes
the others as they were.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import tyro

from experiments.common import write
from experiments.papers import hecht, mutations, page, voodoo
from voodoo_jax.compile.cache_dir import users_cache

LONG = 150  # frames of the figures by steps and measurements: about the 2007 paper's 15 seconds
HERE = Path(__file__).parent
Part = Literal["table1", "figures", "hecht", "mutations"]
ALL: tuple[Part, ...] = ("table1", "figures", "hecht", "mutations")


@users_cache()
def main(  # 8 parameters: the command's flags
    recordings: tyro.conf.Positional[Path],
    parts: tuple[Part, ...] = ALL,
    figure_of: str = "bow-wave-15s",
    every: int = 1,
    frames: int = 0,
    turns: int = 5,
    out: Path = HERE,
    docs: Path = HERE.parents[1] / "docs" / "papers.md",
) -> None:
    """The papers' results on recordings of ours.

    Args:
        recordings: folder with *.mcap and *.truth.npz, and a folder `stereo` of the same.
        parts: what is done; what is left out is taken as it was.
        figure_of: recording of the figures; if it is not there, the first.
        every: take every N-th recording, from the N-th on.
        frames: of each recording (0: all).
        turns: rounds of what is timed.
        out: folder for tables and pictures.
        docs: the page.
    """
    if "table1" in parts or "figures" in parts:
        _voodoo(recordings, parts, figure_of, every, frames, turns, out)
    if "hecht" in parts:
        text, figure = hecht.results(recordings / "stereo")
        write(out, "hecht", text, figure)
    if "mutations" in parts:
        write(out, "mutations", mutations.report(mutations.survivors(mutations.INGREDIENTS)))
    kept = {path.stem: path.read_text().strip() for path in sorted(out.glob("*.md"))}
    docs.write_text(page.filled(kept))
    print(f"written: {docs}")


# 7 parameters: the command's
def _voodoo(
    recordings: Path, parts: Iterable[Part], figure_of: str, every: int, frames: int, turns: int, out: Path
) -> None:
    if "table1" in parts:
        found, one, figure = voodoo.all_logs(recordings, every, frames, figure_of)
        write(out, "table1", voodoo.table_one(found))
        write(out, "fig6", voodoo.groups(found), figure, dpi=85)
    else:
        one = voodoo.of_figures(recordings, frames, figure_of)
    one = voodoo.cut(one, LONG)
    if "figures" in parts:
        write(out, "fig7", *voodoo.figure_seven(one))
        write(out, "fig8", *voodoo.figure_eight(one, (1, 3, 6, 10, 15), turns))
        write(out, "fig9", *voodoo.figure_nine(one, (128, 256, 512, 1024, 2048), turns))


if __name__ == "__main__":
    tyro.cli(main)
