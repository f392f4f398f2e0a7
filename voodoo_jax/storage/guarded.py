"""The process that guard.py starts: waits for tasks, and runs each in a restricted copy of itself.

python -m voodoo_jax.storage.guarded N: N is the number of an open socket. What is imported stays, so that the next task
begins at once; foreign files are opened in the copies alone.
"""

import importlib
import json
import os
import signal
import socket
import struct
import sys
import tempfile
from contextlib import suppress
from typing import Any

from voodoo_jax.storage.confinement import confined, limited_resources, more_time

HEAD = struct.Struct("<cI")  # of a message: kind, bytes
END = struct.Struct("<iQd")  # how a copy ended: exit status, most memory in bytes, seconds of the processor
DATA, NOTE, REFUSED, DONE = b"D", b"N", b"E", b"Z"
BLOCK = 1 << 18  # bytes of a piece of the result
TEXT = 1 << 14  # bytes of a note
NO_MEMORY = "it needs more memory than is allowed (--limits.memory)"
NATIVE_MEMORY = "out of memory", "bad_alloc", "Insufficient memory", "Cannot allocate memory"  # as libraries say it
REQUEST = 1 << 17  # bytes of a task: paths and numbers


class Answer:
    """What a task sends: its result as a stream of bytes, and notes. Each piece that is sent extends its time limit."""

    def __init__(self, pipe: int, seconds: float, size: int):
        self.size = size  # bytes of it, at most
        self._pipe, self._seconds, self._held, self._count = pipe, seconds, bytearray(), 0

    def write(self, data: bytes | bytearray) -> int:
        self._held += data
        self._count += len(data)
        if len(self._held) >= BLOCK:
            self._send()
        return len(data)

    def tell(self) -> int:
        return self._count

    def note(self, text: str, kind: bytes = NOTE) -> None:
        """Sends a sentence on what was left out or changed; of the kind REFUSED: why there is no result."""
        data = text.encode("utf-8", "backslashreplace")[:TEXT]
        self._message(kind, data)

    def done(self) -> None:
        self._send()
        self._message(DONE, b"")

    def _send(self) -> None:
        for at in range(0, len(self._held), BLOCK):
            self._message(DATA, self._held[at : at + BLOCK])
        self._held.clear()
        more_time(self._seconds)

    def _message(self, kind: bytes, data: bytes | bytearray) -> None:
        left = memoryview(HEAD.pack(kind, len(data)) + data)
        while left:
            left = left[os.write(self._pipe, left) :]


def done_here(task: str, arguments: list[Any], answer: Answer) -> None:
    """Runs a task, `module:function`, and sends its result."""
    module, _, name = task.partition(":")
    try:
        for note in getattr(importlib.import_module(module), name)(*arguments, answer):
            answer.note(note)
        answer.done()
    except MemoryError:
        answer.note(NO_MEMORY, REFUSED)
    except Exception as problem:  # what a task expects it says itself
        text = str(problem) or type(problem).__name__
        answer.note(NO_MEMORY if any(word in text for word in NATIVE_MEMORY) else text, REFUSED)


def _alone(request: dict[str, Any], pipe: int, others: list[int]) -> None:
    """Runs in the copy."""
    for other in others:
        os.close(other)
    os.chdir(request.get("here", "/"))
    tempfile.tempdir = request["scratch"]
    limited_resources(request["memory"], request["size"])
    more_time(request["seconds"])
    confined(request["readable"], [request["scratch"]])
    done_here(request["task"], request["arguments"], Answer(pipe, request["seconds"], request["size"]))


def serve(control: socket.socket) -> None:
    """Runs tasks until the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asked decides what Ctrl-C means
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):  # libraries print names that come from files
        os.dup2(nothing, number)
    while True:
        text, pipes, *_ = socket.recv_fds(control, REQUEST, 1)
        if not text or not pipes:
            return
        request = json.loads(text)
        for module in (request["task"].partition(":")[0], *request["imports"]):
            with suppress(Exception):  # said by the copy, which tries again
                importlib.import_module(module)
        if (child := os.fork()) == 0:
            try:
                _alone(request, pipes[0], [control.fileno(), nothing])
            finally:
                os._exit(0)
        os.close(pipes[0])
        _, status, used = os.wait4(child, 0)
        peak = used.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
        control.send(END.pack(os.waitstatus_to_exitcode(status), peak, used.ru_utime + used.ru_stime))


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
