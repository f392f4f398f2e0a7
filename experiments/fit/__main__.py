"""What fitting a body gives: python -m experiments.fit [RECORDINGS]

Two tables, real.md and simulated.md. Real recordings: the body fitted to each from depth alone; segment lengths and
stature against the truth, joint errors in frames that were held back, before and after. Simulated ones: a body whose
limbs are 15 % off, with and without the camera's noise; how far lengths are from the simulated body's afterwards. And
one whose bands are 15 % off.
"""

import json
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import tyro
from tqdm import tqdm

from experiments.common import DEMO, human, load_log, log_files, table, without_features, write
from experiments.stress.motions import KNEES_BENT, RELAXED, SPREAD, bend, posed
from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.fit import Seen, fit_tracked
from voodoo_jax.fitting.frames import Truth
from voodoo_jax.fitting.front import fit
from voodoo_jax.fitting.gauss_newton import FitError
from voodoo_jax.fitting.result import Fit
from voodoo_jax.model.body import Body, scaled, segment_lengths, with_proportions
from voodoo_jax.records.recording import Frame, Recording
from voodoo_jax.simulate.motion import Motion, placed, sequence
from voodoo_jax.simulate.recording import Simulation, simulate
from voodoo_jax.simulate.room import Room
from voodoo_jax.simulate.sensor import NO_NOISE, TOF_NOISE, Noise
from voodoo_jax.trackers.front import track

NOTE = """
After: the fitted body, whether it is written or not. Two of three runs of time are held back. Settings (noise, what is
free) were chosen on these recordings.
Seconds include compiling in the first row, on two cores that others used too: no timing.
"""
SIMULATED = """
Free: these four lengths (left and right alike); four rounds, noise 0.0005, looseness 10; 48 frames of 512 points.
Knees and elbows bend one after the other, 3 m from the camera (1.8 cm of noise there), all of them in view.
"""
SURFACE = 0.0005  # metres: the simulated person is made of the tracker's own limbs
LIMBS = ("upper_arm", "forearm", "thigh", "shank")


def off(body: Body, truth: dict[str, float]) -> dict[str, float]:
    """Segment lengths minus the truth's, cm."""
    found = segment_lengths(body)
    return {name: 100 * (found[name] - truth[name]) for name in LIMBS if name in truth}


def real(recordings: Path, every: int, frames: int, options: FitSettings, rounds: tuple[int, ...]) -> str:
    """Table of all recordings that have a truth with dimensions; the same with other numbers of rounds as means."""
    body, settings, rows = human(), Settings(), []
    numbers: dict[int, list[np.ndarray]] = {count: [] for count in dict.fromkeys((options.rounds, *rounds))}
    for path in tqdm(log_files(recordings)[::every], "fit", unit="log", leave=False, disable=None):
        log = load_log(path, body, settings, frames)
        with np.load(path.with_suffix(".truth.npz"), allow_pickle=False) as file:
            dims = json.loads(str(file["dims"])) if "dims" in file else {}
        people = without_features(log.people)
        seen = [Seen(log.track(body, settings, people), people, log.scene, body)]
        truth = Truth(log.stamps, log.names, log.joints)
        for count in numbers:
            began = time.perf_counter()
            try:
                found = fit_tracked(seen, settings, replace(options, rounds=count), judge=[truth])
            except FitError as problem:
                tqdm.write(str(problem))
                if count == options.rounds:
                    rows.append([log.name, *"-" * 9, "too few"])
                continue
            row = np.array([*_lengths(found, dims), *_held(found), time.perf_counter() - began])
            numbers[count].append(row)
            if count == options.rounds:
                rows.append([log.name, *_cells(row), "yes" if found.better else "no"])
            tqdm.write(" ".join([log.name, str(count), *_cells(row)]))
    head = [
        "recording", "segments before, cm", "after, cm", "stature before, cm", "after, cm",
        "held back: distance before, cm", "after, cm", "held back: joints before, cm", "after, cm",
        "seconds", "written",
    ]  # fmt: skip
    means = {count: np.nanmean(some, 0) for count, some in numbers.items()}
    rows.append(["**mean**", *_cells(means[options.rounds]), ""])
    others = [[str(count), *_cells(row)] for count, row in means.items()]
    return table(head, rows) + NOTE + "\nMeans by number of rounds:\n\n" + table(["rounds", *head[1:-1]], others)


def _cells(row: np.ndarray) -> list[str]:
    return [*(f"{v:.2f}" if np.isfinite(v) else "-" for v in row[:-1]), f"{row[-1]:.0f}"]


def _lengths(found: Fit, dims: dict[str, float]) -> list[float]:
    """Mean error of the segments, and of the stature, before and after; cm."""
    out = []
    for key in ("segments", "stature"):
        for body in (found.starts[0], found.fitted[0]):
            if not dims:
                out.append(float("nan"))
            elif key == "segments":
                out.append(float(np.mean(np.abs(list(off(body, dims).values())))))
            else:
                out.append(100 * abs(float(body.scale) - dims["stature"]))
    return out


def _held(found: Fit) -> list[float]:
    """Distance and joint error in held-back frames, before and after; cm."""
    j = found.judged[0]
    columns = [v[j.held & np.isfinite(v)] for v in (j.before, j.after, j.joints_before, j.joints_after)]
    return [100 * float(v.mean()) if len(v) else float("nan") for v in columns]


