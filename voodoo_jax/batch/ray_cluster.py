"""Many logs on a Ray cluster: the same function for each log, as one task."""

import os
import sys
import time
import warnings
from collections import deque
from pathlib import Path
from typing import Any

from tqdm.auto import tqdm

from voodoo_jax.batch.log_job import Job, do_job, output_places, remove_partials
from voodoo_jax.batch.outcome import Outcome
from voodoo_jax.batch.process_pool import Report, Results
from voodoo_jax.batch.worker_start import environment
from voodoo_jax.config.ray_tasks import RayTasks
from voodoo_jax.records.notes import shown

RAY_HELP = (
    '--engine ray needs the package ray: pip install "voodoo_jax[ray]", here and on every machine of the cluster; '
    "or use --engine local"
)
PERIOD = 1.0  # seconds between two words on progress, of a task and to the caller; by hand
SUBMITTED = 1000  # tasks that Ray holds at once: it gets machines for what waits, and goes through all; by hand


def on_ray(jobs: list[Job], report: Report, tasks: RayTasks) -> Results:
    """Runs the jobs on the cluster that RAY_ADDRESS names or that runs here already, else on one started here.

    Yields number and outcome of each finished job; closing or interrupting the iterator cancels the others. Logs and
    results must be at the same paths or URLs on all machines. `report` receives the progress of each job, and 0 when a
    job restarts because its process or machine was lost; `tasks` limits the number of restarts. Raises ValueError if
    ray is missing or no cluster answers.
    """
    ray = _ray()
    mine = not ray.is_initialized()
    if mine:
        try:
            with warnings.catch_warnings():  # Ray starts programs by fork and exec at once, which jax need not fear
                warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
                _join_or_start(ray, log_to_driver=False, logging_level="ERROR", configure_logging=False)
        except (ConnectionError, RuntimeError) as problem:
            raise ValueError(f"--engine ray: no cluster responds: {problem}. Check RAY_ADDRESS and `ray status`") from (
                problem
            )
    running: dict[Any, int] = {}
    try:
        say_what_lacks(ray, tasks)
        yield from done_on(ray, jobs, report, tasks, running)
    finally:
        for left in running:
            ray.cancel(left, force=True)
        if mine:
            ray.shutdown()


def done_on(ray: Any, jobs: list[Job], report: Report, tasks: RayTasks, running: dict[Any, int]) -> Results:
    """Yields numbers and outcomes; `running` has the tasks that the cluster holds, each with the number of its job."""
    variables = environment(tasks.num_cpus) | ({} if tasks.num_gpus else {"JAX_PLATFORMS": "cpu"})
    # tries are counted here: Ray would begin a log anew without end whose machine has too little memory for it
    task = ray.remote(
        num_cpus=tasks.num_cpus, num_gpus=tasks.num_gpus, max_retries=0, runtime_env={"env_vars": variables}
    )(follow_log)
    board = ray.remote(num_cpus=0, max_restarts=-1)(Board).remote()
    waiting, losses, looked = deque(range(len(jobs))), [0] * len(jobs), time.monotonic()
    while waiting or running:
        while waiting and len(running) < SUBMITTED:
            number = waiting.popleft()
            named = task.options(name=f"voodoo-jax {Path(jobs[number].log).name}")
            running[named.remote(jobs[number], number, board)] = number
        done, _ = ray.wait(list(running), timeout=PERIOD)
        if time.monotonic() - looked >= PERIOD:
            looked = time.monotonic()
            for number, share in _news(ray, board, set(running.values())):
                report(number, share)
        for task_done in done:
            number = running.pop(task_done)
            try:
                outcome = ray.get(task_done)
            except ray.exceptions.RayError as problem:
                for place in output_places(jobs[number].log, jobs[number].out):
                    remove_partials(Path(place))
                losses[number] += 1
                if losses[number] <= tasks.retries:
                    waiting.append(number)
                    report(number, 0.0)
                    continue
                outcome = Outcome(jobs[number].log, error=_lost(problem, losses[number]))
            report(number, 1.0)
            yield number, outcome


class Board:
    """Progress of the logs: an actor to which the tasks of all machines report."""

    def __init__(self) -> None:
        self.shares: dict[int, float] = {}

    def say(self, number: int, share: float) -> None:
        self.shares[number] = share

    def news(self) -> dict[int, float]:
        """Messages since the last call."""
        said, self.shares = self.shares, {}
        return said


def follow_log(job: Job, number: int, board: Any) -> Outcome:
    """The task of one log; it reports its progress to the `board`, with its number."""
    said = -PERIOD

    def progress(share: float) -> None:
        nonlocal said
        if time.monotonic() - said >= PERIOD:
            said = time.monotonic()
            board.say.remote(number, share)

    return do_job(job, progress)


def _news(ray: Any, board: Any, running: set[int]) -> list[tuple[int, float]]:
    """Progress of running tasks; empty if the actor's machine was lost: it restarts on another."""
    try:
        said = ray.get(board.news.remote(), timeout=PERIOD)
    except ray.exceptions.RayError:
        return []
    return [(number, share) for number, share in said.items() if number in running]


def say_what_lacks(ray: Any, tasks: RayTasks) -> None:
    """Prints that no machine of the cluster has what a log asks for: Ray waits silently for one."""
    wanted = {name: n for name, n in (("CPU", tasks.num_cpus), ("GPU", tasks.num_gpus)) if n}
    machines = [machine["Resources"] for machine in ray.nodes() if machine["Alive"]]
    if not any(all(machine.get(name, 0) >= n for name, n in wanted.items()) for machine in machines):
        asked = " and ".join(f"{n:g} {name}" for name, n in wanted.items())
        text = f"--engine ray: no machine of the cluster has {asked} for a log (--ray-cpus, --ray-gpus)"
        tqdm.write(shown(f"{text}; waiting until one joins"), file=sys.stderr)


def _join_or_start(ray: Any, **options: Any) -> None:
    """Joins the cluster that RAY_ADDRESS names or that runs here; else starts one that is closed to the outside."""
    try:
        ray.init(address="auto", **options)
    except ConnectionError:
        if os.environ.get("RAY_ADDRESS"):
            raise
        ray.init(address="local", include_dashboard=False, _node_ip_address="127.0.0.1", **options)


def _ray() -> Any:
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError as problem:
        raise ValueError(RAY_HELP) from problem
    return ray


def _lost(problem: Exception, times: int) -> str:
    """Why there is no answer, and what to try."""
    first = (str(problem).strip().splitlines() or [""])[0]
    often = "its Ray task was lost" if times == 1 else f"its Ray task was lost {times} times, at last"
    return (
        f"{often}: {type(problem).__name__}: {first} If the machine ran out of memory, give tasks more room (more "
        "--ray-cpus); if the package is missing or older there, install the same version on all machines."
    )
