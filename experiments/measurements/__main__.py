"""Time over the number of measurements (Knoop 2007, Fig. 9): python -m experiments.measurements [RECORDINGS]

One recording, the tracking scan with exactly so many points a frame and so many ICP steps, everything compiled,
contenders in turns, median. Weights of 1, of 10, and random ones: time must not depend on them (2007, sec. 6). Then
features beside the points. Writes measurements.md and measurements.png.
"""

import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

# one core: else the compiler splits long arrays over the cores and short ones not, which is no line
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import equinox as eqx
import jax
import matplotlib.pyplot as plt
import numpy as np
import tyro

from experiments.bench.replay_speed import Case, Started, machine
from experiments.common import (
    DEMO,
    human,
    line_fit,
    load_log,
    machine_line,
    pick,
    rounds,
    started,
    table,
    write,
)  # fmt: skip
from voodoo_jax.config.options import Settings
from voodoo_jax.kernels.correspondences import Points
from voodoo_jax.kernels.landmarks import Features
from voodoo_jax.records.recording import Pairs, Rays
from voodoo_jax.solve.names import FeatureNames
from voodoo_jax.solve.padding import FEATURE_BUCKETS, bucket, pad_features
from voodoo_jax.solve.scan import track_chunk

WEIGHTS = ("1", "10", "random")


def runner(case: Case, points: Points, features: Features | None = None) -> Callable[[], float]:
    """Runs a case with other measurements; wall time in seconds."""

    def run() -> float:
        begin = time.perf_counter()
        inputs = (case.body, case.options, case.state, points, case.seconds, case.valid, features)
        jax.block_until_ready(track_chunk(*inputs)[1])
        return time.perf_counter() - begin

    return run


def weighted(points: Points, weights: str) -> Points:
    """The points with all weights times 10, or times random numbers from 0.1 to 10."""
    random = 10 ** np.random.default_rng(0).uniform(-1, 1, points.weight.shape).astype(np.float32)
    factor = {"1": 1.0, "10": 10.0, "random": random}[weights]
    return eqx.tree_at(lambda p: p.weight, points, points.weight * factor)


def some_features(begin: Started, count: int) -> Features | None:
    """`count` named points a frame, on the tracked joints; a joint may come several times."""
    topology, joints = begin.tracks.body.topology, begin.tracks.joints
    chosen = np.arange(count) % joints.shape[1]
    names = tuple(topology.centres[i] for i in chosen)
    people = [replace(f, rays=Rays(), pairs=Pairs(names, now[chosen])) for f, now in zip(begin.frames, joints)]
    names_of_body = FeatureNames(topology, Settings().features)
    return pad_features(people, len(people), bucket(count, FEATURE_BUCKETS), names_of_body)


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    log: str = "bow-wave-15s",
    points: tuple[int, ...] = (128, 256, 512, 1024, 2048, 4096),
    features: tuple[int, ...] = (0, 8, 56),
    steps: int = 6,
    turns: int = 7,
    frames: int = 0,
    out: Path = Path(__file__).parent,
) -> None:
    """Time per frame by number of measurements.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        log: recording to take; if it is not there, the first.
        points: points per frame; the capacity is the same number.
        features: named 3D points per frame, beside 1024 points or the last number of points.
        steps: ICP steps per frame, all of which are taken.
        turns: rounds over all contenders; medians are reported.
        frames: cut the recording after so many frames; 0: whole.
        out: folder for measurements.md and measurements.png.
    """
    before, body, base = machine(), human(), Settings()
    recording = load_log(pick(recordings, log), body, base, frames)
    settings = replace(base, solve=replace(base.solve, max_steps=steps, epsilon=0.0))
    begin = started(recording, body, base)
    contenders, beside = {}, 1024 if 1024 in points else points[-1]
    for count in points:
        case = Case(begin, settings, count)
        for weights in WEIGHTS:
            contenders[weights, count] = runner(case, weighted(case.chunk.points, weights))
        if count == beside:
            for number in features:
                contenders["features", number] = runner(case, case.chunk.points, some_features(begin, number))
    millis = {key: 1000 * t / len(begin.frames) for key, t in rounds(contenders, turns).items()}

    figure, (panel, few) = plt.subplots(1, 2, figsize=(9, 3.6), width_ratios=(2, 1), layout="constrained")
    slope, start, fit = line_fit(list(points), [millis["1", n] for n in points])
    for weights, marker in zip(WEIGHTS, "o+x"):
        panel.plot(points, [millis[weights, n] for n in points], marker, label=f"weights {weights}")
    label = f"{start:.2f} ms + {1000 * slope:.2f} ms per 1000 points, $R^2$ {fit:.4f}"
    panel.plot(points, start + slope * np.array(points), "-", lw=1, color="0.4", label=label)
    panel.set(xlabel="points per frame", ylabel="time per frame, ms", ylim=(0, None))
    few.bar([str(n) for n in features], [millis["features", n] for n in features])
    few.set(xlabel=f"features per frame\n(beside {beside} points)", ylabel="time per frame, ms")
    panel.legend(fontsize=8)
    for axes in (panel, few):
        axes.grid(True, alpha=0.3)
    figure.suptitle(f"{recording.name}, {steps} steps a frame", fontsize=9)

    rows = [[str(n), *(f"{millis[w, n]:.3f}" for w in WEIGHTS)] for n in points]
    text = table(["points", *(f"weights {w}, ms" for w in WEIGHTS)], rows, 0)
    text += (
        f"\nTime per frame = {start:.3f} ms + {1000 * slope:.3f} ms per 1000 points, R^2 {fit:.5f}; {steps} steps.\n"
    )
    rows = [[str(n), f"{millis['features', n]:.3f}"] for n in features]
    text += "\n" + table([f"features beside {beside} points", "time per frame, ms"], rows, 0)
    write(out, "measurements", f"{text}\n{machine_line(before)}", figure)


if __name__ == "__main__":
    tyro.cli(main)
