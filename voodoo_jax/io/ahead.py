"""Computes the next items of a stream in another thread."""

from collections.abc import Iterable, Iterator
from contextvars import copy_context
from queue import Full, Queue
from threading import Event, Thread
from typing import NamedTuple, TypeVar

T = TypeVar("T")
PATIENCE = 0.2  # seconds after which the other thread looks whether anybody still waits for it


class _End(NamedTuple):
    """Nothing comes any more."""

    error: BaseException | None  # because of this


def ahead(items: Iterable[T], count: int) -> Iterator[T]:
    """The same items in the same order, up to `count` of them computed in advance, in a separate thread (NumPy, OpenCV
    and decompression release the GIL). Exceptions are raised at their item. The thread ends with the iteration; it has
    the same limits as the caller."""
    made: Queue[T | _End] = Queue(count)
    stopped = Event()

    def put(item: T | _End) -> bool:
        while not stopped.is_set():
            try:
                made.put(item, timeout=PATIENCE)
                return True
            except Full:
                continue
        return False

    def make() -> None:
        error: BaseException | None = None
        try:
            for item in items:
                if not put(item):
                    break
        except BaseException as problem:  # for who asks
            error = problem
        put(_End(error))

    thread = Thread(target=copy_context().run, args=(make,), daemon=True)
    thread.start()
    try:
        while not isinstance(item := made.get(), _End):
            yield item
        if item.error is not None:
            raise item.error
    finally:
        stopped.set()
        thread.join()
