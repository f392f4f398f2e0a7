"""Frames per second of the tracking scan at several numbers of points, with the accuracy beside it.

    python experiments/bench/replay_speed.py [LOG.mcap ...] [--truth FILE] [--points 500 1000] [--solvers coupled]

Equal work for every row: exactly `--steps` ICP steps a frame (epsilon 0), every frame has exactly that many points: a
random choice, or above the sensor's own number copies with 2 mm jitter, seeded. The log is first replayed as the
product does it; size and first pose of every row come from there. Every row is run once to compile and then `--repeats`
times, in rounds over all rows, so that a busy machine hits all alike; each run is waited for. Compile time is the first
call less the best warm one.
"""

import json
import os
import platform
import subprocess
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import tyro
from tqdm import tqdm

from voodoo_jax.cli.demo import joint_errors
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.model.body_file import load_body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.solve.padding import Chunk, pad_frames
from voodoo_jax.solve.scan import Step, at_rest, options_from, track_chunk
from voodoo_jax.trackers.base import LogInfo, Task
from voodoo_jax.trackers.of_points import track_person

ROOT = Path(__file__).parents[2]
JITTER = 0.002  # metres
SKIP_NS = 500_000_000  # of the truth's beginning, not scored: the tracker finds the body there


@dataclass(frozen=True)
class Started:
    """A recording replayed as the product does it, and its frames for the measurements."""

    tracks: Tracks  # of `frames`
    frames: list[BodyObservation]  # from the first tracked one on
    prepare_fps: float  # frames per second of reading the log and finding the person, on the host


@dataclass
class Row:
    """One measurement: a log at one number of points with one solver."""

    log: str
    solver: str
    points: int
    frames: int
    compile_s: float
    best_fps: float
    median_fps: float
    joint_error_cm: float | None  # mean over joints and frames; None: no truth


def prepare(log: Path, body: Body, settings: Settings) -> Started:
    """Reads a log, finds the person and tracks it with the settings as they are."""
    begin = time.perf_counter()
    reader = open_log(log, settings.read)
    scene, people = find_body(reader.frames(), reader.up, body, settings)
    prepare_fps = len(people) / (time.perf_counter() - begin)
    task = Task(body, LogInfo(reader.path, reader.fixed_frame), settings)
    first = int(np.argmax(track_person(task, scene, people).tracked))
    # once more, compiled: for its time, and without the frames before the first tracked one
    tracks = track_person(task, scene, people[first:])
    if not tracks.tracked[0]:
        raise SystemExit(f"{log}: nobody was tracked in it, there is nothing to measure")
    return Started(tracks, people[first:], prepare_fps)


def resample(frame: BodyObservation, count: int) -> BodyObservation:
    """The frame with exactly `count` points (an empty frame stays empty); the same on every run."""
    n = len(frame.points)
    if n == 0:
        return frame
    rng = np.random.default_rng((count, frame.time_ns & 0xFFFFFFFFFFFF))
    chosen = np.concatenate([rng.permutation(n)] + [rng.integers(0, n, max(0, count - n))])[:count]
    points = frame.points[chosen]
    points[n:] += rng.normal(0, JITTER, points[n:].shape).astype(np.float32)
    return BodyObservation(frame.time_ns, points, frame.sensor[chosen], frame.origins)


class Case:
    """One row's program and inputs, ready to run."""

    def __init__(self, started: Started, settings: Settings, count: int):
        frames = [resample(f, count) for f in started.frames]
        tracks = started.tracks
        self.body, self.options = tracks.body, options_from(settings.solve, settings.track)
        self.state = at_rest(Poses(jnp.asarray(tracks.rotation[0]), jnp.asarray(tracks.translation[0])))
        self.chunk: Chunk = pad_frames(frames, count, len(frames), None, len(frames[0].origins))
        self.seconds, self.valid = jnp.asarray(self.chunk.seconds), jnp.asarray(self.chunk.valid)

    def run(self) -> tuple[float, Step]:
        """Wall time in seconds and what was tracked."""
        begin = time.perf_counter()
        inputs = (self.body, self.options, self.state, self.chunk.points, self.seconds, self.valid)
        step = jax.block_until_ready(track_chunk(*inputs)[1])
        return time.perf_counter() - begin, step


