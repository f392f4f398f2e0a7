"""Starts worker processes: as copies of this process where that is safe, else as new Python processes.

A copy has all imports already: a second of a processor less for each worker. It is safe while this process has one
thread, so before jax has opened a device and before OpenBLAS has made threads (see cli.main.main).
"""

import gc
import multiprocessing
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

# what one log needs, beside what log_job.py imports at once
IMPORTS = ("trackers.of_points", "trackers.smoothing", "io.log_reader", "exporters.foxglove", "exporters.npz")
ENVIRONMENT = ("PJRT_NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
PATIENCE = 50  # milliseconds


class Copy:
    """A copy of this process that runs worker_process.py, by subprocess.Popen's names. `others` were made before it."""

    def __init__(self, threads: int, others: Sequence["Process"]):
        source, stdin = os.pipe()
        stdout, replies = os.pipe()
        self.stdin, self.stdout = os.fdopen(stdin, "wb"), os.fdopen(stdout, "rb")
        # an end that a sibling keeps open hides that this process is gone
        theirs = [pipe.fileno() for each in (self, *others) for pipe in (each.stdin, each.stdout) if pipe]
        arguments = (source, replies, theirs, environment(threads))
        self.process = multiprocessing.get_context("fork").Process(target=_serve, args=arguments, daemon=True)
        self.process.start()
        os.close(source)
        os.close(replies)

    def poll(self) -> int | None:
        return self.process.exitcode

    def wait(self) -> int:
        self.process.join()
        return self.process.exitcode or 0

    def kill(self) -> None:
        self.process.kill()


Process = subprocess.Popen[bytes] | Copy


def environment(threads: int) -> dict[str, str]:
    """Environment variables of a worker with this many threads. XLA gets one in any case: with several it is slower,
    because it distributes small pieces (measured: 2,350 instead of 3,850 frames/s)."""
    out = dict.fromkeys(ENVIRONMENT, str(threads)) | {"PJRT_NPROC": "1"}
    # on a GPU: each takes what it needs, not most of it
    return out | {"XLA_PYTHON_CLIENT_PREALLOCATE": os.environ.get("XLA_PYTHON_CLIENT_PREALLOCATE", "false")}


def can_copy() -> bool:
    """Whether this process may be forked: on Linux, with a single thread, of any library."""
    if not sys.platform.startswith("linux"):
        return False
    for _ in range(PATIENCE):
        try:
            if len(os.listdir("/proc/self/task")) == 1:
                return True
        except OSError:
            return False
        if threading.active_count() > 1:
            return False
        time.sleep(0.001)  # for Python a thread has ended a moment before it has for the system
    return False


def in_a_copy(function: Callable[..., str], *arguments: Any) -> str:
    """Result of a function that opens jax's device, computed in a fork of this process if possible: a process with an
    open device cannot be forked any more."""
    if not can_copy():
        return function(*arguments)
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_answer, args=(there, function, arguments), daemon=True)
    process.start()
    there.close()
    try:
        return here.recv()
    except EOFError:
        return f"the check ended its process (exit status {process.exitcode})"
    finally:
        process.join()


def _answer(pipe: Any, function: Callable[..., str], arguments: tuple) -> None:
    pipe.send(function(*arguments))


def started(threads: int) -> Process:
    """A new Python process that runs worker_process.py."""
    path = os.pathsep.join(p for p in sys.path if p)  # the same package, however this process came to it
    env = {**os.environ, **environment(threads), "PYTHONPATH": path}
    command = [sys.executable, "-P", "-m", "voodoo_jax.batch.worker_process"]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=env)


def all_started(count: int, threads: int) -> list[Process]:
    """This many processes that run worker_process.py: forks of this one, or new Python processes."""
    if not can_copy():
        return [started(threads) for _ in range(count)]
    collecting = gc.isenabled()
    gc.disable()  # all that is imported stays
    for name in IMPORTS:
        import_module(f"voodoo_jax.{name}")
    if collecting:
        gc.enable()
    copies: list[Process] = []
    for _ in range(count):
        copies.append(Copy(threads, copies))
    return copies


def _serve(source: int, replies: int, theirs: list[int], env: dict[str, str]) -> None:
    from voodoo_jax.batch.worker_process import serve

    for end in theirs:
        os.close(end)
    os.environ.update(env)
    serve(source, replies)
