"""Several logs at once in this process, tracked as one batch on all of JAX's devices: for GPUs, which one log leaves
idle most of the time."""

from collections.abc import Callable
from contextlib import closing

from voodoo_jax.batch.lanes import in_lanes, usual_lanes
from voodoo_jax.batch.log_job import Job, Visit, do_job
from voodoo_jax.batch.outcome import Outcome
from voodoo_jax.batch.process_pool import Report, Results


def in_batch(jobs: list[Job], report: Report) -> Results:
    """Runs the jobs. Yields number and outcome of each when it is finished; logs are read in turns, on one core."""

    def task(number: int, job: Job) -> Callable[[Visit], Outcome]:
        return lambda visit: do_job(job, lambda share: report(number, share), visit)

    tasks = [task(number, job) for number, job in enumerate(jobs)]
    # as many lanes however few logs there are: what one gets must not depend on it
    with closing(in_lanes(tasks, usual_lanes())) as results:
        yield from results
