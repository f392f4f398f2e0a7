"""All that the command prints: what comes from files and other programs harms no terminal. Nothing else here prints."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from voodoo_jax.records.notes import SENTENCE, plain, shown


def tell(*texts: object, flush: bool = False) -> None:
    """Prints results, line by line, to standard output."""
    print("\n".join(shown(str(text)) for text in texts), flush=flush)


def say(command: str, problem: object, most: int = SENTENCE) -> None:
    """A sentence on what happens or is wrong, on standard error; `command` "" before there is one."""
    print(f"{f'voodoo-jax {command}'.rstrip()}: {plain(str(problem), most)}", file=sys.stderr, flush=True)


class Stop(Exception):
    """A command ends here: why, and its exit status (2: nothing was begun)."""

    def __init__(self, problem: object, status: int = 2):
        super().__init__(str(problem))
        self.status = status


@contextmanager
def stopping(*kinds: type[Exception], status: int = 2) -> Iterator[None]:
    """Errors of some kinds end the command."""
    try:
        yield
    except kinds as problem:
        raise Stop(problem, status) from problem
