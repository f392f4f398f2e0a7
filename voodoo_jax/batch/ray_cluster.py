"""Many logs on a Ray cluster: the same function for each log, as one task on one core."""

import warnings
from typing import Any

from voodoo_jax.batch.log_job import Job, do_job
from voodoo_jax.batch.outcome import Outcome
from voodoo_jax.batch.process_pool import Report, Results

RAY_HELP = (
    '--engine ray needs the package ray: pip install "voodoo_jax[ray]", here and on every machine of the cluster; '
    "or use --engine local"
)


def on_ray(jobs: list[Job], report: Report) -> Results:
    """Does the jobs on the cluster that RAY_ADDRESS names or that runs here already, else on one started here.

    Gives number and outcome of each as it is done; tasks that are left are cancelled when the iterator is closed or
    interrupted. Logs and results must be at the same paths or URLs on all machines. `report` is told when a log is done
    only. Raises ValueError if ray is missing or no cluster answers.
    """
    ray = _ray()
    mine = not ray.is_initialized()
    if mine:
        try:
            with warnings.catch_warnings():  # Ray starts programs by fork and exec at once, which jax need not fear
                warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
                ray.init(log_to_driver=False, logging_level="ERROR", configure_logging=False)
        except (ConnectionError, RuntimeError) as problem:
            raise ValueError(
                f"--engine ray: no cluster answers: {problem}. Look at RAY_ADDRESS and `ray status`"
            ) from (problem)
    # one core each, and no second try: what has crashed once would crash again
    environment = {"env_vars": {"PJRT_NPROC": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}}
    task = ray.remote(num_cpus=1, max_retries=0, runtime_env=environment)(do_job)
    numbers: dict[Any, int] = {task.remote(job): number for number, job in enumerate(jobs)}
    try:
        while numbers:
            (done, *_), _ = ray.wait(list(numbers))
            number = numbers.pop(done)
            try:
                outcome = ray.get(done)
            except ray.exceptions.RayError as problem:
                outcome = Outcome(jobs[number].log, error=_lost(problem))
            report(number, 1.0)
            yield number, outcome
    finally:
        for left in numbers:
            ray.cancel(left, force=True)
        if mine:
            ray.shutdown()


def _ray() -> Any:
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError as problem:
        raise ValueError(RAY_HELP) from problem
    return ray


def _lost(problem: Exception) -> str:
    """Why there is no answer, and what to try."""
    first = (str(problem).strip().splitlines() or [""])[0]
    return (
        f"its Ray task was lost: {type(problem).__name__}: {first} If the machine ran out of memory, give tasks more "
        "room; if the package is missing or older there, install the same version on all machines."
    )
