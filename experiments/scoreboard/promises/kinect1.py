"""Real depth with a reference: a Kinect v1, the person cut out of the picture, beside its SDK's skeleton."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import voodoo_jax as vj
from experiments.common import nearest
from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.tracked import read_known, recording_of

# of the head and the hips the SDK has another definition
DEFINED = ("vc7", *(f"{side}_{n}" for side in "lr" for n in "shoulder elbow radiocarpal knee talocrural".split()))


@dataclass(frozen=True)
class Beside:
    """How far joints are from the reference: on average, and without a constant offset of each, cm; NaN: lost."""

    log: Path
    seconds = 12.0

    def run(self) -> tuple[float, float]:
        tracks, known = vj.track(vj.human(), recording_of(self.log)), read_known(self.log.with_suffix(".truth.npz"))
        names = [n for n in DEFINED if n in known.names]
        frame, near = nearest(known, tracks)
        mine = [tracks.body.topology.centres.index(n) for n in names]
        off = tracks.joints[frame][:, mine] - known.joints[:, [known.names.index(n) for n in names]]
        off = off[near & np.isfinite(off).all((1, 2))]
        if len(off) < 0.8 * len(known.stamps):
            return float("nan"), float("nan")
        free = off - np.median(off, 0)
        return tuple(100 * float(np.linalg.norm(x, axis=-1).mean()) for x in (off, free))  # type: ignore[return-value]


def measure(found: Sequence[tuple[float, float]]) -> dict[str, float]:
    """Means over the logs that are tracked, and how many are not."""
    table = np.array(found, float)
    return {
        "joints, cm": float(np.nanmean(table[:, 0])),
        "without constant offsets, cm": float(np.nanmean(table[:, 1])),
        "lost": int(np.isnan(table[:, 0]).sum()),
    }


def jobs(data: Data) -> list[Beside]:
    """A job for each log; quick: four."""
    return [Beside(log) for log in data.part(data.logs("real/kinect1"), 4)]


PROMISE = Promise(
    name="kinect1",
    sentence="Beside a real Kinect v1's own skeleton joints are 6.5 cm off, 2.8 cm without constant offsets.",
    data="the recordings in real/kinect1/, without head and hips, of which the reference has another definition",
    figures=(
        Figure("joints, cm", 6.5, tolerance=0.5),
        Figure("without constant offsets, cm", 2.8, tolerance=0.3),
        Figure("lost", 0, tolerance=0, digits=0),
    ),
    jobs=jobs,
    measure=measure,
)
