"""Measures promises: all their jobs on a few processes, each job once."""

import math
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, NamedTuple

import jax
from tqdm import tqdm

from experiments.judged import sharing
from experiments.scoreboard.board import Data, Job, Measured, Promise

JOBS_BETWEEN = 40  # after so many a process forgets its compiled programs, some 20 MB each; they are kept on disk


_done: list[Job] = []  # of this process


class Done(NamedTuple):
    """What came of a job."""

    value: Any
    seconds: float
    problem: str  # empty: none


def outcome_of(job: Job) -> Done:
    began = time.perf_counter()
    try:
        value, problem = sharing(lambda one: one.run(), job), ""
    except Exception as error:  # one job that fails costs its promises only
        value, problem = None, f"{type(error).__name__}: {error}"
        traceback.print_exc()
    _done.append(job)
    if len(_done) % JOBS_BETWEEN == 0:
        jax.clear_caches()
    return Done(value, time.perf_counter() - began, problem)


def outcomes_of(jobs: list[Job], processes: int, title: str) -> dict[Job, Done]:
    """Outcomes of all jobs, the long ones first so that both cores are busy to the end."""
    jobs = sorted(jobs, key=lambda job: -getattr(job, "seconds", 1.0))
    done: dict[Job, Done] = {}
    if not jobs:
        return done
    # not with max_tasks_per_child: Python 3.11 and 3.12 may wait for ever once all processes have done so many
    pool = ProcessPoolExecutor(min(processes, len(jobs)), get_context("spawn"))
    with pool, tqdm(total=len(jobs), desc=title, unit="job", disable=None) as bar:
        waiting: dict[Future[Done], Job] = {pool.submit(outcome_of, job): job for job in jobs}
        for future in as_completed(waiting):
            done[waiting[future]] = future.result()
            bar.update(1)
    return done


def measure(promises: Sequence[Promise], data: Data, processes: int) -> list[Measured]:
    """What is found for each promise. Those about time and memory are measured after the others, one job at a time."""
    wanted = {p.name: list(p.jobs(data)) for p in promises}
    beside = list(dict.fromkeys(job for p in promises if not p.alone for job in wanted[p.name]))
    done = outcomes_of(beside, processes, "scoreboard")
    for p in promises:
        if p.alone:
            began = time.perf_counter()
            done |= outcomes_of([job for job in wanted[p.name] if job not in done], 1, p.name)
            print(f"{p.name}: done after {time.perf_counter() - began:.0f} s", flush=True)  # of some that take minutes
    return [_measured(p, [done[job] for job in wanted[p.name]], data.quick) for p in promises]


def _measured(promise: Promise, done: list[Done], quick: bool) -> Measured:
    seconds = sum(d.seconds for d in done)
    if not done:
        return Measured(promise, {}, 0.0, f"left out: {'takes too long for --quick, or ' * quick}no {promise.data}")
    if bad := next((d.problem for d in done if d.problem), ""):
        return Measured(promise, {f.name: math.nan for f in promise.figures}, seconds, bad)
    outcomes = [d.value for d in done]
    values = promise.measure(outcomes)
    if missing := {f.name for f in promise.figures} - values.keys():
        raise ValueError(f"promise '{promise.name}' has no value for {', '.join(sorted(missing))}")
    details = () if promise.details is None else tuple(promise.details(outcomes))
    return Measured(promise, {f.name: float(values[f.name]) for f in promise.figures}, seconds, details=details)
