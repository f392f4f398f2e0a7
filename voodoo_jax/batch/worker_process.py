"""The worker that process_pool.py starts: takes jobs from a pipe and answers on another."""

import gc
import os
import pickle
import signal
import threading
import time
from queue import SimpleQueue
from typing import Any

PERIOD = 0.2  # seconds between two words on progress


def serve(source: int, target: int) -> None:
    """Runs jobs from `source` until it is None, and answers on `target`; both are numbers of open files. Ends at once
    when the other end closes: its answer would be lost."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what Ctrl-C means
    replies = os.fdopen(target, "wb")
    os.dup2(2, 1)  # what libraries print must not get between the answers
    gc.disable()  # all that is imported stays, and need not be gone through again and again
    from voodoo_jax.batch.log_job import (
        do_job,  # before the other thread: two threads must not import one package at once
    )
    from voodoo_jax.compile.cache_dir import leave_compile_cache

    gc.freeze()
    gc.enable()

    jobs: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_receive, args=(source, jobs), daemon=True).start()
    said = 0.0

    def answer(kind: str, value: Any) -> None:
        try:
            pickle.dump((kind, value), replies)
            replies.flush()
        except OSError:  # the other end died, and this thread saw it before the one that listens
            os._exit(1)

    def progress(share: float) -> None:
        nonlocal said
        if time.monotonic() - said > PERIOD:
            said = time.monotonic()
            answer("progress", share)

    answer("ready", None)
    while (job := jobs.get()) is not None:
        answer("outcome", do_job(job, progress))
    leave_compile_cache()  # copies of a process end without atexit


def _receive(source: int, jobs: "SimpleQueue[Any]") -> None:
    stream = os.fdopen(source, "rb")
    while True:
        try:
            jobs.put(pickle.load(stream))
        except (EOFError, OSError):
            os._exit(1)


if __name__ == "__main__":
    # not sys.stdin and sys.stdout: Python wants their locks at the end, while the other thread still waits
    serve(os.dup(0), os.dup(1))
