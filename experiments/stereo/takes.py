"""Which people do what before which stereo pair, in which room and light: half of it to choose by, half to judge."""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.people.pictures import DAY, RIGS, Light
from experiments.people.takes import Take

MOST = 105  # frames of a clip at most, its liveliest
# what is done, and radians from facing the camera; choosing: clips of DeepMimic, judging: of Bandai-Namco, and both
# the ways to sit
CHOOSING = (
    ("kick", 0.2), ("kick", -0.8), ("punch", 0.0), ("punch", 0.7), ("dance_b", -0.3), ("dance_a", 0.4), ("walk", 0.9),
    ("spin", 0.0), ("sits down and stands up", 0.3), ("exercise", -0.2),
)  # fmt: skip
JUDGING = (
    ("kick_normal_001", 0.1), ("punch_normal_001", -0.4), ("punch_normal_002", 0.5), ("dance-short_normal_001", 0.0),
    ("slash_normal_001", 0.4), ("respond_normal_001", 0.0), ("walk_proud_001", -0.6), ("byebye_musical_001", 0.2),
    ("sits down and stands up", -0.4), ("run_proud_001", 0.3),
)  # fmt: skip
LIGHTS = (
    DAY, Light((-1, -0.8, 0.5), 0.35), Light((-0.3, 0.2, 1.5), 0.6, 0.8),
    Light((-1, 0.9, 0.9), 0.4, 1.0, (0.9, 1, 1.1)), Light((-0.8, 0, 0.4), 0.5, 0.6, (1.1, 1, 0.92)),
    Light((-0.5, -1, 1), 0.3, 1.1),
)  # fmt: skip


class Half(NamedTuple):
    """Logs that settings may be chosen by, or that judge them."""

    name: str
    takes: list[Take]


def halves(meshes: Path, motions: Path, logs: Path, seed: int = 57) -> list[Half]:
    """All logs. No person is in both halves, rooms and clothes are drawn for each log."""
    people = len(np.load(meshes)["vertices"])
    rng = np.random.default_rng(seed)
    order, out = rng.permutation(people), []
    take = partial(Take, meshes=meshes, motions=motions, logs=logs, most=MOST, camera=list(RIGS)[0])
    for half, (name, done) in enumerate((("choosing", CHOOSING), ("judging", JUDGING))):
        who = order[half::2]
        out.append(Half(name, [
            take(
                name, f"{name}-{k}-{clip.replace(' ', '-').split('_normal')[0]}", int(who[k % len(who)]), clip, yaw,
                bool(rng.integers(2)), float(rng.uniform(0.85, 1.1)), furnished=k % 3 == 2,
                seed=seed * 1000 + 100 * half + k, light=LIGHTS[int(rng.integers(len(LIGHTS)))],
            )
            for k, (clip, yaw) in enumerate(done)
        ]))  # fmt: skip
    return out
