"""The odds that a segment of tracking faces the right way, and not the way of its start's rival. Host side."""

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

WHILE, STRAIGHT = 0.3, 0.95  # seconds in which who goes ahead turns by no more than the angle of that cosine


@dataclass(frozen=True, kw_only=True)
class FacingOdds:
    """By costs, joints bent the wrong way, posture and where the body goes. Numbers were chosen by hand."""

    step: float = 0.5  # metres ahead or backwards that tell nothing; who goes farther backwards is looked at
    stride: float = 0.5  # metres beyond which say all that going tells
    # logarithm of the odds that somebody goes ahead, and of those that they do not go backwards: at 0.25 a skirt that
    # walks is turned, at 0.37 a person who walks backwards
    ahead: float = 0.3
    # logarithm of the odds that posture tells (see model.posture) where one is plainly ahead and the other one turned
    # round; who has less than this posture is looked at the other way round: all of 15 skirts that were turned have it
    posture: float = 1.0
    doubtful: float = 0.0
    clearly: float = 0.1  # logarithm of the odds for the rival, at least, if it is taken

    def odds(self, run: Runner, start: StartHypothesis, segment: Followed, other: Followed) -> float:
        """Logarithm of the odds that a segment faces the right way and not another one, of the start's rival: by the
        costs of their trials and their own and joints bent the wrong way as far as the body fits, by the posture,
        and by where the body goes: people walk backwards, but seldom."""
        assert start.rival is not None
        # a few frames hardly tell front from back: all of them do
        costs = float(np.mean(segment.cost)), float(np.mean(other.cost))
        unexplained = max(min(costs) - start.noise**2, 1e-9)
        fit = min(1.0, BADLY * run.settings.start.sure / unexplained)
        bends = float(np.mean(bent(run.body, other.rotation)) - np.mean(bent(run.body, segment.rotation))) / WRONG_WAY
        ahead = self._ahead(gone(run, segment)) - self._ahead(gone(run, other))
        stands = self.posture * float(np.nan_to_num(posture_of(run, segment) - posture_of(run, other))) / 2
        dearer = float(np.log(start.rival.cost / start.cost) + np.log(costs[1] / costs[0]))
        return fit * (dearer + bends) + stands + ahead

    def _ahead(self, gone: float) -> float:
        return self.ahead * float(np.sign(gone) * np.clip((abs(gone) - self.step) / self.stride, 0, 1))


def posture_of(run: Runner, segment: Segment) -> float:
    return faces_ahead(run.body, segment.poses[segment.tracked], run.scene.floor.normal)


def gone(run: Runner, segment: Segment) -> float:
    times = [f.time_ns for f in run.people[segment.first : segment.end]]
    return gone_ahead(run.body, np.array(times) / 1e9, segment.poses)


def gone_ahead(body: Body, time: Float[np.ndarray, " frame"], poses: Poses) -> float:
    """How far a body goes to where it faces, metres; negative: backwards. Turning does not count, nor what is gone
    meanwhile.

    **Arguments:** `time` of the frames, seconds; `poses` [frame, limb] on the host.
    """
    later = np.searchsorted(time, time + WHILE)
    now = np.flatnonzero(later < len(time))
    later = later[now]
    ahead, place = facing(on_host(body), poses.rotation), poses.translation
    way = np.sum((place[later, 0] - place[now, 0]) * (ahead[now] + ahead[later]) / 2, -1)
    straight = np.sum(ahead[now] * ahead[later], -1) > STRAIGHT
    return float(np.nansum(np.where(straight, way / (later - now), 0.0)))
