"""Table I of Knoop 2006 and Figs. 6 to 9 of Knoop 2007 by the papers' chain: see chain.py."""

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.bench.replay_speed import resample
from experiments.common import GROUPS, Score, line_fit, log_files, mean_row, pick, score, table
from experiments.fusion.__main__ import PAPER_COLUMNS, draw
from experiments.papers.chain import (
    CHUNK,
    Begun,
    Inputs,
    as_tracks,
    bare,
    begun,
    inputs,
    processor_seconds,
    run,
)
from experiments.table1.__main__ import PAPER, counts, interval
from voodoo_jax.solve.scan import options_from

KINDS = {
    "3D data": "depth",
    "2D data": "rays",
    "fusion": "fusion",
}  # of the paper's rows, as experiments.fusion calls them
STEPS = 6  # "a good trade-off", 2007 sec. 7
MOST = 15  # "3-15" steps, 2006 sec. VI
SKIP_FRAMES = 2  # their steps come from the start's pose, not from the motion


def table_one(found: dict[str, list[Score]]) -> str:
    """Lost, acceptable, good, with the paper's own line."""
    rows = [["VooDoo 2006, graded by hand", "100", *map(str, PAPER), "1.58", interval(PAPER[0], 100), "-", "-"]]
    for name, scores in found.items():
        n, grades = len(scores), counts(scores)
        error, within = (float(np.mean([getattr(s, k) for s in scores])) for k in ("error_cm", "within"))
        cells = [f"{100 * g / n:.0f}" for g in grades]
        mean = f"{np.mean([s.grade for s in scores]):.2f}"
        rows.append([name, str(n), *cells, mean, interval(grades[0], n), f"{error:.1f}", f"{within:.0f}"])
    head = ["who", "sequences", "0 lost, %", "1 acceptable, %", "2 good, %", "mean grade"]
    return table(head + ["95 % interval of lost, %", "mean joint error, cm", "within 10 cm, %"], rows)


def groups(found: dict[str, list[Score]]) -> str:
    """Error by group of joints for each kind of input."""
    rows = []
    for kind in KINDS:
        some = found[kind]
        cells = [f"{np.mean([s.group(group) for s in some]):.1f}" for group in GROUPS]
        rows.append([kind, *cells, mean_row(some)[-1]])
    return table(["input", *(f"{group}, cm" for group in GROUPS), "lost / acceptable / good"], rows)


def all_logs(recordings: Path, every: int, frames: int, figure_of: str) -> tuple[dict[str, list[Score]], Begun, Figure]:
    """Scores of every so-manyth recording by variant, the recording that is drawn, and Fig. 6 of it."""
    settings, found = bare(), dict[str, list[Score]]()
    drawn, figure = None, None
    for file in tqdm(log_files(recordings)[every - 1 :: every], "papers' chain", leave=False, disable=None):
        one = cut(begun(file), frames)
        tracks = {kind: as_tracks(one, run(one, settings, inputs(one, settings, kind))) for kind in KINDS}
        for kind in KINDS:
            found.setdefault(kind, []).append(score(one.log, tracks[kind]))
        ball = replace(one, body=eqx.tree_at(lambda b: b.axes, one.body, without_hinged_hips(one)))
        tracks_ball = as_tracks(ball, run(ball, settings, inputs(ball, settings, "fusion")))
        found.setdefault("hips as ball joints", []).append(score(one.log, tracks_ball))
        ours = run(one, settings, inputs(one, settings, "fusion", one.log.people[: len(one.clouds)]))
        found.setdefault("points by our finder", []).append(score(one.log, as_tracks(one, ours)))
        if file == pick(recordings, figure_of):
            drawn, people = one, one.log.people[: len(one.clouds)]
            blind = [frame.only(np.zeros(len(frame.points), bool)) for frame in people]
            of = {"depth": [replace(f, rays=f.rays.__class__()) for f in people], "rays": blind, "fusion": people}
            figure = draw(one.log, {KINDS[k]: t for k, t in tracks.items()}, of, PAPER_COLUMNS)
        print(file.stem, {name: round(scores[-1].error_cm, 1) for name, scores in found.items()}, flush=True)
    assert drawn is not None and figure is not None
    return found, drawn, figure


