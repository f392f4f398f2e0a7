"""A cluster of two machines, one of which is lost: python -m tests.support.ray_of_two OUT LOG ... says what was heard.

In a process of its own: Ray leaves threads and handlers behind.
"""

import json
import os
import sys
import tempfile
import time
from pathlib import Path

from ray.cluster_utils import Cluster

from tests.support.small_logs import SETTINGS, small_body
from voodoo_jax.batch import ray_cluster
from voodoo_jax.batch.replay import replay
from voodoo_jax.config.ray_tasks import RayTasks


def main(out: str, logs: list[str], gate: Path) -> None:
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    other = cluster.add_node(num_cpus=1, num_gpus=1)  # a number of Ray's own, no device
    os.environ["RAY_ADDRESS"] = cluster.address
    heard: list[tuple[int, float]] = []
    on_ray, both = ray_cluster.on_ray, set()

    def spied(jobs, report, tasks):
        def listen(number: int, share: float) -> None:
            heard.append((number, share))
            both.add(number)
            if len(both) == 2 and cluster.worker_nodes:  # both machines have said something
                cluster.remove_node(other, allow_graceful=False)
            if share == 0:  # the loss was noticed
                gate.touch()
            report(number, share)

        return on_ray(jobs, listen, tasks)

    ray_cluster.on_ray = spied
    ray_cluster.follow_log = held_until(gate)
    done = replay(logs, out, small_body(), SETTINGS, quiet=True, engine="ray", ray=RayTasks(retries=1))
    print(json.dumps({"heard": heard, "errors": [outcome.error for outcome in done]}))
    cluster.shutdown()


def held_until(gate: Path):
    """The task of a log that says how far it is and waits for `gate`: else it may be done before the machine is lost.

    It takes the task anew where it runs: what is replaced in a module here is not replaced on the cluster's machines.
    """

    def held(job, number, board):
        from voodoo_jax.batch.ray_cluster import follow_log

        while not gate.exists():
            board.say.remote(number, 0.5)
            time.sleep(0.1)
        return follow_log(job, number, board)

    return held


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        main(sys.argv[1], sys.argv[2:], Path(folder) / "lost")
