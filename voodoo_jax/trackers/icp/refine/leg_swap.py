"""Looks again where a passage has its legs crossed: each may have taken the other one's points. Host side.

Somebody who is seen in part, or moves far between two frames, may be begun with the wrong legs; nothing takes them
apart again, for both are on points. People who walk or stand do not cross their knees (in 18 recordings of eight people
in no frame), so the legs are exchanged, tracked there and back in time, and kept so where that explains as much.
"""

import numpy as np
from jaxtyping import Bool

from voodoo_jax.geometry.rigid import Poses, apply, on_host
from voodoo_jax.model.body import Body
from voodoo_jax.model.pose_library import HIPS, exchanged
from voodoo_jax.records.segment import Rows, part, pose_at, with_part
from voodoo_jax.records.tracks import Status
from voodoo_jax.trackers.icp.refine.limb_restart import AROUND
from voodoo_jax.trackers.icp.runner import Session
from voodoo_jax.trackers.icp.segment import pass_of, tracked_anew

FEWEST = 5  # frames with crossed knees, near each other, that are worth a look
BETTER = 0.85  # who dances crosses them: then exchanged legs must cost so much less
LIKELIER = 1.05  # exchanged legs may cost so much more: crossed ones are rare
MOST = 3  # times that all of a passage is gone through
LEGS = (("l_hip", "l_knee"), ("r_hip", "r_knee"))


def uncrossed(run: Session, first: int, rows: Rows) -> Rows:
    """The rows of a passage that begins in frame `first`, with legs exchanged where they are crossed in vain.

    Again where some are left: legs may have taken each other's points more than once.
    """
    if any(set(leg) - set(run.body.topology.joints) for leg in LEGS):
        return rows
    for _ in range(MOST):
        found = _once(run, first, rows)
        if found is rows:
            break
        rows = found
    return rows


def _once(run: Session, first: int, rows: Rows) -> Rows:
    """The rows with legs exchanged in every stretch in which that explains as much; the same ones if in none."""
    body = on_host(run.body)
    for start, end in _stretches(crossed(body, rows) & (rows["status"] == Status.TRACKED)):
        at = start + int(np.argmin(rows["cost"][start:end]))
        low, high = max(0, start - AROUND), min(len(rows["cost"]), end + AROUND)
        poses = exchanged(body, pose_at(rows, at), HIPS)
        other = tracked_anew(run, first, poses, low, at, high)
        mine = part(rows, low, high)
        costs = np.mean(pass_of(run, other).cost) / np.mean(pass_of(run, mine).cost)
        if costs < (LIKELIER if crossed(body, other).mean() < crossed(body, mine).mean() else BETTER):
            rows = with_part(rows, low, other, np.ones(high - low, bool))
    return rows


def crossed(body: Body, rows: Rows) -> Bool[np.ndarray, " frame"]:
    """Frames in which the left knee is to the right of the right one, as the hips see it."""
    t, poses = body.topology, Poses(rows["rotation"], rows["translation"])
    places = {}
    for name in sum(LEGS, ()):
        joint = t.joints.index(name)
        places[name] = apply(poses[:, t.parents[joint]], body.parent_anchor.translation[joint])
    hips, knees = places["l_hip"] - places["r_hip"], places["l_knee"] - places["r_knee"]
    return np.sum(hips * knees, -1) < 0


def _stretches(mask: Bool[np.ndarray, " frame"]) -> list[tuple[int, int]]:
    """Begin and end of stretches with FEWEST True at least; those AROUND each other are one."""
    frames = np.flatnonzero(mask)
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > AROUND) + 1)
    return [(int(r[0]), int(r[-1]) + 1) for r in runs if len(r) >= FEWEST]
