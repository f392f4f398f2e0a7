"""Bodies that are no people."""

from dataclasses import dataclass

import numpy as np

from experiments.animals.dogs import EFFORT, SIZES, Found, Take, work
from experiments.scoreboard.board import Data, Figure, Promise


@dataclass(frozen=True)
class Dog:
    """A simulated dog, as experiments/animals has them."""

    what: str
    seed: int
    seconds = 12.0

    def run(self) -> Found:
        return work(Take(self.what, self.seed))


def jobs(data: Data) -> list[Dog]:
    """Six of each kind; quick: two that turn, whose figures are far better than those of all."""
    if data.quick:
        return [Dog("turns", seed) for seed in (1, 3)]
    return [Dog(what, seed) for what in EFFORT for seed in range(len(SIZES))]


PROMISE = Promise(
    name="animals",
    sentence="Simulated dogs of unknown size: mostly tracked, 11 cm and 81 % within 10 cm; those that turn 2.7 cm.",
    data="24 dogs that stand, trot by, turn and come up",
    figures=(
        Figure("joints, cm", 11.0, tolerance=1.0, digits=1),
        Figure("within 10 cm, %", 80.0, "more", 3.0, 1),
        Figure("said to be tracked, %", None),
        Figure("withers, cm", None, digits=1),
    ),
    jobs=jobs,
    measure=lambda dogs: {
        "joints, cm": float(np.mean([d.error_cm for d in dogs])),
        "within 10 cm, %": float(np.mean([d.within for d in dogs])),
        "said to be tracked, %": float(np.mean([d.tracked for d in dogs])),
        "withers, cm": float(np.mean([d.withers_cm for d in dogs])),
    },
)
