"""The other end of workers.py: a process that takes jobs from its standard input and answers on its standard output."""

import gc
import os
import pickle
import signal
import threading
import time
from queue import SimpleQueue
from typing import Any

PERIOD = 0.2  # seconds between two words on progress


def serve() -> None:
    """Does jobs until None comes. Ends at once when the other end is gone: nobody would take the answer."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what Ctrl-C means
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not get between the answers
    gc.disable()  # all that is imported stays, and need not be gone through again and again
    from voodoo_jax.jobs import do_job  # before the other thread: two threads must not import one package at once

    gc.freeze()
    gc.enable()

    jobs: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_receive, args=(jobs,), daemon=True).start()
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


def _receive(jobs: "SimpleQueue[Any]") -> None:
    # not sys.stdin: Python wants its lock at the end, while this thread still waits
    source = os.fdopen(os.dup(0), "rb")
    while True:
        try:
            jobs.put(pickle.load(source))
        except (EOFError, OSError):
            os._exit(1)


if __name__ == "__main__":
    serve()
