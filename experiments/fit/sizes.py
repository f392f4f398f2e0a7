"""Sizes of what is no person: arms and dogs whose segments are 5 to 10 % longer or shorter than those of the body that
the fit begins from: python -m experiments.fit.sizes [KIND]

They are simulated, made of the body's own limbs, with the sensor's noise. How large they are is not known, either.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from tqdm import tqdm

from experiments.common import table
from experiments.fit.folds import arm, dog
from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.front import fit
from voodoo_jax.fitting.parameters import changed, named_changes
from voodoo_jax.model.body import Body, segment_lengths, without_side
from voodoo_jax.model.body_file import load_body
from voodoo_jax.simulate.mcap import write_simulation

LIMBS = {"arm": ("upper", "lower"), "dog": ("trunk", "foreleg", "hindleg")}
LEAST, MOST = 0.05, 0.10


def other(kind: str, seed: int) -> Body:
    """A body of a kind with other lengths, left and right alike."""
    body, rng = load_body(kind), np.random.default_rng(seed)
    by = {f"lengths.{k}": np.log1p(rng.choice((-1, 1)) * rng.uniform(LEAST, MOST)) for k in LIMBS[kind]}
    return changed(body, named_changes(body, by))


def off(found: Body, true: Body) -> dict[str, float]:
    """By how much each reported segment is too long, percent of it; left and right as one."""
    asked, has = segment_lengths(true), segment_lengths(found)
    return {without_side(name): 100 * (has[name] / length - 1) for name, length in asked.items()}


# 6 parameters: which bodies, and how they are fitted
def main(
    kind: tyro.conf.Positional[Literal["arm", "dog"]] = "arm",
    bodies: int = 3,
    logs: int = 2,
    rounds: int = 3,
    looseness: float = 10.0,
    noise: float = 0.001,
) -> None:
    """Prints how far off each segment is before and after, percent.

    Args:
        kind: of bodies.
        bodies: how many.
        logs: of each.
        rounds: of the fit.
        looseness: of its priors.
        noise: of a surface that is made of cylinders, metres.
    """
    settings, rows, size = Settings(), [], {"arm": arm, "dog": dog}[kind]
    start = load_body(kind)
    if kind == "arm":  # what is no tallest point tells no size: that of the data sheet
        settings = replace(settings, start=replace(settings.start, scale=float(start.scale)))
    options = FitSettings(
        free=tuple(f"lengths.{k}" for k in LIMBS[kind]), rounds=rounds, looseness=looseness, noise=noise
    )
    for seed in tqdm(range(bodies), kind, leave=False, disable=None):
        with tempfile.TemporaryDirectory() as folder:
            # dogs of one size, of which every other one trots
            sims = [size(seed + 6 * k, other(kind, seed)) for k in range(logs)]
            paths = [write_simulation(sim, Path(folder) / f"{k}.mcap") for k, sim in enumerate(sims)]
            found = fit(start, paths, settings, options)
        before, after = (off(body, sims[0].body) for body in (found.starts[0], found.fitted[0]))
        rows.append([str(seed), *(f"{before[k]:+.1f} to {after[k]:+.1f}" for k in before), str(found.better)])
        tqdm.write(" | ".join(rows[-1]))
    print(table(["body", *before, "written"], rows))


if __name__ == "__main__":
    tyro.cli(main)
