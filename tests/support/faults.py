"""A disk that fails: files that cannot be written any further, and processes that end between two writes."""

import builtins
import errno
import io
import os
import re
from pathlib import Path
from typing import Any

REAL_OPEN, REAL_REPLACE, REAL_UNLINK = io.open, os.replace, Path.unlink
PARTIAL = re.compile(r"\.(.+)\.\d+\.tmp")  # of storage.atomic.replacing


def target_of(place: Any) -> str:
    """The name of the file that a half-written one is to become; "" of any other file."""
    found = PARTIAL.match(Path(place).name) if isinstance(place, (str, os.PathLike)) else None
    return found[1] if found else ""


class Full(io.FileIO):
    """A file on a disk that has room for so many bytes more."""

    room = 0

    def write(self, data: Any) -> int:
        if self.tell() + memoryview(data).nbytes > self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # without a name, as the system's
        return super().write(data)


def fail_writing(monkeypatch, name: str, room: int) -> None:
    """From now on the file `name` has room for `room` bytes; -1: it can be written, but not moved to its place."""

    def opened(file, mode="r", buffering=-1, encoding=None, errors=None, newline=None, *more, **named):
        if room < 0 or target_of(file) != name or "r" in mode:
            return REAL_OPEN(file, mode, buffering, encoding, errors, newline, *more, **named)
        raw = Full(file, mode.replace("b", "").replace("t", ""))
        raw.room = room
        packed = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        return packed if "b" in mode else io.TextIOWrapper(packed, encoding, errors, newline)

    def replaced(source, target, **named):
        if room < 0 and target_of(source) == name:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), os.fspath(source), None, os.fspath(target))
        REAL_REPLACE(source, target, **named)

    monkeypatch.setattr(builtins, "open", opened)
    monkeypatch.setattr(io, "open", opened)
    monkeypatch.setattr(os, "replace", replaced)


class Killed(BaseException):
    """The process ends here: nothing after this reaches the disk."""


def killed_at(monkeypatch, name: str, moved: bool) -> None:
    """The process ends when the file `name` is written: before it is moved to its place, or right after."""
    dead = []

    def replaced(source, target, **named):
        if dead:
            raise Killed
        if target_of(source) == name:
            dead.append(name)
            if moved:
                REAL_REPLACE(source, target, **named)
            raise Killed
        REAL_REPLACE(source, target, **named)

    def unlinked(path, missing_ok=False):
        if not dead:
            REAL_UNLINK(path, missing_ok)

    def opened(file, mode="r", *more, **named):
        if dead and target_of(file):
            raise Killed
        return REAL_OPEN(file, mode, *more, **named)

    monkeypatch.setattr(os, "replace", replaced)
    monkeypatch.setattr(Path, "unlink", unlinked)
    monkeypatch.setattr(builtins, "open", opened)
    monkeypatch.setattr(io, "open", opened)
