"""Band weights that are wrong by factors of 4 and 1/4, tuned back by `fit --folds`, on people, dogs and arms:
python -m experiments.fit.folds KIND [RECORDINGS]

Half of a body's bands are made four times as heavy, the others four times as light, left and right alike; which ones is
drawn at random. Every fold is then tracked with what the others gave, and with the weights of the package. Dogs and
arms are simulated, made of the body's own limbs.
"""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import tyro

from experiments.animals.dogs import BOX, EFFORT, SIZES, moved, steps
from experiments.common import human, load_dims, log_files
from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.fit import Seen, TruthLike, track_again
from voodoo_jax.fitting.folds import fit_folds
from voodoo_jax.fitting.frames import Truth, read_truth
from voodoo_jax.fitting.judge import judged_by
from voodoo_jax.fitting.seen import tracked
from voodoo_jax.geometry.rigid import Poses, compose, quat_exp
from voodoo_jax.model.body import Body, scaled, without_side
from voodoo_jax.model.body_file import load_body
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import motion_of_turns
from voodoo_jax.simulate.recording import Simulation, simulate
from voodoo_jax.simulate.room import Box, Room
from voodoo_jax.simulate.sensor import tof_camera

RATE, SECONDS = 30, 3.0  # of the simulated logs
WRONG = 4.0  # factor of the weights, or its inverse
CAMERA = tof_camera(1.0, 0.12)


def made_wrong(body: Body, seed: int) -> Body:
    """The body with half of its bands WRONG times as heavy, the others as light."""
    names = list(dict.fromkeys(map(without_side, body.topology.joints)))
    powers = np.random.default_rng(seed).permutation(np.arange(len(names)) % 2 * 2.0 - 1)
    factor = dict(zip(names, WRONG**powers))
    weights = np.asarray(body.weights) * [factor[without_side(j)] for j in body.topology.joints]
    return eqx.tree_at(lambda b: b.weights, body, weights.astype(np.float32))


def people(recordings: Path, seed: int) -> list[tuple[Path, Truth]]:
    """One recording of each person, drawn at random."""
    files = log_files(recordings)
    drawn = [files[i] for i in np.random.default_rng(seed).permutation(len(files))]
    of = {round(load_dims(f)["stature"], 3): f for f in drawn}
    return [(f, read_truth(f.with_suffix(".truth.npz"))) for f in of.values()]


def dog(number: int, body: Body | None = None) -> Simulation:
    """A dog that turns or trots by; with proportions of its own where a `body` is given."""
    body, rng = scaled(body or load_body("dog"), SIZES[number % len(SIZES)]), np.random.default_rng(number)
    what = "trots by" if number % 4 == 2 else "turns"
    room = Room(boxes=(Box(4.2, 2.3, BOX, 0.3),))
    return simulate(body, moved(steps(body, EFFORT[what]), what, rng), CAMERA, room=room, seed=number)


def arm(number: int, body: Body | None = None) -> Simulation:
    """An arm that swings about all its joints."""
    body, rng = body or load_body("arm"), np.random.default_rng(number)
    time = np.arange(round(SECONDS * RATE)) / RATE

    def swing(size: float) -> np.ndarray:
        hertz, phase = rng.uniform(0.3, 0.8), rng.uniform(0, 2 * np.pi)
        return size * np.minimum(1, time / 0.7) * np.sin(2 * np.pi * hertz * time + phase)

    turns = {j: np.stack([swing(0.3), swing(0.7), swing(0.3)], -1) for j in body.topology.joints}
    motion, still = motion_of_turns(body, time, turns), np.zeros_like(time)
    facing = quat_exp(jnp.asarray(np.stack([still, still, np.pi + rng.uniform(-0.6, 0.6) + still], -1), jnp.float32))
    place = jnp.asarray(np.stack([rng.uniform(1.8, 2.4) + still, still, still], -1), jnp.float32)
    motion = replace(motion, root=compose(Poses(facing, place), motion.root))
    return simulate(body, motion, CAMERA, room=Room(boxes=()), seed=number)


def simulated(kind: Callable[[int], Simulation], logs: int, seed: int, folder: Path) -> list[tuple[Path, Truth]]:
    """Logs of a kind, written into a folder."""
    found = []
    for number in range(seed * logs, (seed + 1) * logs):
        sim = kind(number)
        path = Path(write_simulation(sim, folder / f"{number}.mcap"))
        found.append((path, Truth(sim.time_ns, sim.body.topology.centres, sim.joints)))
    return found


def off_cm(seen: list[Seen], settings: Settings, weights: np.ndarray, truths: list[TruthLike]) -> float:
    """Mean joint error of logs tracked with other band weights, each with the body that was sized in it; cm."""
    means = []
    for one, truth in zip(seen, truths):
        body = eqx.tree_at(lambda b: b.weights, one.tracks.body, weights)
        now = track_again(one, body, settings).tracks
        assert isinstance(truth, Truth)
        means.append(np.nanmean(judged_by(now, now, 0, truth).joints_after))
    return 100 * float(np.mean(means))


def main(
    kind: tyro.conf.Positional[Literal["people", "dog", "arm"]],
    recordings: tyro.conf.Positional[Path] = Path(),
    logs: int = 8,
    folds: int = 2,
    seed: int = 0,
    looseness: float = 1.0,
    rounds: int = 1,
) -> None:
    """Prints the mean joint error of logs left out: with wrong weights, with tuned ones, with those of the package.

    Args:
        kind: of bodies.
        recordings: folder of the recordings of people, with their truth.
        logs: how many dogs or arms.
        folds: how often some logs are left out.
        seed: of what is drawn.
        looseness: of the fit's priors.
        rounds: of the fit.
    """
    body = human() if kind == "people" else load_body(kind)
    settings = Settings()
    if kind == "arm":  # the size of an arm is not looked for here
        settings = replace(settings, start=replace(settings.start, scale=float(body.scale)))
    with tempfile.TemporaryDirectory() as folder:
        made = {"dog": dog, "arm": arm}
        both = people(recordings, seed) if kind == "people" else simulated(made[kind], logs, seed, Path(folder))
        paths, truths = [p for p, _ in both], [t for _, t in both]
        seen = tracked(made_wrong(body, seed), paths, settings)
    free = FitSettings(free=("bands.*.weight",), folds=folds, persons="each", looseness=looseness, rounds=rounds)
    fit = fit_folds(seen, settings, free, truths)
    mean = lambda side: 100 * float(np.mean([np.nanmean(getattr(j, side)) for j in fit.judged]))  # noqa: E731
    wrong, tuned = mean("joints_before"), mean("joints_after")
    right = off_cm(seen, settings, np.asarray(body.weights), list(truths))
    print(f"{kind}, {len(paths)} logs, {folds} folds: wrong {wrong:.3f}, tuned {tuned:.3f}, package {right:.3f} cm")
    print(fit.verdict.why)
    for one in fit.judged:
        print(f"  {one.name}: {100 * np.nanmean(one.joints_before):.2f} -> {100 * np.nanmean(one.joints_after):.2f} cm")


if __name__ == "__main__":
    tyro.cli(main)
