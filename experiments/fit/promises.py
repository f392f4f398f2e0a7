"""What `voodoo-jax fit` promises, as plain figures: python -m experiments.fit.promises [RECORDINGS]

Four functions, each of which can be called on a part of its data. Times on two cores, after the 40 to 80 s that
compiling takes once in a process: a recording of 110 frames 10 to 15 s in the first two, a simulated one 10 s in the
third; the two recoveries of the last 3 to 5 minutes each.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from experiments.common import DEMO, human, load_dims, load_log, log_files, score
from experiments.fit.__main__ import LIMBS, SURFACE, exercise, exercised, of_size, off, recording_of
from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.fit import Seen, fit_tracked
from voodoo_jax.fitting.front import fit
from voodoo_jax.fitting.result import Fit
from voodoo_jax.model.body import Body, scaled, segment_lengths, with_proportions
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.room import Room
from voodoo_jax.simulate.sensor import NO_NOISE, TOF_NOISE

WRONG: dict[str, float] = dict.fromkeys(LIMBS, 1.08)  # upper arms, forearms, thighs and shanks are each 8 % too long
MIXED = {"upper_arm": 0.92, "forearm": 1.08, "thigh": 1.08, "shank": 0.92}
SHORT: dict[str, float] = dict.fromkeys(LIMBS, 0.92)
CASES: dict[str, dict[str, float]] = {"usual": {}, "8 % long": WRONG, "8 % short": SHORT, "8 % mixed": MIXED}
FAR = {"thigh": 1.15, "shank": 0.85, "upper_arm": 0.85, "forearm": 1.15}


@dataclass(frozen=True)
class Outcome:
    """What a fit to recordings of one person leaves the user with."""

    name: str
    written: bool
    joints_before: float  # mean joint error, cm: tracked with the body that the fit began from
    joints_after: float  # with the fitted body if it is written, else with the other again
    segments_before: float  # mean error of the reported segments, cm
    segments_after: float
    why: str


def wrong(body: Body, factors: Mapping[str, float]) -> Body:
    """The body with segments longer by a factor, left and right; what hangs on them moves along."""
    return with_proportions(body, {f"{s}_{k}": v for k, v in factors.items() for s in "lr"})


def _paths(recordings: Path, logs: Sequence[str]) -> list[Path]:
    return [p for p in log_files(Path(recordings)) if not logs or p.stem in logs]


@cache
def _log(path: Path):
    return load_log(path, human(), Settings())


def fitted_to(paths: Sequence[Path], body: Body, options: FitSettings = FitSettings()) -> list[Outcome]:  # noqa: B008
    """A fit to all recordings together, as users run it (depth and features, no truth); one outcome for each."""
    settings = Settings()
    logs = [_log(path) for path in paths]
    seen = [Seen(log.track(body, settings), log.people, log.scene, body) for log in logs]
    found = fit_tracked(seen, settings, options)
    out = []
    for path, log, one in zip(paths, logs, seen):
        after = log.track(found.body, found.tuned) if found.better else one.tracks
        dims, known = load_dims(path), (one.tracks, after)
        segments = [float(np.mean(np.abs(list(off(t.body, dims).values())))) for t in known]
        joints = [score(log, t).error_cm for t in known]
        out.append(Outcome(log.name, found.better, joints[0], joints[1], segments[0], segments[1], found.verdict.why))
    return out


def fit_leaves_no_log_worse(recordings: Path, logs: Sequence[str] = ()) -> list[Outcome]:
    """Begun from the body that comes with the package: what each recording is left with. `logs` names; none: all."""
    return [o for path in _paths(recordings, logs) for o in fitted_to([path], human())]


def recovery_from_wrong_lengths(
    recordings: Path, logs: Sequence[str] = (), factors: Mapping[str, float] = WRONG
) -> list[Outcome]:
    """Begun from a body whose segments are wrong by some factors. `logs` names; none: all."""
    return [o for path in _paths(recordings, logs) for o in fitted_to([path], wrong(human(), factors))]


def refuses_noise(count: int = 10, every: int = 2) -> list[bool]:
    """Whether a fit leaves a right body alone, log by log: simulated people of different statures whose body is the one
    that the fit begins from, and nothing but the sensor's noise (another seed each); every `every`-th frame."""
    out = []
    for seed in range(count):
        body = scaled(human(), 1.60 + 0.03 * seed)
        m = exercise(body)
        moved = replace(m, time=m.time[::every], root=m.root[::every], rotations=m.rotations[::every])
        sim = simulate(body, moved, noise=TOF_NOISE, room=Room(wall=6.0, boxes=()), seed=seed)
        out.append(not fit(human(), [recording_of(sim)]).better)
    return out


def recovery(noise: bool, frames: int = 0) -> Fit:
    """The fit of limbs that are 15 % off to a simulated person whose stature is known, with or without noise."""
    sim, recording = exercised(TOF_NOISE if noise else NO_NOISE, frames)
    start = wrong(sim.body, FAR)
    # cylinders are seen, only lengths are wrong, and by much: little noise, wide priors, logs tracked again
    options = FitSettings(looseness=10.0, rounds=4, frames=48, points=512, noise=SURFACE)
    return fit(start, [recording], of_size(float(start.scale)), options)


def recovers_simulated(noise: bool, frames: int = 0) -> dict[str, float]:
    """How far each segment is from the simulated person's after that fit, cm."""
    sim, _ = exercised(TOF_NOISE if noise else NO_NOISE, frames)
    return off(recovery(noise, frames).body, segment_lengths(sim.body))


def main(
    recordings: tyro.conf.Positional[Path] = DEMO, logs: tuple[str, ...] = (), noise: int = 10, out: Path | None = None
) -> None:
    """Prints all figures as JSON lines.

    Args:
        recordings: folder with *.mcap and *.truth.npz.
        logs: names of recordings; none: all.
        noise: how many logs of nothing but noise.
        out: file to add them to as well.
    """

    def say(name: str, value: object) -> None:
        line = json.dumps({name: value})
        tqdm.write(line)
        if out is not None:
            with open(out, "a", encoding="utf-8") as file:
                file.write(line + "\n")

    for path in tqdm(_paths(recordings, logs), "fit", unit="log", disable=None):
        for word, factors in CASES.items():
            for outcome in fitted_to([path], wrong(human(), factors)):
                say(word, asdict(outcome))
        _log.cache_clear()
    say("refuses noise", refuses_noise(noise))
    for word in (False, True):
        say(f"simulated, {'with' if word else 'no'} noise", recovers_simulated(word))


if __name__ == "__main__":
    tyro.cli(main)
