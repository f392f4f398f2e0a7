"""All that the command prints: what comes from files and other programs harms no terminal. Nothing else here prints."""

import sys

from voodoo_jax.records.notes import SENTENCE, plain, shown


def tell(*texts: object, flush: bool = False) -> None:
    """What was asked for, line by line, on standard output."""
    print("\n".join(shown(str(text)) for text in texts), flush=flush)


def say(command: str, problem: object, most: int = SENTENCE) -> None:
    """A sentence on what happens or is wrong, on standard error; `command` "" before there is one."""
    print(f"{f'voodoo-jax {command}'.rstrip()}: {plain(str(problem), most)}", file=sys.stderr, flush=True)
