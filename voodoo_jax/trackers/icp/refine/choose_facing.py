"""Chooses between the two ways a person may face: if a start could as well face the other way, both are tracked. Host
side.

Costs and joints that are bent the wrong way mean little where the body fits badly: in a skirt or behind a desk, knees
are fitted to points that are not on a leg. There the posture as a whole counts more.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.segment import WRONG_WAY, bent
from voodoo_jax.trackers.icp.stage import Stage, refined
from voodoo_jax.trackers.icp.start.facing_odds import FacingOdds, gone, posture_of
from voodoo_jax.trackers.icp.start.hypothesis import FAR_RIVAL, RIVAL, StartHypothesis
from voodoo_jax.trackers.shared.segment import Followed, segment_of

ALONE = 2 * float(np.log(FAR_RIVAL))  # logarithm of the odds of a start without a rival: none costs less than that


@dataclass(frozen=True)
class ChooseFacing(FacingOdds):
    """Tracks the rival of a start too, if it costs hardly more, or if the body walks backwards, bends its joints the
    wrong way or has the posture of one turned back to front; the rival is taken if the odds clearly favour it."""

    name: ClassVar = "choose_facing"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body"})

    among: tuple[Stage, ...]  # stages that the rival goes through before it is compared

    def __call__(self, run: Runner, segment: Followed) -> Followed:
        start = segment.start
        if not isinstance(start, StartHypothesis):  # it goes on from a span that was asked
            return segment
        if start.rival is None:
            return _with_odds(segment, ALONE)
        if start.close_rival is None and not self._speaks_for(run, start, segment):
            return _with_odds(segment, 2 * float(np.log(start.rival.cost / start.cost)))
        state, step = run.forwards(start.rival.poses, segment.first, segment.end)
        other = refined(run, segment_of(run, step, segment.first, len(segment)), self.among)
        odds = self.odds(run, start, segment, other)
        if odds > -self.clearly:
            return _with_odds(segment, odds)
        return replace(_with_odds(other, -odds), start=start.rival, state=state)

    def _speaks_for(self, run: Runner, start: StartHypothesis, segment: Followed) -> bool:
        """Whether the motion of a segment favours the start's rival, although that costs clearly more."""
        assert start.rival is not None
        bends = start.rival.cost < RIVAL * start.cost * np.exp(np.mean(bent(run.body, segment.rotation)) / WRONG_WAY)
        return bool(bends) or gone(run, segment) < -self.step or posture_of(run, segment) < self.doubtful


def _with_odds(segment: Followed, odds: float) -> Followed:
    return replace(segment, facing_odds=np.full(len(segment), odds, np.float32))
