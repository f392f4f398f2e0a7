"""A person who waves before a colour and depth camera, simulated, and settings with which following them is quick."""

from pathlib import Path

import numpy as np

import voodoo_jax as vj
from voodoo_jax.config.options import FlexibleSettings
from voodoo_jax.simulate.colour import simulate_colour
from voodoo_jax.simulate.mcap import write_colour
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.sensor import NO_NOISE, Camera

CAMERA = Camera(160, 120, 145.0, 145.0, 79.5, 59.5, (0.0, 0.0, 1.2), 0.08)
# a program of its own size: few particles and rounds, for the test's time
SMALL = FlexibleSettings(particles=30, hypotheses=2, layers=2, refine=4, points=128, backwards=False)


def waving_log(folder: Path, frames: int) -> tuple[Path, np.ndarray]:
    """The log, and the true joint centres."""
    body = vj.human()
    motion = placed(make_motion(body, "wave", frames / 15, 15.0), 2.6, 0.0, np.pi)
    sim = simulate_colour(body, motion, (CAMERA,), CAMERA, noise=NO_NOISE)
    return write_colour(sim, folder / "waving.mcap"), sim.joints
