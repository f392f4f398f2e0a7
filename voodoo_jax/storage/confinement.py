"""Restricts a process that parses foreign files: resource limits on all systems, files and system calls on Linux.

Numbers are those of the kernel's interface: landlock(7), seccomp(2), include/uapi/linux/landlock.h, and the tables of
system calls of both architectures.
"""

import ctypes
import os
import platform
import struct
import sys
import sysconfig
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

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