@eqx.filter_jit
def centres(body: Body, step: Step) -> jax.Array:
    """Joint centres [frame, centre, 3], metres."""
    return jax.vmap(lambda poses: joint_centres(body, poses))(step.poses)


def joint_error(tracks: Tracks, truth: Path) -> float:
    """Mean distance from the true joint centres, cm; a joint without an answer, or a frame, counts as 1 m off."""
    with np.load(truth, allow_pickle=False) as file:
        known = dict(file)
    # names of H-Anim version 1
    alias = {
        "l_wrist": "l_radiocarpal",
        "r_wrist": "r_radiocarpal",
        "l_ankle": "l_talocrural",
        "r_ankle": "r_talocrural",
    }
    known["names"] = np.array([alias.get(str(n), str(n)) for n in known["names"]])
    error = joint_errors(tracks, known)
    stamps = known["time_ns"]
    # half a frame at 30 Hz; farther stamps are of other frames
    error[np.abs(tracks.time_ns[None] - stamps[:, None]).min(1) > 17_000_000] = np.nan
    scored = np.isfinite(known["joints"]).all(-1) & (stamps >= stamps[0] + SKIP_NS)[:, None]
    return 100 * float(np.where(np.isfinite(error), error, 1.0)[scored].mean())


def machine() -> dict[str, str | int | float]:
    """What the numbers were taken on."""
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True)
    cpu = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), cpu)
    device = jax.devices()[0]
    return {
        "cpu": cpu,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 0,
        "load_1min": round(os.getloadavg()[0], 2),
        "device": f"{device.platform} {device.device_kind}",
        "jax": jax.__version__,
        "python": platform.python_version(),
        "commit": commit.stdout.strip() or "unknown",
    }


def plot(rows: list[Row], where: Path, title: str) -> None:
    """Speed and error over the number of points, one line per log and solver."""
    figure, (speed, accuracy) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for key in dict.fromkeys((r.log, r.solver) for r in rows):
        mine = [r for r in rows if (r.log, r.solver) == key]
        x = [r.points for r in mine]
        (line,) = speed.plot(x, [r.best_fps for r in mine], "o-", label=" ".join(key))
        speed.plot(x, [r.median_fps for r in mine], ":", color=line.get_color())
        if mine[0].joint_error_cm is not None:
            accuracy.plot(x, [r.joint_error_cm for r in mine], "o-", color=line.get_color())
    speed.set(xscale="log", yscale="log", xlabel="points per frame", ylabel="frames per second")
    speed.set_title("best (line) and median (dots)")
    accuracy.set(xscale="log", ylim=(0, None), xlabel="points per frame", ylabel="mean joint error, cm")
    ticks = sorted({r.points for r in rows})
    for axes in (speed, accuracy):
        axes.set_xticks(ticks, [str(t) for t in ticks])
        axes.minorticks_off()
        axes.grid(True, which="both", alpha=0.3)
    speed.legend(fontsize=8)
    figure.suptitle(title, fontsize=9)
    figure.savefig(where, dpi=110)
    plt.close(figure)


