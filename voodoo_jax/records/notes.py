"""Sentences on a log: many of one kind become one line."""

import re
from collections.abc import Iterable

FEW, NAMED = 3, 8  # notes of one kind that stand alone, but not more; names that are told then


def as_few(notes: Iterable[str]) -> tuple[str, ...]:
    """The notes, each once, in their order; those that differ in a name or a number only, if there are many, as the
    first of them with the names of the others."""
    kinds: dict[str, list[str]] = {}
    for note in dict.fromkeys(notes):
        kinds.setdefault(re.sub(r"'[^']*'|\d+(\.\d+)?", "#", note), []).append(note)
    out = []
    for same in kinds.values():
        if len(same) <= FEW:
            out += same
            continue
        names = dict.fromkeys(name for note in same[1:] for name in re.findall(r"'[^']*'", note)[:1])
        told = ", ".join(list(names)[:NAMED]) + (" and others" if len(names) > NAMED else "")
        out.append(f"{same[0]} The same of {len(same) - 1} more{f': {told}' if told else ''}.")
    return tuple(out)
