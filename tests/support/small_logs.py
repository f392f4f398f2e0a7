"""Many small logs that are tracked in no time: a robot's arm that swings, few points, few frames."""

from pathlib import Path

import numpy as np

from voodoo_jax.config.options import DetectSettings, Settings, StartSettings, TrackSettings
from voodoo_jax.model.body import Body, scaled
from voodoo_jax.model.body_file import load_body
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera

FLAGS = (
    "--body arm --start.scale 0.8 --start.headings 3 --start.frames 2 --detect.points 256 --track.chunk 16 "
    "--track.skip looks_ahead"
).split()
SETTINGS = Settings(
    detect=DetectSettings(points=256),
    start=StartSettings(scale=0.8, headings=3, frames=2),
    track=TrackSettings(chunk=16, skip=("looks_ahead",)),
)
NOT_COMPARED = {"seconds", "source", "run_key", "digest"}  # of the time taken, and of where the log lay


def small_body() -> Body:
    return load_body("arm")


def small_log(path: Path, frames: int, seed: int = 0) -> Path:
    """An arm of 0.8 m seen by a depth camera at 20 Hz."""
    moved = placed(make_motion(scaled(small_body(), 0.8), "swing", frames / 20.0, 20.0), 1.8, 0.0, 2.3)
    return write_simulation(simulate(scaled(small_body(), 0.8), moved, tof_camera(0.7, 0.15), seed=seed), path)


def arrays_of(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    """What is in each tracks file of a folder, without what may differ between two runs."""
    out = {}
    for path in sorted(folder.glob("*.tracks.npz")):
        with np.load(path, allow_pickle=False) as file:
            out[path.name] = {name: file[name] for name in file.files if name not in NOT_COMPARED}
    return out


def assert_same(one: dict[str, dict[str, np.ndarray]], other: dict[str, dict[str, np.ndarray]]) -> None:
    """To the last bit."""
    assert one.keys() == other.keys()
    for name, arrays in one.items():
        assert arrays.keys() == other[name].keys()
        for key, value in arrays.items():
            np.testing.assert_array_equal(value, other[name][key], err_msg=f"{name}, {key}")
