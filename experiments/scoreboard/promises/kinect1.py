"""Real depth with a reference: a Kinect v1, the person cut out of the picture, beside its SDK's skeleton.

The reference's numbering of frames is ahead of the images': its wrists are nearest to the points of a later image. How
much later is measured here by the points alone, and joints are compared as the files say and at that delay.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

import voodoo_jax as vj
from experiments.common import nearest
from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.tracked import read_known, recording_of

# of the head and the hips the SDK has another definition
DEFINED = ("vc7", *(f"{side}_{n}" for side in "lr" for n in "shoulder elbow radiocarpal knee talocrural".split()))
WRISTS, FAST = ("l_radiocarpal", "r_radiocarpal"), 1.0  # metres per second: so fast a wrist tells when it was measured
DELAYS = range(5)  # frames


@dataclass(frozen=True)
class Beside:
    """How far the reference's fast wrists are from the nearest point, and joints from the reference, on average and
    without a constant offset of each, at each delay of the images, cm; NaN: lost."""

    log: Path
    seconds = 12.0

    def run(self) -> np.ndarray:
        recording = recording_of(self.log)
        tracks, known = vj.track(vj.human(), recording), read_known(self.log.with_suffix(".truth.npz"))
        names = [n for n in DEFINED if n in known.names]
        frame, near = nearest(known, tracks)
        mine = [tracks.body.topology.centres.index(n) for n in names]
        reference = known.joints[:, [known.names.index(n) for n in names]]
        wrists = known.joints[:, [known.names.index(n) for n in WRISTS]]
        speed = np.linalg.norm(np.gradient(wrists, known.stamps / 1e9, axis=0), axis=-1).max(1)
        fast = np.flatnonzero((speed > FAST) & near & (frame + DELAYS[-1] < len(tracks.joints)))
        found = np.full((len(DELAYS), 3), np.nan)
        for delay in DELAYS:
            there = near & (frame + delay < len(tracks.joints))
            off = tracks.joints[frame[there] + delay][:, mine] - reference[there]
            off = off[np.isfinite(off).all((1, 2))]
            away = [KDTree(recording.frames[frame[k] + delay].points).query(wrists[k])[0].mean() for k in fast]
            if len(off) >= 0.8 * (len(known.stamps) - delay):
                sizes = [np.linalg.norm(x, axis=-1).mean() for x in (off, off - np.median(off, 0))]
                found[delay] = 100 * np.array([np.mean(away) if away else np.nan, *sizes])
        return found


def measure(found: Sequence[np.ndarray]) -> dict[str, float]:
    """Means over the logs that are tracked, and how many are not."""
    table = np.array(found)
    away, off, free = np.nanmean(table, 0).T
    delay = int(np.argmin(away))
    return {
        "joints, cm": float(off[0]),
        "without constant offsets, cm": float(free[0]),
        "lost": int(np.isnan(table[:, 0, 1]).sum()),
        "images later than the reference, frames": delay,
        "so much later: joints, cm": float(off[delay]),
        "so much later: without constant offsets, cm": float(free[delay]),
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
        Figure("images later than the reference, frames", None, digits=0),
        Figure("so much later: joints, cm", None, tolerance=0.5),
        Figure("so much later: without constant offsets, cm", None, tolerance=0.3),
    ),
    jobs=jobs,
    measure=measure,
)
