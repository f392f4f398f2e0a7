"""Reads a recording of several files as one."""

import heapq
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

from mcap.records import Channel, Schema

from voodoo_jax.io.chunks import Clock
from voodoo_jax.io.container import Item, LogFile, Place
from voodoo_jax.storage.urls import TOGETHER, log_parts


class LogFiles(LogFile):
    """Several files that were recorded together, as one log: one after the other, or by log time where they overlap.

    Channels and schemas have numbers of their own. Raises `LogError` if one of them is missing or is not MCAP.
    """

    def __init__(self, path: str, files: Sequence[str | os.PathLike[str]]):
        self.path = path
        self._parts = [LogFile(file) for file in files]
        ranges = [part.time_range for part in self._parts]
        known = [times for times in ranges if times is not None]
        if len(known) == len(ranges):
            self._parts.sort(key=lambda part: part.time_range or (0, 0))
            known.sort()
        self._overlap = any(a[1] > b[0] for a, b in zip(known, known[1:]))
        self.size = sum(part.size for part in self._parts)
        self.clock = Clock(self.size)
        for part in self._parts:
            part.clock = self.clock
        self.channels, self.schemas, self.counts, self.damage = {}, {}, Counter(), []
        self.set_backs = sum((part.set_backs for part in self._parts), ())
        self.time_range = (known[0][0], max(last for _, last in known)) if known else None
        self.declared = {}
        self._gather()

    def messages(self, wanted: Callable[[Schema | None, Channel], bool]) -> Iterator[Item]:
        """As of one file."""
        each = [part.messages(wanted) for part in self._parts]
        yield from heapq.merge(*each, key=lambda item: item[2].log_time) if self._overlap else chain(*each)
        self._gather()

    def _gather(self) -> None:
        """What the files say of themselves, with numbers that are of one file only."""
        self.counts, self.damage, self.declared = Counter(), [], {}
        for k, part in enumerate(self._parts):
            number = k * (1 << 16)  # MCAP's channels and schemas have 16 bits
            self.schemas |= {number + i: schema for i, schema in part.schemas.items()}
            self.channels |= {
                number + i: replace(c, id=number + i, schema_id=c.schema_id and number + c.schema_id)
                for i, c in part.channels.items()
            }
            self.counts.update({number + i: count for i, count in part.counts.items()})
            self.damage += [f"{os.path.basename(part.path)}: {said}" for said in part.damage]
            if part.declared is None:
                self.declared = None
            elif self.declared is not None:
                self.declared |= {number + i: count for i, count in part.declared.items()}


def open_files(path: Place) -> LogFile:
    """The file of a log; or the files of one that has several: a bag's folder, a list, or a.mcap+b.mcap."""
    if not isinstance(path, str | os.PathLike):
        files = [os.fspath(file) for file in path]
        return LogFiles(TOGETHER.join(files), files) if len(files) != 1 else LogFile(files[0])
    files = log_parts(os.fspath(path))
    if len(files) > 1 or os.path.isdir(path) and files:
        return LogFiles(os.fspath(path), files)
    return LogFile(path)
