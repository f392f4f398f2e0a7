"""Text put into pages: escaped, unless it is markup of ours. The only place where markup and text meet."""

import json
import re
from collections.abc import Iterable
from html import escape
from importlib import resources
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


def template(name: str) -> Html:
    """A file of this package."""
    return Html(resources.files("voodoo_jax.viz").joinpath(name).read_text(encoding="utf-8"))


def page(name: str, title: str, body: Html) -> Html:
    """A page of its own, with the style of all pages and that of viz/NAME.css."""
    styles = Html(template("page.css") + template(f"{name}.css"))
    return filled(template("page.html"), STYLE=styles, BODY=Html(body.rstrip("\n")), TITLE=title)
