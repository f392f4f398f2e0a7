"""The process that guard.py starts: waits for tasks, and runs each in a restricted copy of itself.

python -m voodoo_jax.storage.guarded N: N is the number of an open socket. What is imported stays, so that the next task
begins at once; foreign files are opened in the copies alone. These have limited resources on all systems, limited files
and system calls on Linux. Numbers are those of the kernel's interface: landlock(7), seccomp(2),
include/uapi/linux/landlock.h, and the tables of system calls of both architectures.
"""

import ctypes
import importlib
import json
import os
import platform
import signal
import socket
import struct
import sys
import sysconfig
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

NO_NEW_PRIVILEGES, SECCOMP, END_WITH_PARENT = 38, 22, 1  # options of prctl
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446
EXECUTE, WRITE_FILE, READ_FILE, READ_FOLDER = 1 << 0, 1 << 1, 1 << 2, 1 << 3
# rights on files that the kernel knows, connections, and who is reached, by the version of its interface
RIGHTS = {1: 13, 2: 14, 3: 15, 5: 16}
CONNECT, SCOPES = (4, 3), (6, 3)
LIBRARIES = ("/usr/lib", "/usr/lib64", "/lib", "/lib64", "/usr/share/zoneinfo", "/etc/localtime", "/dev/urandom")
# socket, connect, socketpair, bind, listen, sendto, execve, execveat, kill, tkill, ptrace, mount, unshare, keyctl,
# perf_event_open, process_vm_readv, process_vm_writev, bpf, userfaultfd, io_uring_setup
FORBIDDEN = {
    "x86_64": (
        0xC000003E, (41, 42, 53, 49, 50, 44, 59, 322, 62, 200, 101, 165, 272, 250, 298, 310, 311, 321, 323, 425),
    ),
    "aarch64": (
        0xC00000B7, (198, 203, 199, 200, 201, 206, 221, 281, 129, 130, 117, 40, 97, 219, 241, 270, 271, 280, 282, 425),
    ),
}  # fmt: skip
X32 = 0x40000000  # calls of x86_64's other interface begin here
OPEN_FILES = 256
HEAD = struct.Struct("<cI")  # of a message: kind, bytes
END = struct.Struct("<iQd")  # how a copy ended: exit status, most memory in bytes, seconds of the processor
DATA, NOTE, REFUSED, DONE = b"D", b"N", b"E", b"Z"
BLOCK = 1 << 18  # bytes of a piece of the result
TEXT = 1 << 14  # bytes of a note
NO_MEMORY = "it needs more memory than is allowed (--limits.memory)"
NATIVE_MEMORY = "out of memory", "bad_alloc", "Insufficient memory", "Cannot allocate memory"  # as libraries say it
REQUEST = 1 << 17  # bytes of a task: paths and numbers


def limited_resources(memory: int, file_bytes: int) -> None:
    """Limits this process from now on: additional memory in bytes, size of written files, number of open files."""
    if os.name != "posix":
        return
    import resource

    def at_most(kind: int, most: int) -> None:
        hard = resource.getrlimit(kind)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        with suppress(ValueError, OSError):  # macOS takes no limit of memory
            resource.setrlimit(kind, (most, most))

    at_most(resource.RLIMIT_CORE, 0)
    at_most(resource.RLIMIT_NOFILE, OPEN_FILES)
    at_most(resource.RLIMIT_FSIZE, file_bytes)
    with suppress(OSError):  # of Linux: what the process could write into, the stack included
        pages = int(Path("/proc/self/statm").read_text().split()[5])
        at_most(resource.RLIMIT_DATA, pages * resource.getpagesize() + memory)
        return
    at_most(resource.RLIMIT_AS, memory)


def more_time(seconds: float) -> None:
    """The system ends this process after this many more seconds of processor time; 0: no limit."""
    if os.name == "posix" and seconds:
        import resource

        used = resource.getrusage(resource.RUSAGE_SELF)
        until = int(used.ru_utime + used.ru_stime + seconds) + 1
        hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
        resource.setrlimit(resource.RLIMIT_CPU, (until if hard == resource.RLIM_INFINITY else min(until, hard), hard))


def confined(readable: Iterable[str], writable: Iterable[str]) -> tuple[str, ...]:
    """From now on this process and its threads read only these files and folders and their libraries, write only into
    these folders, and reach no network, other process or program, as far as the system can enforce it.

    **Returns:** what sees to it: of "landlock", "seccomp". To be called while there is one thread.
    """
    if not sys.platform.startswith("linux"):
        return ()
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(END_WITH_PARENT, 9, 0, 0, 0)
    if libc.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0):
        return ()
    found = ["landlock"] if _landlock(libc, readable, writable) else []
    return (*found, *(["seccomp"] if _seccomp(libc) else []))


def own_libraries() -> set[str]:
    """Folders from which Python, this package and the system load libraries."""
    names = ("stdlib", "platstdlib", "purelib", "platlib")
    own = {sysconfig.get_path(name) for name in names} | {str(Path(__file__).resolve().parents[1])}
    return own | {path for path in sys.path if path.endswith(("site-packages", "dist-packages"))} | {*LIBRARIES}


def _landlock(libc: ctypes.CDLL, readable: Iterable[str], writable: Iterable[str]) -> bool:
    version = libc.syscall(CREATE_RULESET, None, 0, 1)
    if version < 1:
        return False
    handled = (1 << max(count for since, count in RIGHTS.items() if since <= version)) - 1
    last = [bits if version >= since else 0 for since, bits in (CONNECT, SCOPES)]
    attributes = struct.pack("<QQQ", handled, *last)[: 8 if version < 4 else 16 if version < 6 else 24]
    rules = libc.syscall(CREATE_RULESET, attributes, len(attributes), 0)
    if rules < 0:
        return False
    kinds = {path: READ_FILE | READ_FOLDER for path in (*own_libraries(), *readable)}
    kinds |= dict.fromkeys(writable, handled & ~EXECUTE) | {os.devnull: READ_FILE | WRITE_FILE}
    for path, rights in kinds.items():
        with suppress(OSError):  # one that is not there
            place = os.open(path, os.O_PATH | os.O_CLOEXEC)
            rights = rights if os.path.isdir(path) else rights & (READ_FILE | WRITE_FILE)
            libc.syscall(ADD_RULE, rules, 1, struct.pack("<Qi", rights, place), 0)
            os.close(place)
    held = libc.syscall(RESTRICT_SELF, rules, 0) == 0
    os.close(rules)
    return held


def _seccomp(libc: ctypes.CDLL) -> bool:
    machine = platform.machine()
    if machine not in FORBIDDEN or struct.calcsize("P") != 8:
        return False
    architecture, calls = FORBIDDEN[machine]
    # classic BPF: load a word, jump if equal or at least, return
    load, equal, least, give = 0x20, 0x15, 0x35, 0x06
    refused, allowed = 0x00050000 | 1, 0x7FFF0000  # with EPERM
    steps = [(load, 0, 0, 4), (equal, 0, len(calls) + 3, architecture), (load, 0, 0, 0)]
    steps += [(least, len(calls) + 1, 0, X32)]
    steps += [(equal, len(calls) - k, 0, call) for k, call in enumerate(calls)]
    steps += [(give, 0, 0, allowed), (give, 0, 0, refused)]
    code = ctypes.create_string_buffer(b"".join(struct.pack("<HBBI", *step) for step in steps))
    program = ctypes.create_string_buffer(struct.pack("<HxxxxxxQ", len(steps), ctypes.addressof(code)))
    return libc.prctl(SECCOMP, 2, program, 0, 0) == 0


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
