"""Text put into pages: escaped, unless it is markup of ours. The only place where markup and text meet."""

import json
import re
from collections.abc import Iterable
from html import escape
from typing import Any


class Html(str):
    """Markup that is ready."""


def filled(template: str, **parts: object) -> Html:
    """A template with `parts` in place of @WORDS@: Html as it is, everything else escaped. What is put in is not looked
    through for further words."""

    def part(match: re.Match[str]) -> str:
        value = parts[match[1]]
        return value if isinstance(value, Html) else escape(str(value))

    return Html(re.sub("@([A-Z]+)@", part, template))


def all_of(parts: Iterable[Html]) -> Html:
    """One piece of markup after the other."""
    return Html("".join(parts))


def for_script(value: Any) -> Html:
    """A value as JSON within a script, which no text in it ends."""
    return Html(json.dumps(value, allow_nan=False).replace("<", "\\u003c"))
