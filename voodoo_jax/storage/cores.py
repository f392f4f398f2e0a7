"""Number of usable cores, for all processes here and for this process alone; runs work on several cores, and computes
the next items of a stream in another thread."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar, cast

T = TypeVar("T")
R = TypeVar("R")
_takes_turns: ContextVar[bool] = ContextVar("_takes_turns", default=False)


def ahead(items: Iterable[T], count: int) -> Iterator[T]:
    """The same items in the same order, up to `count` of them computed in advance, in a separate thread (NumPy, OpenCV
    and decompression release the GIL). Exceptions are raised at their item. The thread ends with the iteration; it has
    the same limits as the caller."""
    source, end, context = iter(items), object(), copy_context()
    pool = ThreadPoolExecutor(1)
    begin = lambda: pool.submit(context.run, next, source, end)  # noqa: E731
    made = deque(begin() for _ in range(count + 1))  # one is in hand
    try:
        while (item := made.popleft().result()) is not end:
            made.append(begin())
            yield cast(T, item)
    finally:
        pool.shutdown(cancel_futures=True)


def at_once(work: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """Results of `work` for each item, in order, by as many threads as this process has cores. Raises the exception of
    the first item that fails. The caller's limits hold in the threads."""
    count = min(_threads(), len(items))
    if count < 2:
        return [work(item) for item in items]
    waiting, made, errors = deque(range(len(items))), dict[int, R](), dict[int, BaseException]()

    def go() -> None:
        while waiting and not errors:
            k = waiting.popleft()
            try:
                made[k] = work(items[k])
            except BaseException as error:  # for who asks
                errors[k] = error

    # daemons: an interrupted process does not wait for them
    threads = [Thread(target=copy_context().run, args=(go,), daemon=True) for _ in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise errors[min(errors)]
    return [made[k] for k in range(len(items))]


def begun(work: Callable[..., R], *given: Any) -> Callable[[], R]:
    """Begins some work in another thread, with the caller's limits, and returns what waits for its result. The work is
    done at once if this process has one core."""
    if _threads() < 2:
        made = work(*given)
        return lambda: made
    pool = ThreadPoolExecutor(1)
    future = pool.submit(copy_context().run, work, *given)
    pool.shutdown(wait=False)
    return future.result


def take_turns() -> None:
    """Keeps what this thread does from now on in this thread: others are answered between its requests, in an order
    that threads of its own would break."""
    _takes_turns.set(True)


def _threads() -> int:
    """Threads over which work may be spread."""
    return 1 if _takes_turns.get() else own_cores()


def usable_cores() -> int:
    """Physical cores that this process may use, by its affinity and the container's quota."""
    cpus = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))
    siblings = {text_of(f"/sys/devices/system/cpu/cpu{n}/topology/thread_siblings_list") or str(n) for n in cpus}
    quota = (text_of("/sys/fs/cgroup/cpu.max") or "max 1").split()
    most = int(quota[0]) // int(quota[1]) if quota[0].isdigit() else len(siblings)
    return max(1, min(len(siblings), most))


def own_cores() -> int:
    """Cores that this process may keep busy: its share if it is one of several workers."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return min(usable_cores(), int(asked)) if asked.isdigit() and int(asked) > 0 else usable_cores()


def text_of(path: str) -> str:
    """Content of a small system file; empty if it cannot be read."""
    try:
        return Path(path).read_text().strip()
    except OSError:
        return ""
