"""Looks again where a segment has its legs crossed: each may have taken the other one's points. Host side.

Somebody who is seen in part, or moves far between two frames, may be begun with the wrong legs; nothing takes them
apart again, for both are on points. People who walk or stand do not cross their knees (in 18 recordings of eight people
in no frame), so the legs are exchanged, tracked there and back in time, and kept so where that explains as much.
"""

import numpy as np
from jaxtyping import Bool

from voodoo_jax.geometry.rigid import apply, on_host
from voodoo_jax.model.body import Body
from voodoo_jax.model.pose_library import HIPS, exchanged
from voodoo_jax.records.segment import Segment
from voodoo_jax.trackers.icp.refine.limb_restart import AROUND
from voodoo_jax.trackers.icp.runner import Session
from voodoo_jax.trackers.icp.segment import pass_of, tracked_anew

FEWEST = 5  # frames with crossed knees, near each other, that are worth a look
BETTER = 0.85  # who dances crosses them: then exchanged legs must cost so much less
LIKELIER = 1.05  # exchanged legs may cost so much more: crossed ones are rare
MOST = 3  # times that all of a segment is gone through
LEGS = (("l_hip", "l_knee"), ("r_hip", "r_knee"))


def uncrossed(run: Session, segment: Segment) -> Segment:
    """The segment with legs exchanged where they are crossed in vain.

    Again where some are left: legs may have taken each other's points more than once.
    """
    if any(set(leg) - set(run.body.topology.joints) for leg in LEGS):
        return segment
    for _ in range(MOST):
        found = _once(run, segment)
        if found is segment:
            break
        segment = found
    return segment


def _once(run: Session, segment: Segment) -> Segment:
    """The segment with legs exchanged in every stretch in which that explains as much; the same one if in none."""
    body, first = on_host(run.body), segment.first
    for start, end in _stretches(crossed(body, segment) & segment.tracked):
        at = start + int(np.argmin(segment.cost[start:end]))
        low, high = max(0, start - AROUND), min(len(segment), end + AROUND)
        poses = exchanged(body, segment.pose_at(at), HIPS)
        other, mine = tracked_anew(run, poses, first + low, first + at, first + high), segment[low:high]
        costs = np.mean(pass_of(run, other).cost) / np.mean(pass_of(run, mine).cost)
        if costs < (LIKELIER if crossed(body, other).mean() < crossed(body, mine).mean() else BETTER):
            segment = segment.spliced(low, other, np.ones(high - low, bool))
    return segment


def crossed(body: Body, segment: Segment) -> Bool[np.ndarray, " frame"]:
    """Frames in which the left knee is to the right of the right one, as the hips see it."""
    t, poses = body.topology, segment.poses
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
