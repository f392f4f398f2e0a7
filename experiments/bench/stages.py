"""Where the time goes: stages of a step and of a replay, and how a step scales: python -m experiments.bench.stages

Stages of a step are nested, each program does what the one before does and more; the difference is the stage. Programs
run in turns on one core (where the system lets choose). Scaling: frames per second against points, steps, limbs and
streams at once, and with weights of points that differ, one thing changed at a time from 1,000 points, 6 steps, 10
limbs, 1 stream, equal weights.
"""

import json
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import tyro

from experiments.bench.peers import library
from experiments.bench.replay_speed import machine
from experiments.bench.work import STEPS, Work, from_demo, load, with_limbs
from experiments.common import DEMO, human, log_files, table, write
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.exporters.foxglove import write_tracks_mcap
from voodoo_jax.exporters.npz import write_tracks_npz
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.kernels.correspondences import closest_limbs, match, moments
from voodoo_jax.kernels.points import Points
from voodoo_jax.solve.frame import icp_step
from voodoo_jax.solve.padding import bucket, pad_frames
from voodoo_jax.solve.pulls import Problem, adjacency
from voodoo_jax.trackers.base import LogInfo, Task
from voodoo_jax.trackers.of_points import track_person

REPEATS = 20  # of a stage inside one program


def _matched(poses: Poses, problem: Problem):
    body = problem.body
    return match(body.sizes, poses, problem.points, adjacency(body.topology), problem.options.match, body.present)


STAGES: dict[str, Callable] = {
    "gates and nearest limb": lambda poses, p: closest_limbs(
        p.body.sizes, poses, p.points, p.options.match, p.body.present
    ),
    "closest points": _matched,
    "moments": lambda poses, p: moments(_matched(poses, p))[0],
    "bands and solve": lambda poses, p: icp_step(poses, p)[0],
}


def stage_times(work: Work, points: int, streams: int, turns: int) -> dict[str, float]:
    """Microseconds of each stage, a step of one frame."""
    given = library.body_of(work), library.links_of(work), library.options("per_limb", points)
    starts = jax.tree.map(lambda x: jnp.repeat(x[None], streams, 0), library.start_of(work))
    rest = jnp.ones(points), jnp.zeros(points, jnp.int32), jnp.zeros((1, 3))

    def program(stage: Callable):
        def one(given, poses, cloud):
            body, links, icp = given
            return stage(poses, Problem(body, links, Points(cloud.T, *rest), None, poses, icp))

        def many(given, poses, clouds):
            def again(_, poses):
                found = jax.vmap(one, (None, 0, 0))(given, poses, clouds)
                # the next turn depends on this one, or the compiler would do only one
                touch = sum(jnp.float32(x.reshape(-1)[0]) for x in jax.tree.leaves(found))
                return jax.tree.map(lambda x: x + 1e-30 * touch, poses)

            return jax.lax.fori_loop(0, REPEATS, again, poses)

        clouds = jnp.asarray(work.frames(points)[:streams])
        compiled = jax.jit(many).lower(given, starts, clouds).compile()
        return lambda: jax.block_until_ready(compiled(given, starts, clouds))

    programs = {name: program(stage) for name, stage in STAGES.items()}
    best = {name: float("inf") for name in programs}
    for _ in range(turns):
        for name, run in programs.items():
            begin = time.perf_counter()
            run()
            best[name] = min(best[name], 1e6 * (time.perf_counter() - begin) / REPEATS / streams)
    ends = [0.0, *best.values()]
    return {name: after - before for name, before, after in zip(best, ends, ends[1:])}


def replay_times(log: Path) -> dict[str, float]:
    """Seconds of the stages of one replay, everything compiled before."""
    body, settings, found = human(), Settings(), {}

    def timed(name: str, work: Callable):
        begin = time.perf_counter()
        result = work()
        found[name] = time.perf_counter() - begin
        return result

    reader = open_log(log, settings.read)
    frames = timed("read", lambda: list(reader.frames()))
    scene, people = timed("find the person", lambda: find_body(frames, reader.up, body, settings))
    most = max(len(p.points) for p in people)
    timed("pad", lambda: pad_frames(people, bucket(most), len(people), None, len(people[0].origins)))
    track = lambda: track_person(Task(body, LogInfo(reader.path, reader.fixed_frame), settings), scene, people)  # noqa: E731
    timed("start and track, first time", track)
    tracks = timed("start and track, both ways", track)
    with tempfile.TemporaryDirectory() as folder:
        timed("write npz", lambda: write_tracks_npz(tracks, Path(folder) / "a.npz"))
        timed("write mcap", lambda: write_tracks_mcap(tracks, Path(folder) / "a.mcap"))
    return found


