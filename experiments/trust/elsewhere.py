"""How well a body fits: the numbers FITS and SURELY of voodoo_jax/trackers/icp/confidence.py and what they are worth.

python -m experiments.trust.elsewhere KIND=FOLDER ... tracks logs of several kinds, fits the numbers on all kinds but
one, and compares what they say with what is right in that one. A folder holds *.mcap with *.truth.npz beside them; of
a log without a truth every joint counts as wrong (of a kind whose name begins with "nobody": there is nobody to be
right about), so leave those out that are not known.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from scipy.optimize import minimize
from scipy.special import expit, log_expit
from tqdm import tqdm

import voodoo_jax as vj
from experiments.common import errors, nearest, table
from experiments.judged import trials
from experiments.scoreboard.tracked import read_known
from experiments.trust.__main__ import rank
from voodoo_jax.records.tracks import Status
from voodoo_jax.trackers.icp.confidence import (
    CLOSE,
    MISFITS,
    ONE_PASS,
    THERE_AND_BACK,
    Trust,
    clues,
    misfits,
    probability,
)

HOME = {
    "recordings": 5.0,
    "every fifth frame": 3.0,
    "controls": 3.0,
}  # times that these count
SUREST = 9.0  # SURELY at most: all some fifty decisions were right, and would ask for more
FAR = 9.0  # odds beyond which nothing changes
WEAK = 3e-4  # weight of the squared slopes


@dataclass(frozen=True)
class Job:
    """A log, its kind, and every so many-th frame of it."""

    kind: str
    log: Path
    step: int = 1


class Told(NamedTuple):
    """Of the joints that something is said of."""

    kind: str
    plain: np.ndarray  # [joint] what is said without a look at how well the body fits
    misfits: np.ndarray  # [joint, misfit]
    odds: np.ndarray  # [joint] of facing; FAR where it makes no difference
    close: np.ndarray  # [joint] bool


def work(job: Job) -> Told:
    """Tracks a log and compares."""
    recording = vj.read_log(job.log)
    if job.step > 1:
        recording = vj.Recording(**{**vars(recording), "frames": recording.frames[:: job.step]})
    tracks = vj.track(vj.human(), recording)
    plain = probability(THERE_AND_BACK, clues(tracks))
    plain = np.where(np.isfinite(plain), plain, probability(ONE_PASS, clues(tracks)))
    fit, odds = misfits(tracks), facing(tracks)
    told = np.isin(tracks.status, (Status.TRACKED, Status.LOST))
    truth = job.log.with_suffix(".truth.npz")
    if truth.exists():
        known = read_known(truth)
        frame, near = nearest(known, tracks)
        use, columns = frame[near & told[frame]], [tracks.body.topology.centres.index(n) for n in known.names]
        close = errors(known, tracks)[near & told[frame]] < CLOSE
    else:
        use, columns = np.flatnonzero(told), list(range(plain.shape[1]))
        close = np.zeros((len(use), len(columns)), bool)
    plain, fit, odds = (each[use][:, columns] for each in (plain, fit, odds))
    good = np.isfinite(plain) & np.isfinite(fit).all(-1)
    return Told(job.kind, plain[good], fit[good], odds[good], close[good])


def facing(tracks: vj.Tracks) -> np.ndarray:
    """[frame, joint] Odds of facing, FAR where they make no difference."""
    sides = [name.startswith(("l_", "r_")) for name in tracks.body.topology.centres]
    odds = np.full((len(tracks.status), len(sides)), FAR)
    if tracks.facing_odds is not None and (known := np.flatnonzero(np.isfinite(tracks.facing_odds))).size:
        last = known[np.maximum(np.searchsorted(known, np.arange(len(odds)), "right") - 1, 0)]
        odds[:, sides] = np.minimum(tracks.facing_odds[last], FAR)[:, None]
    return odds


def fitted(told: list[Told]) -> tuple[Trust, float]:
    """FITS and SURELY with the highest likelihood; misfit can only lower the probability."""
    plain, x, odds, close = (np.concatenate([getattr(t, name) for t in told]) for name in Told._fields[1:])
    weight = np.concatenate([np.full(len(t.close), HOME.get(t.kind, 1.0)) for t in told])
    weight, y = weight / weight.sum(), close.astype(float)
    middle, spread = x.mean(0), np.maximum(x.std(0), 1e-9)
    rows = np.c_[np.ones(len(x)), (x - middle) / spread]

    def cost(v: np.ndarray) -> tuple[float, np.ndarray]:
        z, surely = rows @ v[:-1], np.exp(v[-1])
        p = np.clip(plain * np.exp(log_expit(z) + log_expit(surely * odds)), 1e-9, 1 - 1e-7)
        pull = -weight * (y - (1 - y) * p / (1 - p))
        slope = rows.T @ (pull * expit(-z)) + 2 * WEAK * np.r_[0, v[1:-1]]
        value = -np.sum(weight * (y * np.log(p) + (1 - y) * np.log1p(-p))) + WEAK * v[1:-1] @ v[1:-1]
        return float(value), np.r_[slope, np.sum(pull * expit(-surely * odds) * odds * surely)]

    bounds = [(None, None), *[(None, 0.0)] * x.shape[1], (np.log(3.0), np.log(SUREST))]
    begin = np.r_[3.0, -np.ones(x.shape[1]), np.log(6.0)]
    v = minimize(cost, begin, jac=True, method="L-BFGS-B", bounds=bounds).x
    slopes = v[1:-1] / spread
    return Trust(float(v[0] - slopes @ middle), tuple(float(s) for s in slopes)), float(np.exp(v[-1]))


def said(told: Told, fits: Trust, surely: float) -> np.ndarray:
    """[joint] The probability that is said."""
    return told.plain * probability(fits, told.misfits) * expit(surely * told.odds)


def main(kinds: tyro.conf.Positional[tuple[str, ...]], processes: int = 2) -> None:
    """How well a body fits, by kinds of logs that are left out.

    Args:
        kinds: KIND=FOLDER, or KIND=FOLDER:STEP for every so many-th frame only.
        processes: how many work at once.
    """
    jobs = []
    for kind, folder in (one.split("=", 1) for one in kinds):
        folder, _, step = folder.partition(":")
        jobs += [Job(kind, log, int(step or 1)) for log in sorted(Path(folder).glob("*.mcap"))]
    told = list(tqdm(trials(work, jobs, processes), total=len(jobs), leave=False, disable=None))
    rows, held, right = [], [], []
    for kind in sorted({t.kind for t in told}):
        out = fitted([t for t in told if t.kind != kind])
        p = np.concatenate([said(t, *out) for t in told if t.kind == kind])
        plain, y = (np.concatenate([getattr(t, name) for t in told if t.kind == kind]) for name in ("plain", "close"))
        held.append(p)
        right.append(y)
        rows.append([kind, *(f"{100 * each.mean():.1f}" for each in (y, plain, p)), f"{rank(p, y):.3f}"])
    p, y = np.concatenate(held), np.concatenate(right)
    rows.append(["all", f"{100 * y.mean():.1f}", "", f"{100 * p.mean():.1f}", f"{rank(p, y):.3f}"])
    print(table(["kind left out", "right, %", "said before, %", "said, %", "right above wrong"], rows))
    fits, surely = fitted(told)
    print(f"{dict(zip(MISFITS, np.round(fits.slopes, 3)))}, constant {fits.constant:.3f}; SURELY {surely:.2f}")


if __name__ == "__main__":
    tyro.cli(main)
