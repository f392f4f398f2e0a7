"""What a derivative costs: python -m experiments.bench.gradient_cost

Time of value and gradient, by all sizes and band weights of the body, over the time of the value alone: with the
implicit solution, and with unrolled steps that keep for the way back their poses alone, as the library does, or all
that autodiff asks for. Frames of the demo recording, one after the other, all in turns.
"""

import os
import time
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments.common import DEMO, human, load_log, log_files, table, write
from voodoo_jax.config.options import Settings, SolveSettings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.solve.frame import icp_step, solve_frame
from voodoo_jax.solve.implicit import solution
from voodoo_jax.solve.padding import bucket, pad_frames
from voodoo_jax.solve.pulls import Problem
from voodoo_jax.solve.scan import options_from

WAYS = IMPLICIT, CHECKPOINTED, _ = "implicit", "unrolled, checkpointed", "unrolled, all kept"
STEPS = (5, 15, 45)  # of which the memory is told


def main(
    points: int = 1000, frames: int = 8, steps: int = 15, turns: int = 15, out: Path = Path(__file__).parent
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
                if way == CHECKPOINTED:
                    return solve_frame(start, problem, "checkpointed", most).poses
                step = lambda poses, _: (icp_step(poses, problem)[0], None)  # noqa: E731
                return jax.lax.scan(step, start, length=most)[0]

            return jnp.sum(jax.lax.map(one, (cloud, poses)).translation ** 2)

        return loss

    def asked(most: int) -> tuple:
        return parts, options_from(SolveSettings(max_steps=most, epsilon=0.0), settings.track).icp

    def compiled(way: str, most: int, change: Callable):
        return jax.jit(change(loss_of(way, most))).lower(*asked(most)).compile()

    values = {way: compiled(way, steps, lambda loss: loss) for way in WAYS}
    both = {(way, most): compiled(way, most, jax.value_and_grad) for way in WAYS for most in {*STEPS, steps}}
    given, load = asked(steps), os.getloadavg()[0]
    programs = [run for way in WAYS for run in (values[way], both[way, steps])]
    seconds = _seconds([lambda run=run: run(*given) for run in programs], turns)
    rows = [
        [way, f"{1e3 * value / len(at):.2f}", f"{1e3 * all_ / len(at):.2f}", f"{all_ / value:.2f}"]
        for way, value, all_ in zip(WAYS, seconds[::2], seconds[1::2])
    ]
    head = ["way", "value, ms a frame", "value and gradient, ms a frame", "ratio"]
    memory = [[way, *(f"{_megabytes(both[way, most]):.2f}" for most in STEPS)] for way in WAYS]
    text = (
        f"{points} points, {steps} steps, medians of {turns} turns; load average {load:.1f} before them.\n\n"
        f"{table(head, rows)}\nMemory of value and gradient, MB:\n\n"
    )
    write(out, "gradient_cost", text + table(["way", *(f"{most} steps" for most in STEPS)], memory))


def _megabytes(program: jax.stages.Compiled) -> float:
    """What the compiled program needs beside arguments and results."""
    found = program.memory_analysis()
    return found.temp_size_in_bytes / 1e6 if found else float("nan")


def _seconds(programs: list[Callable], turns: int) -> list[float]:
    """Median time of each program's runs, after a first one; they run in turns, so that other work slows all alike."""
    times = [[] for _ in programs]
    for _ in range(turns + 1):
        for run, found in zip(programs, times):
            began = time.perf_counter()
            jax.block_until_ready(run())
            found.append(time.perf_counter() - began)
    return [float(np.median(found[1:])) for found in times]


if __name__ == "__main__":
    tyro.cli(main)
