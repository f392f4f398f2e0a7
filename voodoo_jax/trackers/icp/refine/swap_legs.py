"""Looks again where a segment has its legs crossed: each may have taken the other one's points. Host side.

Somebody who is seen in part, or moves far between two frames, may be begun with the wrong legs; nothing takes them
apart again, for both are on points. People who walk or stand do not cross their knees (in 18 recordings of eight people
in no frame), so the legs are exchanged, tracked there and back in time, and kept so where that explains as much.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool

from voodoo_jax.geometry.rigid import apply, on_host
from voodoo_jax.model.body import Body
from voodoo_jax.model.pose_library import HIPS, exchanged
from voodoo_jax.records.segment import Segment
from voodoo_jax.trackers.icp.runner import Session
from voodoo_jax.trackers.icp.segment import Followed, pass_of, tracked_anew

LEGS = (("l_hip", "l_knee"), ("r_hip", "r_knee"))


@dataclass(frozen=True)
class SwapLegs:
    """Legs exchanged where they are crossed in vain. Numbers were chosen by hand, on experiments/stress."""

    name: ClassVar = "swap_legs"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body", *sum(LEGS, ())})

    fewest: int = 5  # frames with crossed knees, near each other, that are worth a look
    around: int = 15  # frames before and after them that are tracked anew, too
    better: float = 0.85  # who dances crosses them: then exchanged legs must cost less than this share
    likelier: float = 1.05  # exchanged legs may cost so much more: crossed ones are rare
    most: int = 3  # times that all of a segment is gone through: legs may take each other's points more than once

    def __call__(self, run: Session, segment: Followed) -> Followed:
        for _ in range(self.most):
            found = self._once(run, segment)
            if found is segment:
                break
            segment = found
        return segment

    def _once(self, run: Session, segment: Followed) -> Followed:
        """The segment with legs exchanged in every stretch in which that explains as much; the same one if in none."""
        body, first = on_host(run.body), segment.first
        for start, end in self._stretches(crossed(body, segment) & segment.tracked):
            at = start + int(np.argmin(segment.cost[start:end]))
            low, high = max(0, start - self.around), min(len(segment), end + self.around)
            poses = exchanged(body, segment.pose_at(at), HIPS)
            other, mine = tracked_anew(run, poses, first + low, first + at, first + high), segment[low:high]
            costs = np.mean(pass_of(run, other).cost) / np.mean(pass_of(run, mine).cost)
            fewer = crossed(body, other).mean() < crossed(body, mine).mean()
            if costs < (self.likelier if fewer else self.better):
                segment = segment.spliced(low, other, np.ones(high - low, bool))
        return segment

    def _stretches(self, mask: Bool[np.ndarray, " frame"]) -> list[tuple[int, int]]:
        """Begin and end of stretches with `fewest` True at least; those `around` each other are one."""
        frames = np.flatnonzero(mask)
        runs = np.split(frames, np.flatnonzero(np.diff(frames) > self.around) + 1)
        return [(int(r[0]), int(r[-1]) + 1) for r in runs if len(r) >= self.fewest]


def crossed(body: Body, segment: Segment) -> Bool[np.ndarray, " frame"]:
    """Frames in which the left knee is to the right of the right one, as the hips see it."""
    t, poses = body.topology, segment.poses
    places = {}
    for name in sum(LEGS, ()):
        joint = t.joints.index(name)
        places[name] = apply(poses[:, t.parents[joint]], body.parent_anchor.translation[joint])
    hips, knees = places["l_hip"] - places["r_hip"], places["l_knee"] - places["r_knee"]
    return np.sum(hips * knees, -1) < 0
