"""Tasks that take turns in one process; simultaneous requests of several tasks are answered at once. Host side."""

from collections.abc import Callable, Generator, Sequence
from itertools import islice
from queue import SimpleQueue
from threading import Thread
from typing import Any, Generic, TypeVar

T = TypeVar("T")
Ask = Callable[..., Any]  # waits for the answer
Answer = Callable[[list[tuple]], list[Any]]  # what some tasks ask for -> their answers


def in_turns(tasks: Sequence[Callable[[Ask], T]], most: int, answer: Answer) -> Generator[tuple[int, T]]:
    """Yields number and result of each finished task, with `most` of them at once.

    A task is given a function to ask with. Only one of them runs at a time; when all wait, `answer` gets what they ask
    for. Raises what a task raises.
    """
    left = enumerate(tasks)
    members: dict[int, _Member[T]] = {}
    try:
        while True:
            for number, task in islice(left, most - len(members)):
                members[number] = _Member(task)
                members[number].go_on(None)
            done = [number for number, member in members.items() if member.asked is None]
            for number in done:
                yield number, members.pop(number).result
            if done:
                continue  # there is room for others
            if not members:
                return
            waiting = list(members.values())
            for member, value in zip(waiting, answer([member.asked for member in waiting]), strict=True):
                member.go_on(value)
    finally:
        for member in members.values():
            member.stop()


class _Stopped(BaseException):
    """The result of this task is no longer needed."""


class _Member(Generic[T]):
    """A task in a thread of its own, which runs only while it is waited for: the functions between it and its request
    need not know that they can be interrupted there."""

    result: T

    def __init__(self, task: Callable[[Ask], T]):
        self.asked: Any = ()  # None: it is done
        self._task, self._answers, self._said = task, SimpleQueue(), SimpleQueue()
        self._problem: BaseException | None = None
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def go_on(self, value: Any) -> None:
        """Passes the answer, and waits for the next request or the end."""
        self._answers.put((True, value))
        self.asked = self._said.get()
        if self._problem is not None:
            raise self._problem

    def stop(self) -> None:
        """Ends the task now, or at its next request."""
        self._answers.put((False, None))

    def _run(self) -> None:
        try:
            self._next()
            self.result = self._task(self._ask)
        except _Stopped:
            return
        except BaseException as problem:
            self._problem = problem
        self._said.put(None)

    def _ask(self, *what: Any) -> Any:
        self._said.put(what)
        return self._next()

    def _next(self) -> Any:
        on, value = self._answers.get()
        if not on:
            raise _Stopped
        return value
