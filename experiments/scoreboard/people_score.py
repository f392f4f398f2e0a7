"""Tracks of several people beside the truth: who is found, how far off, and whether anybody is taken for another.

The rules are those of CLEAR MOT (Bernardin and Stiefelhagen 2008): claims and people are paired one to one by distance,
and a pair is kept while it stays near.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

import voodoo_jax as vj
from experiments.common import SKIP
from experiments.scoreboard.tracked import Known, read_known

NEAR = 0.5  # metres of mean joint distance: farther away a claim is not about the person
SEEN = 250  # pixels of a person: with fewer visible nobody needs to find them
ENOUGH = 10  # joints with a position: fewer claim nothing
SAME_FRAME = 17_000_000  # nanoseconds: half a frame at 30 Hz


class Counts(NamedTuple):
    """What was found in a log; those of several logs are added up."""

    visible: int  # people times frames in which they are to be found
    paired: int  # of these: with a claim
    error: float  # sum of their mean joint distances, metres
    false: int  # claims without a person
    switches: int  # times that a person is paired with other tracks than before
    same: int  # visible people near the tracks that are theirs over the whole log
    claimed: int  # claims, but for those about somebody who can hardly be seen

    def __add__(self, other: tuple) -> "Counts":  # not a longer tuple
        return Counts(*(a + b for a, b in zip(self, other, strict=True)))


def distances(people: Sequence[vj.Tracks], known: Known) -> np.ndarray:
    """[tracks, person, time] Mean distance of the joints, metres; infinite where tracks claim nothing.

    **Arguments:** `known` with joints [person, time, joint, 3].
    """
    out = np.full((len(people), len(known.joints), len(known.stamps)), np.inf)
    for row, tracks in zip(out, people):
        if not len(tracks.time_ns):
            continue
        frame = np.abs(tracks.time_ns[None] - known.stamps[:, None]).argmin(1)
        claims = tracks.tracked[frame] & (np.abs(tracks.time_ns[frame] - known.stamps) < SAME_FRAME)
        joints = tracks.joints[frame][:, [tracks.body.topology.centres.index(n) for n in known.names]].astype(float)
        away = np.linalg.norm(joints - known.joints, axis=-1)
        there = np.isfinite(away) & claims[:, None]
        mean = np.where(there, away, 0).sum(-1) / np.maximum(there.sum(-1), 1)
        row[:] = np.where(there.sum(-1) >= ENOUGH, mean, np.inf)
    return out


def counted(away: np.ndarray, seen: np.ndarray) -> Counts:
    """Pairs claims with people, frame by frame, and for the whole log.

    **Arguments:** `away` [tracks, person, time] as `distances` gives it; `seen` [person, time] who is to be found.
    """
    last: dict[int, int] = {}  # person -> tracks that they were paired with when last paired
    paired, error, false, switches = 0, 0.0, 0, 0
    for now, visible in zip(np.moveaxis(away, 2, 0), seen.T):
        pairs = {person: claim for person, claim in last.items() if now[claim, person] < NEAR}
        claims = np.flatnonzero(np.isfinite(now).any(1))
        for claim, person in _nearest(now, pairs, claims):
            switches += person in last and last[person] != claim
            pairs[person] = claim
        last |= pairs
        false += len(claims) - len(pairs)
        mine = [now[claim, person] for person, claim in pairs.items() if visible[person]]
        paired, error = paired + len(mine), error + float(np.sum(mine))
    near = away < NEAR
    close = near & seen
    together = close.sum(2)
    same = int(together[linear_sum_assignment(-together)].sum())
    hardly_seen = (near & ~seen).any(1) & ~close.any(1)
    claimed = int((np.isfinite(away).any(1) & ~hardly_seen).sum())
    return Counts(int(seen.sum()), paired, error, int(false), int(switches), same, claimed)


def _nearest(now: np.ndarray, pairs: dict[int, int], claims: np.ndarray) -> list[tuple[int, int]]:
    """Claims and people that are not paired yet, paired so that they are nearest in all; those too far apart are not.

    **Arguments:** `now` [tracks, person] distances in a frame; `pairs` claim by person.
    """
    free = [c for c in claims.tolist() if c not in pairs.values()]
    alone = [p for p in range(now.shape[1]) if p not in pairs]
    cost = np.where(now[np.ix_(free, alone)] < NEAR, now[np.ix_(free, alone)], 1e3)  # too far: at a price beyond all
    return [(free[i], alone[j]) for i, j in zip(*linear_sum_assignment(cost)) if cost[i, j] < NEAR]


def score_people(people: Sequence[vj.Tracks], truth: Path) -> Counts:
    """Tracks, one for each person, beside the truth in an .npz file, which has `pixels` [person, time] visible, too."""
    known = read_known(truth)  # joints [person, time, joint, 3]
    with np.load(truth, allow_pickle=False) as file:
        pixels = file["pixels"]
    use = known.stamps >= known.stamps[0] + int(SKIP * 1e9)
    known = known._replace(stamps=known.stamps[use], joints=known.joints[:, use])
    return counted(distances(people, known), pixels[:, use] >= SEEN)


@dataclass(frozen=True)
class TrackPeople:
    """Tracks whoever is in a log, nothing given."""

    log: Path
    seconds = 15.0

    def run(self) -> Counts:
        people = vj.track_people(vj.human(), vj.read_log(self.log))
        return score_people(people, self.log.with_suffix(".truth.npz"))


def figures(logs: Sequence[Counts]) -> dict[str, float]:
    """Over all logs together."""
    total = sum(logs, Counts(0, 0, 0.0, 0, 0, 0, 0))
    visible = max(1, total.visible)
    return {
        "found, %": 100 * total.paired / visible,
        "joints, cm": 100 * total.error / total.paired if total.paired else float("nan"),
        "false, %": 100 * total.false / visible,
        "switches": total.switches,
        "idf1, %": 100 * 2 * total.same / max(1, total.claimed + total.visible),
    }
