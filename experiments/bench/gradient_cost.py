"""What a derivative costs: python -m experiments.bench.gradient_cost

Time of value and gradient, by all sizes and band weights of the body, over the time of the value alone: with the
implicit solution, and with unrolled checkpointed steps. Frames of the demo recording, one after the other.
"""

import time
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments.common import DEMO, human, load_log, log_files, table, write
from voodoo_jax.batch import bucket, pad_frames
from voodoo_jax.body import Body
from voodoo_jax.fit_solution import solution
from voodoo_jax.icp import Problem, solve_frame
from voodoo_jax.kernels.correspond import Points
from voodoo_jax.pose import Poses
from voodoo_jax.settings import Settings, SolveSettings
from voodoo_jax.tracking import options_from


def main(
    points: int = 1000, frames: int = 8, steps: int = 15, turns: int = 7, out: Path = Path(__file__).parent
) -> None:
    """Milliseconds a frame, and ratios.

    Args:
        points: points of a frame.
        frames: frames that are solved one after the other.
        steps: ICP steps of every frame.
        turns: the median of so many runs counts.
        out: folder for gradient_cost.md.
    """
    settings = Settings()
    log = load_log(log_files(DEMO)[0], human(), settings)
    tracks = log.track(human(), settings)
    at = np.flatnonzero(tracks.tracked)[3 :: len(tracks.time_ns) // (frames + 1)][:frames]
    seen = [log.people[i] for i in at]
    cloud = pad_frames(seen, bucket(points), len(at), None, len(seen[0].origins), points).points
    poses = Poses(jnp.asarray(tracks.rotation[at]), jnp.asarray(tracks.translation[at]))
    solve = SolveSettings(max_steps=steps, epsilon=0.0)
    options = options_from(solve, settings.track).icp

    def problem(body: Body, points: Points, pose: Poses) -> Problem:
        return Problem.build(body, points, pose, options)

    ways: dict[str, Callable[[Body, Points, Poses], Poses]] = {
        "implicit": lambda b, x, p: solution(p, problem(b, x, p)).poses,
        "unrolled, checkpointed": lambda b, x, p: solve_frame(p, problem(b, x, p), "checkpointed", steps).poses,
    }
    rows = []
    for name, way in ways.items():

        def loss(parts, way=way):
            body = eqx.tree_at(lambda b: (b.sizes, b.weights), tracks.body, parts)
            found = jax.lax.map(lambda frame: way(body, *frame), (cloud, poses))
            return jnp.sum(found.translation**2)

        parts = tracks.body.sizes, tracks.body.weights
        value, both = _seconds(jax.jit(loss), parts, turns), _seconds(jax.jit(jax.value_and_grad(loss)), parts, turns)
        rows.append([name, f"{1e3 * value / len(at):.2f}", f"{1e3 * both / len(at):.2f}", f"{both / value:.2f}"])
    head = ["way", "value, ms a frame", "value and gradient, ms a frame", "ratio"]
    write(out, "gradient_cost", f"{points} points, {steps} steps.\n\n" + table(head, rows))


def _seconds(function: Callable, parts, turns: int) -> float:
    """Median time of a run, after one that compiles."""
    jax.block_until_ready(function(parts))
    times = []
    for _ in range(turns):
        began = time.perf_counter()
        jax.block_until_ready(function(parts))
        times.append(time.perf_counter() - began)
    return float(np.median(times))


if __name__ == "__main__":
    tyro.cli(main)