def recording_of(sim: Simulation) -> Recording:
    """The simulated depth images as a recording: points in the fixed frame."""
    rays, origin = sim.camera.rays(), np.array(sim.camera.position, np.float32)
    frames = []
    for stamp, depth in zip(sim.time_ns, sim.depth):
        z = depth.reshape(-1) / 1000.0
        points = (origin + rays[z > 0] * z[z > 0, None]).astype(np.float32)
        frames.append(Frame(int(stamp), points, np.zeros(len(points), np.int32), origin[None]))
    return Recording("simulated", sim.fixed_frame, np.array([0, 0, 1], np.float32), ("depth",), tuple(frames))


def exercise(body: Body) -> Motion:
    """What shows lengths: every knee and elbow bends; 7 s, in front of the camera, all of the person in view."""
    arms = {"l_elbow": bend(1.4), "r_elbow": bend(1.4)}
    left, right = (RELAXED | arms | {f"{s}_hip": bend(1.1), f"{s}_knee": bend(-1.4)} for s in "lr")
    curled = SPREAD | {"l_elbow": bend(1.5), "r_elbow": bend(1.5)}
    keys = [(0.4, RELAXED), (0.7, left), (0.6, RELAXED), (0.7, right), (0.6, RELAXED), (0.7, SPREAD), (0.7, curled)]
    down = posed(body, [(0.1, RELAXED), (0.7, KNEES_BENT), (0.7, RELAXED)], ground=True)
    return placed(sequence(posed(body, [*keys, (0.7, RELAXED)]), down), 2.95, 0.0, np.pi + 0.3)


@cache
def exercised(noise: Noise, frames: int) -> tuple[Simulation, Recording]:
    """Somebody of 1.75 m, seen by a camera with such noise; the first `frames` frames (0: all) as a recording."""
    body = scaled(human(), 1.75)
    sim = simulate(body, exercise(body), noise=noise, room=Room(wall=6.0, boxes=()))
    recording = recording_of(sim)
    return sim, replace(recording, frames=recording.frames[: frames or None])


def of_size(scale: float) -> Settings:
    """Settings for a body of known size."""
    settings = Settings()
    return replace(settings, start=replace(settings.start, scale=scale))


def simulated(frames: int, options: FitSettings) -> str:
    """Table of the recovery of limbs that are 15 % off."""
    rows = []
    body = exercised(NO_NOISE, frames)[0].body
    wrong = {"thigh": 1.15, "shank": 0.85, "upper_arm": 0.85, "forearm": 1.15}
    start = with_proportions(body, {f"{s}_{k}": v for k, v in wrong.items() for s in "lr"})
    truth = segment_lengths(body)
    for word, noise in (("none", NO_NOISE), ("time of flight", TOF_NOISE)):
        # the stature is known: with such limbs the height would not give it
        settings = of_size(float(start.scale))
        # cylinders are seen, only lengths are wrong, and by much: little noise, wide priors, logs tracked again
        own = replace(
            options, free=tuple(f"lengths.*{k}" for k in LIMBS), looseness=10.0, rounds=max(4, options.rounds)
        )
        own = replace(own, frames=48, points=512, noise=SURFACE)
        found = fit(start, [exercised(noise, frames)[1]], settings, own)
        before, after = off(found.starts[0], truth), off(found.fitted[0], truth)
        rows.append([word, *(f"{before[k]:+.1f} to {after[k]:+.2f}" for k in LIMBS), f"{len(found.losses) - 1}"])
        tqdm.write(" | ".join(rows[-1]))
    return table(["noise", *(f"{k}, cm" for k in LIMBS), "steps"], rows) + SIMULATED


def of_bands(frames: int, options: FitSettings) -> str:
    """Table of bands that are 15 % off: how well the log is tracked with them, with the true ones, and with those that
    were fitted to its points alone."""
    body, rows = exercised(NO_NOISE, frames)[0].body, []
    off_by = np.array([1.15 if k % 2 else 0.85 for k in range(len(body.topology.joints))])
    wrong = eqx.tree_at(lambda b: b.weights, body, jnp.asarray(body.weights * off_by))
    settings = of_size(float(body.scale))
    for word, noise in (("none", NO_NOISE), ("time of flight", TOF_NOISE)):
        sim, recording = exercised(noise, frames)
        found = fit(wrong, [recording], settings, replace(options, free=("bands.*.weight",), frames=48, points=512))
        errors = []
        for each in (body, wrong, found.fitted[0]):
            tracks = track(each, recording, settings)
            away = np.linalg.norm(tracks.joints - sim.joints[: len(tracks.joints)], axis=-1)
            errors.append(100 * float(np.nanmean(away[15:])))
        far = [100 * float(np.mean(np.abs(b.weights / body.weights - 1))) for b in (wrong, found.fitted[0])]
        rows.append([word, *(f"{e:.2f}" for e in errors), *(f"{f:.0f}" for f in far)])
        tqdm.write(" | ".join(rows[-1]))
    head = ["noise", "true, cm", "15 % off, cm", "fitted, cm", "off by before, %", "after, %"]
    return "\nMean joint error with bands that are\n\n" + table(head, rows)


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    every: int = 1,
    frames: int = 0,
    rounds: tuple[int, ...] = (1, 3),
    parts: tuple[str, ...] = ("real", "simulated"),
    fit_options: FitSettings = FitSettings(),  # noqa: B008  frozen
    out: Path = Path(__file__).parent,
) -> None:
    """Bodies fitted to recordings, real and simulated.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        rounds: how often recordings are tracked and fitted to, beside what the fit's options say.
        parts: which of the two tables to make.
        fit_options: the fit's.
        out: folder for real.md and simulated.md.
    """
    if "real" in parts:
        write(out, "real", real(recordings, every, frames, fit_options, rounds))
    if "simulated" in parts:
        write(out, "simulated", simulated(frames, fit_options) + of_bands(frames, fit_options))


if __name__ == "__main__":
    tyro.cli(main)
