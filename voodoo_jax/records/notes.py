"""Sentences on a log: many of one kind become one line, and what a log says of itself harms no terminal; and text put
into pages: escaped, unless it is markup of ours. The only place where markup and text meet."""

import hashlib
import json
import re
from collections.abc import Iterable
from html import escape
from typing import Any

MOST = 200  # notes on one log
FEW, NAMED = 3, 8  # notes of one kind that stand alone, but not more; names that are listed then
NAME, SENTENCE = 200, 2000  # characters of a name and of a note: what is longer is cut
# how notes begin that say that frames were lost to damage
DAMAGED, INCOMPLETE = "The log is damaged: ", "The log is incomplete: "


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


def plain(text: str, most: int = NAME) -> str:
    """Text from a log as it may be printed and stored: what is not to be seen (escape sequences, ends of lines, marks
    of direction, broken Unicode) is spelt out, and what is too long loses its middle."""
    if len(text) > most:
        text = f"{text[: most * 3 // 4]}...{text[len(text) - most // 8 :]}"
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text)


def shown(text: str) -> str:
    """The same of a text of several lines."""
    return "\n".join(plain(line, 4 * SENTENCE) for line in text.split("\n"))


def plain_name(text: str) -> str:
    """The same of a name that identifies something: what is changed gets a sign of its own, so that names which
    differ stay different."""
    shown = plain(text)
    if shown == text:
        return text
    return f"{shown}~{hashlib.sha1(text.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


def remark(sentence: str) -> str:
    """A note that asks for nothing, in brackets: the command shows it with --verbose only."""
    return f"({sentence})"


def is_remark(note: str) -> bool:
    """Whether a note asks for nothing, see `remark`."""
    return note.startswith("(")


def as_few(notes: Iterable[str]) -> tuple[str, ...]:
    """The notes, each once, in their order; those that differ in a name or a number only, if there are many, as the
    first of them with the names of the others."""
    kinds: dict[str, list[str]] = {}
    for note in dict.fromkeys(plain(note, SENTENCE) for note in notes):
        kinds.setdefault(re.sub(r"'[^']*'|\d+(\.\d+)?", "#", note), []).append(note)
    out = []
    for same in kinds.values():
        if len(same) <= FEW:
            out += same
            continue
        names = dict.fromkeys(name for note in same[1:] for name in re.findall(r"'[^']*'", note)[:1])
        listed = ", ".join(list(names)[:NAMED]) + (" and others" if len(names) > NAMED else "")
        out.append(f"{same[0]} The same for {len(same) - 1} more{f': {listed}' if listed else ''}.")
    if len(out) > MOST:
        kept = [*out[:MOST], *(note for note in out[MOST:] if note.startswith((DAMAGED, INCOMPLETE)))]
        out = [*kept, f"And {len(out) - len(kept)} more notes."]
    return tuple(out)