def of_figures(recordings: Path, frames: int, figure_of: str) -> Begun:
    """The recording that is drawn."""
    return cut(begun(pick(recordings, figure_of)), frames)


def without_hinged_hips(one: Begun) -> jnp.ndarray:
    """Axes of the body's joints with hips as ball joints."""
    hips = np.array([joint.endswith("_hip") for joint in one.body.topology.joints])
    return jnp.where(hips[:, None], 0.0, one.body.axes)


def cut(one: Begun, frames: int) -> Begun:
    """The first frames of it, if so many are asked for."""
    if not frames or len(one.clouds) <= frames:
        return one
    last = one.clouds[frames - 1].time_ns
    seen = one.log.stamps <= last
    log = replace(one.log, people=one.log.people[:frames], stamps=one.log.stamps[seen], joints=one.log.joints[seen])
    return replace(one, log=log, clouds=one.clouds[:frames])


def figure_seven(one: Begun) -> tuple[str, Figure]:
    """Steps along the recording, beside how fast the person moves."""
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(8, 4), sharex=True, layout="constrained")
    log, rows = one.log, []
    middle = (log.stamps[1:] + log.stamps[:-1]) / 2
    speed = np.nanmean(np.linalg.norm(np.diff(log.joints, axis=0), axis=-1), 1) / (np.diff(log.stamps) / 1e9)
    time = np.array([f.time_ns for f in one.clouds])[one.first :]
    now = np.interp(time, middle, speed)[SKIP_FRAMES:]
    for epsilon in (1e-6, 1e-5, 1e-4):
        settings = bare(max_steps=MOST, epsilon=epsilon)
        found = run(one, settings, inputs(one, settings, "fusion"))
        steps = found.steps[SKIP_FRAMES:]
        slow, fast = now <= np.percentile(now, 25), now >= np.percentile(now, 75)
        alike = np.corrcoef(steps, now)[0, 1] if np.ptp(steps) else 0.0
        error = score(log, as_tracks(one, found)).error_cm
        numbers = (steps.mean(), steps[slow].mean(), steps[fast].mean(), 100 * np.mean(steps <= STEPS))
        rows.append([f"{epsilon:.0e}", *(f"{v:.1f}" for v in numbers), f"{alike:.2f}", f"{error:.1f}"])
        if epsilon in (1e-5, 1e-4):
            upper.step((time - time[0]) / 1e9, found.steps, where="mid", lw=0.9, label=f"epsilon {epsilon:.0e} m$^2$")
    upper.axhline(STEPS, color="0.5", ls=":", label="the paper's limit")
    upper.set(ylabel="ICP steps", ylim=(0, MOST + 1))
    upper.legend(fontsize=8, ncols=3, loc="lower left", bbox_to_anchor=(0, 1))
    lower.plot((middle - time[0]) / 1e9, speed, color="tab:red")
    lower.set(xlabel="time, s", ylabel="mean joint speed, m/s", ylim=(0, None))
    for panel in (upper, lower):
        panel.grid(True, alpha=0.3)
    head = ["epsilon, m2", "mean steps", "slowest quarter", "fastest quarter", "6 or fewer, % of frames"]
    return table([*head, "correlation with speed", "mean joint error, cm"], rows), figure


