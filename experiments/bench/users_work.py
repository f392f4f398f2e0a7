"""How much faster than real time are users' logs? python -m experiments.bench.users_work [RECORDINGS] [--seconds 60]

Depth cameras of today at 30 Hz in a room with furniture: one person, three people; and of RECORDINGS real optical
markers and stereo pairs. The command is run as users run it, one log at a time, all included, after a run that
compiles, of a short log of the same kind where it is simulated.
Clips of two seconds are rendered and played there and back: what a second costs does not hang on what came before it.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import tyro

from experiments.bench.many_logs import measured, recorded_seconds
from experiments.common import table
from voodoo_jax.compile.cache_dir import cache_folder
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import Simulation, in_one_picture, simulate
from voodoo_jax.simulate.room import Room
from voodoo_jax.simulate.sensor import Camera

CLIP, RATE = 2.0, 30.0  # seconds that are rendered, frames a second


@dataclass(frozen=True)
class Work:
    """One log replayed warm."""

    seconds: float  # of the recording
    wall: float
    processor: float  # of all processes
    memory: float  # GB, the largest process

    @property
    def times_real_time(self) -> float:
        return self.seconds / self.wall

    @property
    def per_core(self) -> float:
        """Seconds of recording for a second of one processor."""
        return self.seconds / self.processor


def camera(width: int, height: int, across: float, down: float) -> Camera:
    """A depth camera with fields of view in degrees, 1.2 m above the floor."""
    fx, fy = (n / 2 / np.tan(np.radians(angle / 2)) for n, angle in ((width, across), (height, down)))
    return Camera(width, height, float(fx), float(fy), (width - 1) / 2, (height - 1) / 2, (0.0, 0.0, 1.2), 0.07)


def clip(view: Camera, people: int, seconds: float = CLIP) -> Simulation:
    """Some seconds of people who come up, side by side: who waves only stands stiller here than anybody does."""
    sides = (np.arange(people) - (people - 1) / 2) * 0.95
    statures = (1.75, 1.62, 1.86)
    found = []
    for k, (side, stature) in enumerate(zip(sides, statures)):
        body = scaled(human(), stature)
        motion = placed(make_motion(body, "walk", seconds, RATE), 4.0 + 0.1 * k, float(side), float(np.pi))
        found.append(simulate(body, motion, view, room=Room(), seed=k))
    return in_one_picture(*found)


def there_and_back(sim: Simulation, seconds: float) -> Simulation:
    """The clip again and again, backwards in between."""
    n, count = len(sim.time_ns), round(seconds * RATE)
    k = np.arange(count) % (2 * n - 2)
    k = np.where(k < n, k, 2 * n - 2 - k)
    stamps = sim.time_ns[0] + np.round(np.arange(count) * 1e9 / RATE).astype(np.int64)
    parts = {name: getattr(sim, name)[k] for name in ("depth", "rotation", "translation", "joints")}
    return replace(sim, time_ns=stamps, **parts)


def _simulated(folder: Path, view: Camera, people: int, seconds: float) -> tuple[Path, Path]:
    once, name = clip(view, people), f"{view.width}x{view.height}x{people}"
    short = write_simulation(once, folder / f"{name}-short.mcap")
    return write_simulation(there_and_back(once, seconds), folder / f"{name}.mcap"), short


def kinds(recordings: Path | None, seconds: float) -> dict[str, Callable[[Path], tuple[Path, Path]]]:
    """Makers, by name, of a log in a folder and of a short one of its kind, by which programs are compiled; cameras are
    Azure Kinect's (binned, as it is) and RealSense D455's."""
    binned, kinect, wide = camera(320, 288, 75, 65), camera(640, 576, 75, 65), camera(1280, 720, 87, 58)
    made: dict[str, Callable[[Path], tuple[Path, Path]]] = {
        "320x288": partial(_simulated, view=binned, people=1, seconds=seconds),
        "320x288_three_people": partial(_simulated, view=binned, people=3, seconds=seconds / 2),
        "640x576": partial(_simulated, view=kinect, people=1, seconds=seconds / 2),
        "1280x720": partial(_simulated, view=wide, people=1, seconds=seconds / 4),
    }
    for name, pattern in (("markers", "markers/*.mcap"), ("stereo", "stereo/*.mcap")):
        if logs := sorted((recordings or Path("none")).glob(pattern), key=lambda p: p.stat().st_size):
            made[name] = lambda folder, log=logs[-1]: (log, log)
    return made


def work(log: Path, short: Path) -> Work:
    """Replays a log, after one of its kind."""
    cache = Path(cache_folder("") or tempfile.mkdtemp())
    measured([short], 2, cache)
    found = measured([log], 2, cache)
    return Work(recorded_seconds(log), found.wall, found.processor, found.memory)


def main(
    recordings: tyro.conf.Positional[Path | None] = None, seconds: float = 60.0, only: tuple[str, ...] = ()
) -> None:
    """Prints a table.

    Args:
        recordings: folder with markers/*.mcap and stereo/*.mcap.
        seconds: length of logs of one person at 320x288; of three and of larger images a half, of 1280x720 a quarter.
        only: names of kinds.
    """
    rows = []
    for name, made in kinds(recordings, seconds).items():
        if only and name not in only:
            continue
        with tempfile.TemporaryDirectory() as folder:
            w = work(*made(Path(folder)))
        numbers = (w.seconds, w.wall, w.times_real_time, w.per_core)
        rows.append([name, *(f"{n:.1f}" for n in numbers), f"{w.memory:.2f}"])
        print(" ".join(rows[-1]), flush=True)
    print(table(["log", "recorded, s", "wall, s", "times real time", "of one core", "memory, GB"], rows))


if __name__ == "__main__":
    tyro.cli(main)
