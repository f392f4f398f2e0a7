"""ICP steps: how many are needed, what they cost (Knoop 2007, Figs. 7 and 8): python -m experiments.steps [RECORDINGS]

One recording. Along it: steps per frame, beside the person's speed. Then the tracking scan with
exactly 1 ... 20 steps a frame (epsilon 0), everything compiled, contenders in turns, median; with the error beside it.
Writes steps.md, steps.png (Fig. 7) and steps_time.md, steps_time.png (Fig. 8).
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import matplotlib.pyplot as plt
import numpy as np
import tyro

from experiments.bench.replay_speed import Case, Started, centres, machine
from experiments.common import (
    DEMO,
    Log,
    human,
    line_fit,
    load_log,
    machine_line,
    pick,
    rounds,
    score,
    started,
    table,
    write,
)  # fmt: skip
from voodoo_jax.config.options import Settings
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.solve.scan import TrackOptions, options_from

PAPER_STEPS = 6  # "a good trade-off"


def along(log: Log, runs: dict[float, Tracks], out: Path) -> None:
    """Steps of every frame by epsilon (where a frame stops), and the speed of the true joints (Fig. 7)."""
    first = next(iter(runs.values()))
    middle = (log.stamps[1:] + log.stamps[:-1]) / 2
    speed = np.nanmean(np.linalg.norm(np.diff(log.joints, axis=0), axis=-1), 1) / (np.diff(log.stamps) / 1e9)
    # not of the first two frames: their steps come from the start's pose, not from the motion
    now = np.interp(first.time_ns[2:], middle, speed)
    parts = {
        "all": now >= 0,
        "slowest quarter": now <= np.percentile(now, 25),
        "fastest quarter": now >= np.percentile(now, 75),
    }
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(8, 4.2), sharex=True, layout="constrained")
    rows, text = [], ""
    for epsilon, tracks in runs.items():
        steps = tracks.evidence.steps[2:]
        label = f"epsilon {epsilon:.0e} square metres"
        upper.step((tracks.time_ns - first.time_ns[0]) / 1e9, tracks.evidence.steps, where="mid", lw=0.9, label=label)
        for name, part in parts.items():
            few = (now[part].mean(), steps[part].mean(), np.median(steps[part]), steps[part].max())
            rows.append([f"{epsilon:.0e}", name, *(f"{v:.{d}f}" for v, d in zip(few, (2, 1, 0, 0)))])
        close, share = score(log, tracks).error_cm, 100 * np.mean(steps <= PAPER_STEPS)
        alike = np.corrcoef(steps, now)[0, 1] if np.ptp(steps) else 0.0
        text += f"\n{label}: correlation of steps and speed {alike:.2f}; {share:.0f} % of the frames need at most "
        text += f"{PAPER_STEPS} steps; mean joint error {close:.2f} cm.\n"
    upper.axhline(PAPER_STEPS, color="0.5", ls=":", label="the papers' limit")
    upper.set(ylabel="ICP steps", ylim=(0, None))
    upper.legend(fontsize=7, ncols=3, loc="lower left", bbox_to_anchor=(0, 1))
    lower.plot((middle - first.time_ns[0]) / 1e9, speed, color="tab:red")
    lower.set(xlabel="time, s", ylabel="mean joint speed, m/s", ylim=(0, None))
    for panel in (upper, lower):
        panel.grid(True, alpha=0.3)
    figure.suptitle(log.name, fontsize=9)
    head = ["epsilon", "frames", "mean joint speed, m/s", "mean steps", "median", "most"]
    write(out, "steps", table(head, rows, 2) + text, figure)


def runner(case: Case, options: TrackOptions) -> Callable[[], float]:
    """Runs a case with other options."""

    def run() -> float:
        case.options = options
        return case.run()[0]

    return run


def timed(
    log: Log, begin: Started, points: int, counts: tuple[int, ...], solvers: tuple, turns: int, out: Path
) -> None:
    """Time per frame and error over the number of steps (Fig. 8)."""
    before, base, tracks = machine(), Settings(), begin.tracks
    contenders, errors = {}, {}
    for solver in solvers:
        settings = replace(base, solve=replace(base.solve, solver=solver, epsilon=0.0))
        case = Case(begin, settings, points)
        for count in counts:
            options = options_from(replace(settings.solve, max_steps=count), settings.track)
            contenders[solver, count] = runner(case, options)
            case.options = options
            step = case.run()[1]
            if not bool((step.steps == count).all()):
                raise SystemExit(f"{log.name}: not every frame took {count} steps; the rows would not be comparable")
            errors[solver, count] = score(log, replace(tracks, joints=np.asarray(centres(case.body, step))))
    millis = {key: 1000 * t / len(tracks.time_ns) for key, t in rounds(contenders, turns).items()}
    figure, (time, accuracy) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    text = ""
    for solver in solvers:
        mine = [millis[solver, c] for c in counts]
        slope, start, fit = line_fit(list(counts), mine)
        (dots,) = time.plot(counts, mine, "o", ms=4, label=f"{solver}: {start:.2f} + {slope:.3f} n ms, $R^2$ {fit:.4f}")
        time.plot(counts, start + slope * np.array(counts), "-", lw=1, color=dots.get_color())
        # above 100 cm it ran away
        accuracy.plot(counts, [min(errors[solver, c].error_cm, 100.0) for c in counts], "o-", ms=4, label=solver)
        text += f"\n{solver}: {start:.3f} ms + {slope:.4f} ms per step and frame, R^2 {fit:.5f}.\n"
    time.set(xlabel="ICP steps per frame n", ylabel="time per frame, ms", ylim=(0, None))
    accuracy.set(xlabel="ICP steps per frame", ylabel="mean joint error, cm")
    accuracy.set(ylim=(0, min(10.0, 1.1 * max(min(e.error_cm, 100.0) for e in errors.values()))))
    for panel in (time, accuracy):
        panel.grid(True, alpha=0.3)
        panel.legend(fontsize=8)
    figure.suptitle(f"{log.name}, {points} points a frame, depth only", fontsize=9)
    rows = [
        [s, str(c), f"{millis[s, c]:.3f}", f"{e.error_cm:.2f}" if e.error_cm < 100 else "> 100", f"{e.within:.1f}"]
        for (s, c), e in errors.items()
    ]
    head = ["solver", "steps", "time per frame, ms", "mean joint error, cm", "within 10 cm, %"]
    write(out, "steps_time", f"{table(head, rows)}{text}\n{machine_line(before)}", figure)


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    log: str = "bow-wave-15s",
    epsilon: tuple[float, ...] = (1e-5,),
    points: int = 1024,
    counts: tuple[int, ...] = tuple(range(1, 21)),
    solvers: tuple[Literal["coupled", "per_limb"], ...] = ("coupled", "per_limb"),
    turns: int = 7,
    frames: int = 0,
    out: Path = Path(__file__).parent,
) -> None:
    """Steps along a recording, time and error by number of steps.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        log: recording to take; if it is not there, the first.
        epsilon: where a frame stops, square metres, beside the default.
        points: points per frame for the timing.
        counts: numbers of steps to time.
        solvers: solvers to time.
        turns: rounds over all contenders; medians are reported.
        frames: cut the recording after so many frames; 0: whole.
        out: folder for tables and figures.
    """
    body, settings = human(), Settings()
    recording = load_log(pick(recordings, log), body, settings, frames)
    begin = started(recording, body, settings)
    runs = {settings.solve.epsilon: begin.tracks}
    for value in epsilon:
        other = replace(settings, solve=replace(settings.solve, epsilon=value))
        runs[value] = recording.track(body, other, begin.frames)
    along(recording, runs, out)
    timed(recording, begin, points, counts, solvers, turns, out)


if __name__ == "__main__":
    tyro.cli(main)