USUAL = {"points": 1000, "steps": STEPS, "limbs": 10, "streams": 1, "weights": 1}
VALUES = {  # points: those of the work
    "points": (), "steps": (1, 3, 6, 12), "limbs": (5, 10, 20), "streams": (1, 4, 16, 32), "weights": (1, 10, 1000),
}  # fmt: skip


def scaling(work: Work, turns: int) -> list[list[str]]:
    """Rows: what is changed, its value, frames per second (best), seconds to compile."""
    values: dict[str, tuple[int, ...]] = VALUES | {"points": tuple(work.points)}
    rows, known = [], {}
    for what, value in [(what, value) for what, some in values.items() for value in some]:
        case = USUAL | {what: value}
        key = tuple(case.values())
        if key not in known:  # the usual one is in every row
            known[key] = rate(work, case, turns)
        fps, compile_s = known[key]
        rows.append([what, f"{value}", f"{fps:.0f}", f"{compile_s:.1f}"])
    return rows


def rate(work: Work, case: dict[str, int], turns: int) -> tuple[float, float]:
    """Frames per second (best) and seconds to compile of one case."""
    begin = time.perf_counter()
    given, spread = with_limbs(work, case["limbs"]), float(case["weights"])
    run = library.build(given, case["points"], streams=case["streams"], steps=case["steps"], spread=spread)
    run()
    first, best = time.perf_counter() - begin, float("inf")
    for _ in range(turns):
        begin = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - begin)
    return len(work.frames(case["points"])) * case["streams"] / best, first - best


TITLES = {
    "points": "points of a frame", "steps": "steps of a frame", "limbs": "limbs",
    "streams": "recordings at once", "weights": "heaviest weight over lightest",
}  # fmt: skip


def plot(rows: list[list[str]], where: Path, title: str) -> None:
    """What a round of frames costs, one frame of each recording, over what is changed; dashed: in proportion to it."""
    figure, axes = plt.subplots(1, len(VALUES), figsize=(15, 3.4), layout="constrained", sharey=True)
    for axis, (what, label) in zip(axes, TITLES.items()):
        mine = [(float(value), float(fps)) for name, value, fps, _ in rows if name == what]
        x = [value for value, _ in mine]
        cost = [1e6 / fps * (value if what == "streams" else 1) for value, fps in mine]
        axis.plot(x, cost, "o-")
        if what != "weights":
            axis.plot(x, [cost[0] * value / x[0] for value in x], "--", color="grey", label="in proportion")
        axis.set(xscale="log", yscale="log", xlabel=label)
        axis.set_xticks(x, [f"{value:g}" for value in x])
        axis.minorticks_off()
        axis.grid(True, alpha=0.3)
    axes[0].set_ylabel("microseconds a round")
    axes[0].legend(fontsize=8)
    figure.suptitle(title, fontsize=9)
    figure.savefig(where, dpi=100)
    plt.close(figure)


def main(
    work: tyro.conf.Positional[Path | None] = None, turns: int = 15, out: Path = Path(__file__).parent / "out"
) -> None:
    """Prints tables and writes stages.md, stages.json and scaling.png.

    Args:
        work: arrays of the work; none: made from the demo recording.
        turns: runs of each program, the best counts.
        out: folder for results.
    """
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    info, given = machine(), load(work) if work else from_demo()
    stages = {
        f"{n} points, {b} at once": stage_times(given, n, b, turns) for n, b in ((1000, 1), (2000, 1), (1000, 16))
    }
    replay, rows = replay_times(log_files(DEMO)[0]), scaling(given, turns)
    parts = [
        table(["microseconds a step", *STAGES, "all"],
              [[name, *(f"{v:.1f}" for v in t.values()), f"{sum(t.values()):.1f}"] for name, t in stages.items()]),
        table(["replay of the demo recording", "seconds"], [[k, f"{v:.2f}"] for k, v in replay.items()]),
        table(["changed", "to", "frames/s", "compile, s"], rows),
        f"One core of {info['cpu']}, load average {info['load_1min']}, jax {info['jax']}.",
    ]  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    write(out, "stages", "\n\n".join(parts))
    one_core = f"one core of {info['cpu']}, limb by limb; else 1,000 points, 6 steps, 10 limbs, 1 recording"
    plot(rows, out / "scaling.png", f"What a round costs, one frame of each recording ({one_core})")
    result = {"machine": info, "stages": stages, "replay": replay, "scaling": rows}
    (out / "stages.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
