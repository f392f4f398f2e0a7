"""The tracker's program for many recordings at once, each in a lane of its own; lanes are distributed over all devices.
For GPUs, which one log leaves idle most of the time: tasks take turns in this process, and simultaneous requests of
several tasks are answered at once."""

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from functools import cache, partial
from itertools import islice
from queue import SimpleQueue
from threading import Thread
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from voodoo_jax.batch.log_job import Job, do_job
from voodoo_jax.batch.outcome import Outcome
from voodoo_jax.batch.process_pool import Report, Results
from voodoo_jax.compile.executable import count_waiting, seconds_of_waiting
from voodoo_jax.compile.xla_options import quickly
from voodoo_jax.kernels.correspondences import Points
from voodoo_jax.kernels.landmarks import Features
from voodoo_jax.model.body import Body
from voodoo_jax.solve.scan import (
    NOBODY,
    State,
    Step,
    TrackOptions,
    Visit,
    Visits,
    covariances_of,
    track_frame,
    track_visits,
)
from voodoo_jax.storage.cores import take_turns

T = TypeVar("T")
Ask = Callable[..., Any]  # waits for the answer
Answer = Callable[[list[tuple]], list[Any]]  # what some tasks ask for -> their answers
LANES = 32  # on each device that is no processor, unless told otherwise


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
        take_turns()
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


def in_batch(jobs: list[Job], report: Report) -> Results:
    """Runs the jobs. Yields number and outcome of each when it is finished; logs are read in turns, on one core."""

    def task(number: int, job: Job) -> Callable[[Visit], Outcome]:
        return lambda visit: do_job(job, lambda share: report(number, share), visit)

    tasks = [task(number, job) for number, job in enumerate(jobs)]
    # as many lanes however few logs there are: what one gets must not depend on it
    with closing(in_lanes(tasks, usual_lanes())) as results:
        yield from results


def usual_lanes() -> int:
    """How many recordings to track at once, the same number on each device."""
    return len(jax.devices()) * (1 if jax.default_backend() == "cpu" else LANES)


def in_lanes(tasks: Sequence[Callable[[Visit], T]], lanes: int) -> Generator[tuple[int, T]]:
    """Yields number and result of each finished task, with `lanes` of them at once; each task gets a function that
    replaces `track_visits`. Raises what a task raises."""

    def answer(asked: list[tuple]) -> list[Any]:
        before = seconds_of_waiting()
        found = visit_lanes(asked, lanes)
        return [(each, seconds_of_waiting() - before) for each in found]

    def visit(ask: Ask, *args: Any) -> tuple[State, Step]:
        found, compiling = ask(*args)
        count_waiting(compiling)
        return found

    return in_turns([lambda ask, task=task: task(partial(visit, ask)) for task in tasks], lanes, answer)


def visit_lanes(asked: list[tuple], lanes: int) -> list[tuple[State, Step]]:
    """What `track_visits(*each)` returns for each `asked`, on the host: at once those (up to `lanes`) of equal shapes.

    Fewer are run as if there were `lanes` of them: one program for any number, and what one gets does not depend on the
    others.
    """
    alike: dict[Any, list[int]] = {}
    for number, each in enumerate(asked):
        leaves, form = jax.tree.flatten(each)
        alike.setdefault((form, tuple((x.shape, str(x.dtype)) for x in leaves)), []).append(number)
    out: dict[int, tuple[State, Step]] = {}
    for numbers in alike.values():
        mine = [asked[number] for number in numbers]
        idle = (*mine[0][:5], mine[0][5]._replace(track=np.full_like(mine[0][5].track, NOBODY)), *mine[0][6:])
        stacked = jax.tree.map(
            lambda *x: np.stack([np.asarray(each) for each in x]), *mine, *[idle] * (lanes - len(mine))
        )
        found = jax.tree.map(np.asarray, program_of(jax.default_backend() != "cpu")(*stacked))
        out |= {number: jax.tree.map(lambda x, k=k: x[k], found) for k, number in enumerate(numbers)}
    return [out[number] for number in range(len(asked))]


@cache
def program_of(lockstep: bool) -> Any:
    """Lanes of each device in step, or one after the other: on a processor, where a lane in step waits for the slowest
    and gains nothing."""
    mesh = Mesh(np.array(jax.devices()), ("lane",))
    here = in_lockstep if lockstep else one_by_one
    spec = PartitionSpec("lane")
    # around all of it, so that each device's loops end by themselves (docs/numerics.md#sharding)
    return quickly(jax.shard_map(here, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False))


def one_by_one(*asked: Any) -> tuple[State, Step]:
    """As track_visits, all arguments and results with a leading lane axis."""
    return jax.lax.map(lambda mine: track_visits.function(*mine), asked)


# 7 parameters: those of the program that it stands for
def in_lockstep(
    body: Body,
    options: TrackOptions,
    states: State,
    points: Points,
    seconds: jax.Array,
    visits: Visits,
    features: Features | None = None,
) -> tuple[State, Step]:
    """As track_visits, all arguments and results with a leading lane axis: one visit of every lane at a time."""

    def one(body, options, states, measured, visit):
        frame, track = visit
        busy = track != NOBODY
        points, seconds, features = jax.tree.map(lambda x: x[frame], measured)
        # without measurements a frame is done in two steps: who has nothing to do keeps nobody waiting
        # (docs/numerics.md#slowest)
        points = eqx.tree_at(lambda p: p.weight, points, jnp.where(busy, points.weight, 0.0))
        if features is not None:
            features = eqx.tree_at(lambda f: f.weight, features, jnp.where(busy, features.weight, 0.0))
        state = jax.tree.map(lambda x: x[track], states)
        after, *out = track_frame(body, options, state, points, seconds, features)
        after = jax.tree.map(partial(jnp.where, busy), after, state)
        return jax.tree.map(lambda x, new: x.at[track].set(new), states, after), out

    def turn(states, visit):
        tracked = lambda: jax.vmap(one)(body, options, states, (points, seconds, features), visit)  # noqa: E731
        nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(tracked)[1])
        return jax.lax.cond(jnp.any(visit[1] != NOBODY), tracked, lambda: (states, nothing))

    by_turn = visits.frame.T, visits.track.T
    states, (steps, normals) = jax.lax.scan(turn, states, by_turn)
    steps, normals = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), (steps, normals))
    # the same branch for all lanes, or it were none
    wanted = jax.vmap(covariances_of, (0, 0, 0, None))(body, options, normals, jnp.any(visits.sure))
    found = jnp.where(visits.sure[:, None, None, None, None], wanted, 0.0)
    return states, steps._replace(covariance=found)