def main(
    logs: tyro.conf.Positional[tuple[Path, ...]] = (),
    truth: Path | None = None,
    points: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N...")] = (500, 1000, 2000, 4000),
    solvers: tuple[Literal["coupled", "per_limb"], ...] = ("coupled", "per_limb"),
    steps: int = 6,
    repeats: int = 7,
    body: str = "human",
    out: Path = Path(__file__).parent / "out",
) -> None:
    """Measures the tracking scan and prints a table; the same as JSON and picture goes to `out`.

    Args:
        logs: recordings; none: the demo recording that the package brings along.
        truth: joint centres to compare with (.truth.npz); none: the file of that name beside each log, if there is one.
        points: points per frame, one row each.
        solvers: solvers to compare.
        steps: ICP steps per frame, all of which are taken.
        repeats: warm runs per row, at least 5.
        body: built-in body or body file.
        out: folder for replay_speed.json and replay_speed.png.
    """
    if truth is not None and len(logs) > 1:
        raise SystemExit("--truth belongs to one log; for several put <stem>.truth.npz beside each")
    if repeats < 5:
        raise SystemExit("--repeats must be at least 5: fewer say little on a shared machine")
    info = machine()
    print(", ".join(f"{key} {value}" for key, value in info.items()))
    rows: list[Row] = []
    for log in logs or (ROOT / "voodoo_jax" / "data" / "demo.mcap",):
        answer = truth or log.with_name(f"{log.stem}.truth.npz")
        started = prepare(log, load_body(body), Settings())
        answer = answer if answer.exists() else None
        tracks, native = started.tracks, np.median([len(f.points) for f in started.frames])
        error = f", {joint_error(tracks, answer):.2f} cm" if answer else ""
        print(
            f"{log.stem}: {len(started.frames)} frames, {native:.0f} points on the person (median); "
            f"reading and finding the person: {started.prepare_fps:.0f} frames/s\n"
            f"replay as it is, start included: {len(started.frames) / tracks.seconds:.0f} frames/s, "
            f"{tracks.evidence.steps.mean():.1f} steps a frame{error}; now {steps} steps each:"
        )
        rows += measure(started, log.stem, answer, points, solvers, steps, repeats)
    load = round(os.getloadavg()[0], 2)
    print(table(rows), f"load average {info['load_1min']} before, {load} after", sep="\n")
    out.mkdir(parents=True, exist_ok=True)
    result = {"machine": info | {"load_1min_after": load}, "steps": steps, "repeats": repeats}
    result["rows"] = [vars(row) for row in rows]
    (out / "replay_speed.json").write_text(json.dumps(result, indent=1) + "\n")
    plot(
        rows,
        out / "replay_speed.png",
        f"{steps} steps a frame; {info['cpu']}, {info['cores']} cores, jax {info['jax']}",
    )
    print(f"written: {out / 'replay_speed.json'}, {out / 'replay_speed.png'}")


def measure(
    started: Started, name: str, truth: Path | None, points: tuple[int, ...], solvers: tuple, steps: int, repeats: int
) -> list[Row]:
    """Rows of one log."""
    cases: dict[tuple[str, int], Case] = {}
    first: dict[tuple[str, int], float] = {}
    errors: dict[tuple[str, int], float | None] = {}
    wanted = [(solver, n) for solver in solvers for n in points]
    for key in tqdm(wanted, desc="compile", leave=False, disable=None):
        solve = replace(Settings().solve, solver=key[0], max_steps=steps, epsilon=0.0)
        cases[key] = Case(started, replace(Settings(), solve=solve), key[1])
        first[key], step = cases[key].run()
        if not bool(jnp.all(step.steps == steps)):
            raise SystemExit(f"{name}: not every frame took {steps} steps; the rows would not be equal work")
        tracks = replace(started.tracks, joints=np.asarray(centres(started.tracks.body, step)))
        errors[key] = joint_error(tracks, truth) if truth else None
    warm: dict[tuple[str, int], list[float]] = {key: [] for key in wanted}
    for _ in tqdm(range(repeats), desc="rounds", leave=False, disable=None):
        for key in wanted:
            warm[key].append(cases[key].run()[0])
    count = len(started.frames)
    return [
        Row(
            name, *key, count, first[key] - min(warm[key]), count / min(warm[key]), count / float(np.median(warm[key])),
            errors[key],
        )
        for key in wanted
    ]  # fmt: skip


def table(rows: list[Row]) -> str:
    """The rows as a Markdown table."""
    lines = ["| log | solver | points | compile, s | best, frames/s | median, frames/s | joint error, cm |"]
    lines += ["|---|---|---:|---:|---:|---:|---:|"]
    for r in rows:
        error = "no truth" if r.joint_error_cm is None else f"{r.joint_error_cm:.2f}"
        speed = f"{r.compile_s:.1f} | {r.best_fps:.0f} | {r.median_fps:.0f}"
        lines.append(f"| {r.log} | {r.solver} | {r.points} | {speed} | {error} |")
    return "\n".join(lines)


if __name__ == "__main__":
    tyro.cli(main)
