"""Several logs at once in this process, tracked as one batch on all of JAX's devices: for GPUs, which one log leaves
idle most of the time."""

from contextlib import closing

from voodoo_jax.jobs import Job, do_job
from voodoo_jax.lanes import usual_lanes, visit_lanes
from voodoo_jax.turns import in_turns
from voodoo_jax.workers import Report, Results


def in_batch(jobs: list[Job], report: Report) -> Results:
    """Does the jobs. Gives number and outcome of each as it is done; they are read in turns, on one core."""
    lanes = usual_lanes()  # however few logs there are: what one gets must not depend on it

    def task(number: int, job: Job):
        return lambda ask: do_job(job, lambda share: report(number, share), ask)

    tasks = [task(number, job) for number, job in enumerate(jobs)]
    with closing(in_turns(tasks, lanes, lambda asked: visit_lanes(asked, lanes))) as results:
        yield from results
