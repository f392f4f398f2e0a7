"""Is a sensor's weight a parameter like others? python -m experiments.tuning.sensors

Simulated people between two cameras, of which the second one has several times the noise of the first. Its weight is
tuned on half of the people (`vj.tune`), and judged on the others, beside the curve of the loss along it. Writes
sensors.md.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

import voodoo_jax as vj
from experiments.common import human, table, write
from experiments.scoreboard.simulated import camera, write_log
from experiments.tuning.__main__ import Case, losses
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.frames import Truth
from voodoo_jax.fitting.problem import Problem
from voodoo_jax.model.body import scaled
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.room import Room
from voodoo_jax.simulate.sensor import TOF_NOISE

# motion, stature in metres, degrees from away from the first camera
PEOPLE = (("wave", 1.62, 150.0), ("bow", 1.70, 200.0), ("walk", 1.78, 180.0), ("wave", 1.86, 215.0))
NAME = "sensors.1.weight"
AT = (-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0)  # logarithms of the factor


def ready(kind: str, stature: float, facing: float, worse: float, size: dict[str, int]) -> Problem:
    """Somebody before two cameras of the same rate, the second one from the side, with `worse` times the noise."""
    body, room = scaled(human(), stature), Room(wall=6.6, boxes=())
    motion = placed(make_motion(body, kind, 2.0, 30.0), 3.0, 0.0, np.radians(facing))
    bad = replace(TOF_NOISE, constant=worse * TOF_NOISE.constant, quadratic=worse * TOF_NOISE.quadratic)
    places = {"first": (camera(0.0, 0.0, 0.0), TOF_NOISE), "second": (camera(3.0, -3.0, np.pi / 2), bad)}
    seen = {
        name: simulate(body, motion, view, noise, room, seed)
        for seed, (name, (view, noise)) in enumerate(places.items())
    }
    one = seen["first"]
    truth = Truth(one.time_ns, tuple(body.topology.centres), one.joints.astype(float))
    with tempfile.TemporaryDirectory() as folder:
        log = write_log(Path(folder) / "log.mcap", seen)
        return vj.problem(human(), str(log), Settings(), truth=truth, **size)


def main(
    worse: tuple[float, ...] = (3.0,),
    frames: int = 32,
    points: int = 256,
    steps: int = 6,
    pull: float = 0.0,
    out: Path = Path(__file__).parent,
) -> None:
    """A table for each factor of noise.

    Args:
        worse: times the noise of the first camera that the second one has.
        frames: of a recording that are solved, after the first half second.
        points: of a frame that are solved on.
        steps: of a search.
        pull: of the priors, see vj.tune.
        out: folder for sensors.md.
    """
    text = ""
    for factor in worse:
        size = dict(first=16, frames=frames, points=points, room=frames)
        problems = [ready(*person, factor, size) for person in tqdm(PEOPLE, "track", leave=False, disable=None)]
        curve = np.array([losses(_cases(problems), (NAME,), np.array([at])) for at in AT])
        rows = []
        for left in (0, 1):
            train, test = problems[1 - left :: 2], problems[left::2]
            tuned = vj.tune(train, [NAME], steps=steps, pull=pull)
            found = np.array([tuned.parameters[NAME]])
            for some, said in ((train, "tuned on"), (test, "left out")):
                before, after = (losses(_cases(some), (NAME,), found * by).mean() for by in (0.0, 1.0))
                cells = [f"{before:.3f}", f"{after:.3f}", f"{100 * (after / before - 1):+.1f}"]
                rows.append([f"{np.exp(found[0]):.2f}", said, *cells])
        along = [[f"{np.exp(at):.2f}", f"{row.mean():.3f}", *(f"{x:.3f}" for x in row)] for at, row in zip(AT, curve)]
        text += (
            f"Second camera with {factor:g} times the noise of the first.\n\n"
            f"{table(['weight found', 'people', 'loss, cm', 'tuned', 'change, %'], rows)}\n"
            f"{table(['weight', 'loss, cm', *(f'{k} {s:.2f} m' for k, s, _ in PEOPLE)], along)}\n"
        )
    write(out, "sensors", text.rstrip() + "\n")


def _cases(problems: list[Problem]) -> list[Case]:
    return [Case(None, 0.0, one, 0.0) for one in problems]  # pyright: ignore[reportArgumentType]


if __name__ == "__main__":
    tyro.cli(main)
