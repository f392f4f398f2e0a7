"""Several logs at once on one machine: worker processes, each with its share of the cores.

A process of its own per log that is being tracked, and not a thread: half of the time goes to NumPy and Python, which
threads would have to take turns at, and two threads that run large programs at once on a small pool of XLA's threads
can wait for each other for ever (seen with jax 0.10.2 on two cores). A worker that dies takes one log with it.
"""

import pickle
import signal
import threading
from collections.abc import Callable, Generator
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import jax

from voodoo_jax.batch.log_job import Job, do_job, out_of_time, output_places, remove_partials
from voodoo_jax.batch.outcome import Outcome
from voodoo_jax.batch.worker_start import Process, all_started, started
from voodoo_jax.storage.cores import text_of, usable_cores

Report = Callable[[int, float], None]  # number of the job, share that is done
Results = Generator[tuple[int, Outcome], None, None]  # number of the job and what became of it
GRACE = 5.0  # seconds beyond its time in which a worker may give a log up by itself, which keeps the process
WORKER_BYTES = 3 << 29  # what a worker may need: 1.5 GiB


def default_workers(logs: int) -> int:
    """As many workers as there are logs, cores, and memory for; one where jax computes on a GPU."""
    if may_have_gpu() and jax.default_backend() != "cpu":
        return 1
    lines = (text_of("/proc/meminfo") or "").splitlines()
    free = next((1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")), 1 << 60)
    return max(1, min(logs, usable_cores(), free // WORKER_BYTES))


def may_have_gpu() -> bool:
    """Whether it is worth asking for jax's device: this opens it, and a process with an open device cannot be
    forked."""
    return bool(find_spec("jax_plugins") or find_spec("libtpu") or entry_points(group="jax_plugins"))


def in_process(jobs: list[Job], report: Report) -> Results:
    """Runs the jobs in this process, one after the other, each with all cores. Yields the number of each job and its
    outcome."""
    for number, job in enumerate(jobs):
        yield number, do_job(job, lambda share, number=number: report(number, share))


def in_workers(jobs: list[Job], report: Report, count: int) -> Results:
    """Runs the jobs in `count` processes, in order. Yields number and outcome of each when it is finished.

    Starts the processes at once: call it before there are other threads, and they start sooner (see worker_start.py).
    Ends them when the iterator is closed or interrupted.
    """
    threads_each = max(1, usable_cores() // count)
    return _from_processes(jobs, report, all_started(count, threads_each), threads_each)


def _from_processes(jobs: list[Job], report: Report, processes: list[Process], threads_each: int) -> Results:
    waiting: SimpleQueue[tuple[int, Job] | None] = SimpleQueue()
    events: SimpleQueue[tuple[int, float | Outcome]] = SimpleQueue()
    for item in enumerate(jobs):
        waiting.put(item)
    for _ in processes:
        waiting.put(None)
    workers = [_Worker(process, threads_each, waiting, events) for process in processes]
    try:
        left = len(jobs)
        while left:
            try:
                number, news = events.get(timeout=1)  # not for ever: Ctrl-C must be heard everywhere
            except Empty:
                continue
            if isinstance(news, Outcome):
                left -= 1
                yield number, news
            else:
                report(number, news)
    finally:
        for worker in workers:
            worker.stop(at_once=left > 0)


class _Worker:
    """A thread that keeps one worker process busy, and restarts it when it dies."""

    def __init__(self, process: Process, threads: int, waiting: SimpleQueue, events: SimpleQueue):
        self.process, self.threads, self.waiting, self.events = process, threads, waiting, events
        self.stopped = self.ready = False
        self.lock = threading.Lock()  # else a process might be started after it was said to stop
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        while not self.stopped and (item := self.waiting.get()) is not None:
            number, job = item
            with self.lock:
                if self.stopped:
                    break
                if self.process.poll() is not None:
                    self._close()
                    self.process, self.ready = started(self.threads), False
            outcome = self._ask(number, job)
            if not self.stopped:
                self.events.put((number, outcome))
        try:
            _send(self.process, None)
        except (OSError, ValueError):  # gone, or closed
            pass

    def _ask(self, number: int, job: Job) -> Outcome:
        """The worker's answer, or an outcome with the error."""
        expired = threading.Event()

        def end() -> None:
            expired.set()
            self.process.kill()

        timer = threading.Timer(job.timeout + GRACE, end)
        timer.daemon = True
        if job.timeout:
            timer.start()
        try:
            _send(self.process, job)
            while True:
                kind, value = pickle.load(_pipe(self.process.stdout))
                self.ready = True
                if kind == "outcome":
                    return value
                if kind == "progress":
                    self.events.put((number, value))
        except (EOFError, OSError, pickle.UnpicklingError):
            status = self._close()
        finally:
            timer.cancel()
        for place in output_places(job.log, job.out):
            remove_partials(Path(place))
        return Outcome(job.log, error=out_of_time(job.timeout) if expired.is_set() else _death(status, self.ready))

    def stop(self, at_once: bool) -> None:
        """Ends the process: at once, or after its last job."""
        if at_once:
            with self.lock:
                self.stopped = True
                self.process.kill()
        self.thread.join()
        self._close()

    def _close(self) -> int:
        """Waits for the end of the process; its exit status."""
        status = self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            try:
                _pipe(pipe).close()
            except OSError:  # what was still to be sent
                pass
        return status


def _pipe(pipe: Any) -> Any:
    assert pipe is not None
    return pipe


def _send(process: Process, what: Job | None) -> None:
    pipe = _pipe(process.stdin)
    pipe.write(pickle.dumps(what))
    pipe.flush()


def _death(status: int, ready: bool) -> str:
    """Why a worker with this exit status has no answer, and what to try."""
    if status < 0:
        name = signal.Signals(-status).name if -status in list(signal.Signals) else f"signal {-status}"
        killed = "if nobody did that, the machine ran out of memory: use fewer --workers, or split the log"
        why = killed if name == "SIGKILL" else "a library crashed on this log: voodoo-jax info may show the reason"
        return f"its worker process was ended by {name}; {why}. The other logs are not affected."
    if not ready:
        return f"its worker process did not start (exit status {status}): see above; --workers 1 needs none"
    return f"its worker process ended with exit status {status}: see above"
