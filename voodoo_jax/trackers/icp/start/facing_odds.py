"""The odds that a segment of tracking faces the right way, compared with the rival of its start. Host side."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.model.body import Body
from voodoo_jax.model.posture import faces_ahead
from voodoo_jax.records.segment import Segment
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.segment import WRONG_WAY, bent
from voodoo_jax.trackers.icp.start.hypothesis import BADLY, StartHypothesis
from voodoo_jax.trackers.icp.trials import facing
from voodoo_jax.trackers.shared.segment import Followed

WHILE, STRAIGHT = 0.3, 0.95  # seconds in which a person walking ahead turns by at most the angle of that cosine


@dataclass(frozen=True, kw_only=True)
class FacingOdds:
    """Odds from costs, joints bent the wrong way, posture and walking direction. Numbers were chosen by hand."""

    step: float = 0.5  # metres ahead or backwards that decide nothing; walking farther backwards is checked
    stride: float = 0.5  # metres beyond `step` at which walking counts fully
    # logarithm of the odds that a person walks ahead, and of the odds against walking backwards: at 0.25 a walking
    # person in a skirt is turned, at 0.37 a person walking backwards
    ahead: float = 0.3
    # logarithm of the odds by posture (see model.posture) if one segment clearly faces ahead and the other one back;
    # `doubtful`: segments with less posture are also tracked turned round; all 15 people in skirts that were turned
    # have less
    posture: float = 1.0
    doubtful: float = 0.0
    clearly: float = 0.1  # logarithm of the odds for the rival, at least, if it is taken

    def odds(self, run: Runner, start: StartHypothesis, segment: Followed, other: Followed) -> float:
        """Logarithm of the odds that `segment`, not `other` (from the start's rival), faces the right way.

        Costs and joints bent the wrong way count as far as the body fits; posture and walking direction always count:
        people seldom walk backwards."""
        assert start.rival is not None
        # a few frames hardly distinguish front from back: use the cost of all frames
        costs = float(np.mean(segment.cost)), float(np.mean(other.cost))
        unexplained = max(min(costs) - start.noise**2, 1e-9)
        fit = min(1.0, BADLY * run.settings.start.sure / unexplained)
        bends = float(np.mean(bent(run.body, other.rotation)) - np.mean(bent(run.body, segment.rotation))) / WRONG_WAY
        ahead = self._rate_walk(gone(run, segment)) - self._rate_walk(gone(run, other))
        stands = self.posture * float(np.nan_to_num(posture_of(run, segment) - posture_of(run, other))) / 2
        dearer = float(np.log(start.rival.cost / start.cost) + np.log(costs[1] / costs[0]))
        return fit * (dearer + bends) + stands + ahead

    def _rate_walk(self, gone: float) -> float:
        return self.ahead * float(np.sign(gone) * np.clip((abs(gone) - self.step) / self.stride, 0, 1))


def posture_of(run: Runner, segment: Segment) -> float:
    return faces_ahead(run.body, segment.poses[segment.tracked], run.scene.floor.normal)


def gone(run: Runner, segment: Segment) -> float:
    times = [f.time_ns for f in run.people[segment.first : segment.end]]
    return gone_ahead(run.body, np.array(times) / 1e9, segment.poses)


def gone_ahead(body: Body, time: Float[np.ndarray, " frame"], poses: Poses) -> float:
    """Distance that a body walks in its facing direction, metres; negative: backwards. Time in which it turns is left
    out.

    **Arguments:** `time` of the frames, seconds; `poses` [frame, limb] on the host.
    """
    later = np.searchsorted(time, time + WHILE)
    now = np.flatnonzero(later < len(time))
    later = later[now]
    ahead, place = facing(on_host(body), poses.rotation), poses.translation
    way = np.sum((place[later, 0] - place[now, 0]) * (ahead[now] + ahead[later]) / 2, -1)
    straight = np.sum(ahead[now] * ahead[later], -1) > STRAIGHT
    return float(np.nansum(np.where(straight, way / (later - now), 0.0)))
