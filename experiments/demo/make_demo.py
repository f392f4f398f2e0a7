"""Makes the demo recording that the package brings along: python experiments/demo/make_demo.py

Writes voodoo_jax/data/demo.mcap and demo.truth.npz (another folder: first argument). Wholly simulated, seeded, the same
bytes on every run of one machine: a person of 1.74 m, whose limbs are not quite those of the default body, stands
relaxed 2.8 m in front of a time-of-flight camera, turned 20 degrees away from facing it, waves and bows a little.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from voodoo_jax.model.body import Body, scaled, with_proportions
from voodoo_jax.model.body_file import human
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed, sequence
from voodoo_jax.simulate.recording import Simulation, simulate
from voodoo_jax.simulate.sensor import TOF_NOISE, tof_camera

STATURE = 1.74  # metres
RATE = 30.0  # frames per second


def demo_body() -> Body:
    """A person near the default body, but not it: thicker by 5 %, arms longer by 2 %."""
    arms = [f"{side}_{part}" for side in "lr" for part in ("upper_arm", "forearm", "hand")]
    return with_proportions(scaled(human(), STATURE), dict.fromkeys(arms, 1.02), girth=1.05)


def demo() -> Simulation:
    """The demo recording and its truth, in memory."""
    body = demo_body()
    parts = [("stand", 0.5), ("wave", 1.9), ("bow", 1.5)]
    motion = sequence(*(make_motion(body, name, seconds, RATE) for name, seconds in parts))
    # nothing beyond 4.5 m: the noise of an empty wall would be most of the file
    noise = replace(TOF_NOISE, max_range=4.5)
    return simulate(body, placed(motion, 2.8, 0.05, np.pi + np.radians(20)), tof_camera(), noise, seed=1)


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[2] / "voodoo_jax" / "data"
    folder.mkdir(parents=True, exist_ok=True)
    path = write_simulation(demo(), folder / "demo.mcap")
    sizes = [f.stat().st_size for f in (path, path.with_suffix(".truth.npz"))]
    print(f"{path}: {sizes[0]} bytes, truth {sizes[1]} bytes")
