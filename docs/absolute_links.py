"""Makes README.md a page of the package index, which has this page alone: absolute links, and lines that install from
the index, not from a clone.

python docs/absolute_links.py README.md https://github.com/OWNER/NAME v0.3.0
"""

import re
import sys
from pathlib import Path

# what a reader of the index types instead; a README that lacks one of these fails
INSTALLED = {
    "You need Python 3.11 or newer and a clone of this repository.": "You need Python 3.11 or newer.",
    "install -q -e . && .venv/bin/voodoo-jax demo": "install -q voodoo_jax && .venv/bin/voodoo-jax demo",
    "`mkdocs serve` (`pip": "In a clone of the repository, `mkdocs serve` (`pip",
    "This line creates the environment if": "In a clone of the repository, this line creates the environment if",
}
LINK = re.compile(r"(!?)(\[[^\[\]]*\]\()(?!\w+:|#|/)([^)\s]+)\)")


def absolute(text: str, repository: str, revision: str) -> str:
    """The text with links to files of a repository at a revision; pictures as they are, other files as pages."""
    return LINK.sub(lambda m: f"{m[1]}{m[2]}{repository}/{'raw' if m[1] else 'blob'}/{revision}/{m[3]})", text)


def installed(text: str) -> str:
    """The text with lines that install the package from the index. Raises ValueError if the text lacks one of them."""
    for line, other in INSTALLED.items():
        if line not in text:
            raise ValueError(f"not in the page: {line}")
        text = text.replace(line, other)
    return text


if __name__ == "__main__":
    page = Path(sys.argv[1])
    page.write_text(installed(absolute(page.read_text(encoding="utf-8"), *sys.argv[2:])), encoding="utf-8")
