"""What a log may ask of a Ray cluster."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RayTasks:
    """Resources of each log on the cluster, and the number of restarts after its process or machine was lost."""

    num_cpus: int = 1
    num_gpus: float = 0.0  # below 1: a share of one; 0: processors compute
    retries: int = 1


def check_ray_tasks(tasks: RayTasks) -> None:
    """Raises ValueError for resources that are impossible."""
    if tasks.num_cpus < 1:
        raise ValueError(f"--ray-cpus {tasks.num_cpus}: must be 1 or more")
    if tasks.num_gpus < 0 or (tasks.num_gpus > 1 and not float(tasks.num_gpus).is_integer()):
        raise ValueError(f"--ray-gpus {tasks.num_gpus:g}: must be a share of one GPU (0 to 1), or a whole number")
    if tasks.retries < 0:
        raise ValueError(f"--ray-retries {tasks.retries}: must not be negative")
