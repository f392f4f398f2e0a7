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
from voodoo_jax.fit_solution import solution
from voodoo_jax.icp import Problem, solve_frame
from voodoo_jax.pose import Poses
from voodoo_jax.settings import Settings, SolveSettings
from voodoo_jax.tracking import options_from

IMPLICIT, UNROLLED = "implicit", "unrolled, checkpointed"
STEPS = (5, 15, 45)  # of which the memory is told


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
    parts = tracks.body.sizes, tracks.body.weights

    def loss_of(way: str, most: int) -> Callable:
        # the options are arguments, as everywhere: what is known beforehand the compiler folds, and repeats the match
        def loss(parts, options):
            body = eqx.tree_at(lambda b: (b.sizes, b.weights), tracks.body, parts)

            def one(frame):
                seen, start = frame
                problem = Problem.build(body, seen, start, options)
                if way == IMPLICIT:
                    return solution(start, problem).poses
                return solve_frame(start, problem, "checkpointed", most).poses

            return jnp.sum(jax.lax.map(one, (cloud, poses)).translation ** 2)

        return loss

    def asked(most: int) -> tuple:
        return parts, options_from(SolveSettings(max_steps=most, epsilon=0.0), settings.track).icp

    rows = []
    for way in (IMPLICIT, UNROLLED):
        loss, given = loss_of(way, steps), asked(steps)
        value, both = _seconds(jax.jit(loss), given, turns), _seconds(jax.jit(jax.value_and_grad(loss)), given, turns)
        rows.append([way, f"{1e3 * value / len(at):.2f}", f"{1e3 * both / len(at):.2f}", f"{both / value:.2f}"])
    head = ["way", "value, ms a frame", "value and gradient, ms a frame", "ratio"]
    memory = [
        [way, *(f"{_megabytes(jax.value_and_grad(loss_of(way, most)), asked(most)):.2f}" for most in STEPS)]
        for way in (IMPLICIT, UNROLLED)
    ]
    text = f"{points} points, {steps} steps.\n\n{table(head, rows)}\nMemory of value and gradient, MB:\n\n"
    write(out, "gradient_cost", text + table(["way", *(f"{most} steps" for most in STEPS)], memory))


def _megabytes(function: Callable, given: tuple) -> float:
    """What the compiled program needs beside arguments and results."""
    found = jax.jit(function).lower(*given).compile().memory_analysis()
    return found.temp_size_in_bytes / 1e6 if found else float("nan")


def _seconds(function: Callable, given: tuple, turns: int) -> float:
    """Median time of a run, after one that compiles."""
    jax.block_until_ready(function(*given))
    times = []
    for _ in range(turns):
        began = time.perf_counter()
        jax.block_until_ready(function(*given))
        times.append(time.perf_counter() - began)
    return float(np.median(times))


if __name__ == "__main__":
    tyro.cli(main)
