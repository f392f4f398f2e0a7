"""Parses foreign files in a restricted process (see guarded.py): a file that crashes its reader, never ends or
needs too much memory results in an error message only. Results are bytes and sentences of checked length."""

import atexit
import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from voodoo_jax.storage.guarded import BLOCK, DATA, DONE, END, HEAD, NOTE, REFUSED, REQUEST, TEXT, Answer, done_here

NOTES = 10_000  # of one task
# seconds by the clock without a piece of the result, beside ten times those of a processor, which others want, too;
# by hand
PATIENCE = 100.0
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")  # else the process cannot be copied


class Refused(ValueError):
    """A foreign file gives no result: the reason, as the end of a sentence."""


class Room(NamedTuple):
    """Limits of a task."""

    memory: int  # bytes, beside what libraries need
    seconds: float  # of the processor between two pieces of the result; 0: no limit
    size: int  # bytes of the result, and of a file that it needs meanwhile


# 6 parameters: the task, what it may, and where its result goes
def guarded(
    task: str, arguments: Sequence[Any], readable: Iterable[str], room: Room, take: Callable[[bytes], Any],
    imports: Iterable[str] = (),
) -> list[str]:  # fmt: skip
    """Runs a function in a process of its own that can read only some files and folders.

    **Arguments:** `task` "module:function"; it is called with `arguments`, of which JSON has the kinds, and an Answer,
    writes its result there and returns notes; `take` gets the result piece by piece; `imports` modules that it
    needs.

    **Returns:** the notes. Raises Refused with what the function raises or what has ended its process; what `take`
    raises. Where processes cannot be copied (not on POSIX) the function runs here, without guard.
    """
    if not hasattr(os, "fork"):
        return unguarded(task, arguments, room, take)
    with _lock, tempfile.TemporaryDirectory(prefix="voodoo-") as scratch:
        helper = _helper()
        whole = False
        try:
            request = {"task": task, "arguments": list(arguments), "imports": list(imports), "scratch": scratch}
            with suppress(FileNotFoundError):  # a folder that is not there any more
                request["here"] = os.getcwd()
            request["readable"] = list(readable)
            ours, theirs = os.pipe()
            try:
                try:
                    text = json.dumps(request | room._asdict()).encode()
                    if len(text) > REQUEST:
                        raise Refused("its name is too long")
                    socket.send_fds(helper.control, [text], [theirs])
                finally:
                    os.close(theirs)
                notes, said = _heard(ours, room, take)
            finally:
                os.close(ours)
            status, *used = END.unpack(helper.control.recv(END.size))
            last[:] = used
            whole = True
        except (BrokenPipeError, ConnectionError) as problem:
            raise Refused("the process that reads it has ended") from problem
        finally:
            if not whole:  # it may still be at work
                helper.end()
    if said is None:
        raise Refused(_ended(status, room))
    if said:
        raise Refused(said)
    return notes


def _heard(pipe: int, room: Room, take: Callable[[bytes], Any]) -> tuple[list[str], str | None]:
    """Notes, and why there is no result: "" if there is one, None if its process ended without a reason."""
    notes: list[str] = []
    total, wait = 0, PATIENCE + 10 * room.seconds if room.seconds else None
    while True:
        head = _read(pipe, HEAD.size, wait)
        if len(head) < HEAD.size:
            return notes, None
        kind, length = HEAD.unpack(head)
        if length > (BLOCK if kind == DATA else TEXT) or len(notes) > NOTES:
            raise Refused("what its reader says cannot be understood")
        data = _read(pipe, length, wait)
        if len(data) < length:
            return notes, None
        if kind == DATA:
            total += length
            if total > room.size:
                raise Refused(f"it becomes more than {room.size} bytes (--limits.log_bytes)")
            take(data)
        elif kind == NOTE:
            notes.append(data.decode("utf-8", "backslashreplace"))
        elif kind in (REFUSED, DONE):
            return notes, data.decode("utf-8", "backslashreplace") or ("" if kind == DONE else "it cannot be read")
        else:
            raise Refused("what its reader says cannot be understood")


def _read(pipe: int, count: int, wait: float | None) -> bytes:
    """Reads this many bytes, or fewer at the end."""
    found = b""
    while len(found) < count:
        if not select.select([pipe], [], [], wait)[0]:
            raise Refused("reading does not progress, and was stopped (--limits.seconds)")
        if not (more := os.read(pipe, count - len(found))):
            break
        found += more
    return found


def _ended(status: int, room: Room) -> str:
    """Why a process ended."""
    if status >= 0:
        return "the process that reads it has ended"
    if -status == signal.SIGXCPU:
        return f"after {room.seconds:g} s of processor time it gave no result (--limits.seconds)"
    if -status == signal.SIGKILL:
        return "the process that reads it was killed: is there enough memory?"
    return f"its reader crashed ({signal.Signals(-status).name}): it is damaged"


class _Helper:
    """A process that waits for tasks."""

    def __init__(self) -> None:
        self.control, theirs = socket.socketpair()
        path = os.pathsep.join(p for p in sys.path if p)  # the same package, however this process came to it
        env = {**os.environ, **dict.fromkeys(ONE_THREAD, "1"), "PYTHONPATH": path}
        command = [sys.executable, "-P", "-m", "voodoo_jax.storage.guarded", str(theirs.fileno())]
        self._process = subprocess.Popen(command, env=env, pass_fds=[theirs.fileno()])
        theirs.close()

    @property
    def runs(self) -> bool:
        return self._process.poll() is None

    def end(self) -> None:
        """Ends the process and its task."""
        self.control.close()
        self._process.kill()
        self._process.wait()


last: list[float] = []  # of the last task that came to an end: most memory in bytes, seconds of the processor
_lock = threading.Lock()
_helpers: dict[int, _Helper] = {}  # by process: a copy of this one needs its own


def _helper() -> _Helper:
    own = os.getpid()
    if own not in _helpers or not _helpers[own].control.fileno() > 0 or not _helpers[own].runs:
        if own not in _helpers:
            atexit.register(_end, own)
        _helpers[own] = _Helper()
    return _helpers[own]


def _end(own: int) -> None:
    if own == os.getpid():
        _helpers[own].end()


def unguarded(task: str, arguments: Sequence[Any], room: Room, take: Callable[[bytes], Any]) -> list[str]:
    """The same in this process, without limits."""

    class Here(Answer):
        def __init__(self) -> None:
            super().__init__(-1, 0, room.size)
            self.notes, self.said = list[str](), ""

        def _message(self, kind: bytes, data: bytes | bytearray) -> None:
            if kind == DATA:
                take(bytes(data))
            elif kind == NOTE:
                self.notes.append(data.decode())
            elif kind == REFUSED:
                self.said = data.decode() or "it cannot be read"

    here = Here()
    done_here(task, list(arguments), here)
    if here.said:
        raise Refused(here.said)
    return here.notes
