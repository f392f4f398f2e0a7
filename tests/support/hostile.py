"""What a parser of foreign files may do when its file is hostile: tasks for storage.guard.guarded."""

import ctypes
import os
import socket
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any


def writes(answer: Any) -> list[str]:
    answer.write(b"x" * 1_000_000)
    return ["a note", "\x1b[31m"]


def crashes(answer: Any) -> list[str]:
    ctypes.string_at(0)
    return []


def takes_memory(answer: Any) -> list[str]:
    return [str(len(bytearray(1 << 30)))]


def spins(answer: Any) -> list[str]:
    while True:
        pass


def waits(answer: Any) -> list[str]:
    time.sleep(1000)
    return []


def floods(answer: Any) -> list[str]:
    while True:
        answer.write(b"x" * 100_000)


def lies(answer: Any) -> list[str]:
    os.write(answer._pipe, b"D\xff\xff\xff\xff")
    return []


def looks_round(secret: str, allowed: str, answer: Any) -> list[str]:
    """What it can do that it should not, in words."""
    found = ["reads what it may"] if Path(allowed).read_text() == "mine" else []
    with suppress(OSError):
        found.append(Path(secret).read_text())
    with suppress(OSError):
        Path(secret).with_name("new").write_text("x")
        found.append("writes")
    with suppress(OSError):
        socket.create_connection(("127.0.0.1", 9), 1)
    with suppress(OSError):
        socket.socket()
        found.append("has sockets")
    with suppress(OSError):
        os.kill(os.getppid(), 0)
        found.append("reaches processes")
    os.system(f"echo x > {secret}")
    with tempfile.TemporaryFile() as file:
        file.write(b"x")
    return [*found, "writes where it may"]