def figure_eight(one: Begun, counts: tuple[int, ...], turns: int) -> tuple[str, Figure]:
    """Time of a processor by number of steps."""
    base, short = bare(epsilon=0.0), cut(one, one.first + CHUNK)
    given, part, jobs, errors = inputs(one, base, "fusion"), inputs(short, base, "fusion"), {}, {}
    for count in counts:
        options = options_from(replace(base.solve, max_steps=count), base.track, base.features)
        jobs[(count,)] = lambda options=options: run(short, base, part, options)
        errors[count] = score(one.log, as_tracks(one, run(one, base, given, options)))
    frames = len(short.clouds) - short.first
    millis = {key[0]: 1000 * t / frames for key, t in processor_seconds(jobs, turns).items()}
    slope, start, fit = line_fit(list(counts), [millis[c] for c in counts])
    figure, (time, accuracy) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    time.plot(counts, [millis[c] for c in counts], "o")
    time.plot(counts, start + slope * np.array(counts), "-", color="0.4")
    time.set(xlabel="ICP steps n", ylabel="processor time a frame, ms", ylim=(0, None))
    accuracy.plot(counts, [errors[c].error_cm for c in counts], "o-")
    accuracy.set(xlabel="ICP steps n", ylabel="mean joint error, cm", ylim=(0, None))
    for panel in (time, accuracy):
        panel.grid(True, alpha=0.3)
    rows = [[str(c), f"{millis[c]:.1f}", f"{errors[c].error_cm:.1f}", f"{errors[c].within:.0f}"] for c in counts]
    text = table(["steps", "processor time a frame, ms", "mean joint error, cm", "within 10 cm, %"], rows, 0)
    return text + f"\nA frame takes {start:.1f} ms + {slope:.2f} ms for each step (R^2 {fit:.3f}).\n", figure


def figure_nine(one: Begun, sizes: tuple[int, ...], turns: int) -> tuple[str, Figure]:
    """Time of a processor by number of measurements, and by what they weigh."""
    base = bare(epsilon=0.0)
    everything = options_from(replace(base.solve, sampling=1.0, sampling_max=8192), base.track, base.features)
    jobs, people = {}, one.log.people[one.first : len(one.clouds)][:CHUNK]
    for size in sizes:
        same = replace(one, clouds=[resample(f, size) for f in people], first=0)
        given = inputs(same, base, "fusion", same.clouds) if size <= 1024 else inputs(same, base, "fusion")
        given = sized(given, size)
        for weight in (1.0, 10.0):
            heavy = replace(given, points=[eqx.tree_at(lambda p: p.weight, p, weight * p.weight) for p in given.points])
            jobs[weight, size] = lambda same=same, heavy=heavy: run(same, base, heavy, everything)
    millis = {key: 1000 * t / len(people) for key, t in processor_seconds(jobs, turns).items()}
    slope, start, fit = line_fit(list(sizes), [millis[1.0, n] for n in sizes])
    figure, panel = plt.subplots(figsize=(6, 3.4), layout="constrained")
    for weight, marker in ((1.0, "o"), (10.0, "x")):
        panel.plot(sizes, [millis[weight, n] for n in sizes], marker, label=f"each weighs {weight:.0f}")
    panel.plot(sizes, start + slope * np.array(sizes), "-", color="0.4", label="line")
    panel.set(xlabel="measurements of the body in a frame", ylabel="processor time a frame, ms", ylim=(0, None))
    panel.grid(True, alpha=0.3)
    panel.legend(fontsize=8)
    rows = [[str(n), f"{millis[1.0, n]:.2f}", f"{millis[10.0, n]:.2f}"] for n in sizes]
    text = table(["measurements", "processor time a frame, ms", "the same, each weighing 10 times as much"], rows, 0)
    line = f"{start:.2f} ms + {1000 * slope:.2f} ms for each 1,000 measurements (R^2 {fit:.4f})"
    return text + f"\nWith {STEPS} steps a frame takes {line}.\n", figure


def sized(given: Inputs, size: int) -> Inputs:
    """Arrays of exactly so many points: what is padded takes as long as what is measured."""
    where = lambda p: (p.xyz, p.weight, p.sensor)  # noqa: E731
    points = [eqx.tree_at(where, p, tuple(array[:, :size] for array in where(p))) for p in given.points]
    return replace(given, points=points)
