"""Makes a page's relative links absolute, for places that have the page alone, such as a package index.

python docs/absolute_links.py README.md https://github.com/OWNER/NAME v0.3.0
"""

import re
import sys
from pathlib import Path

LINK = re.compile(r"(!?)(\[[^\[\]]*\]\()(?!\w+:|#|/)([^)\s]+)\)")


def absolute(text: str, repository: str, revision: str) -> str:
    """The text with links to files of a repository at a revision; pictures as they are, other files as pages."""
    return LINK.sub(lambda m: f"{m[1]}{m[2]}{repository}/{'raw' if m[1] else 'blob'}/{revision}/{m[3]})", text)


if __name__ == "__main__":
    page = Path(sys.argv[1])
    page.write_text(absolute(page.read_text(encoding="utf-8"), *sys.argv[2:]), encoding="utf-8")
