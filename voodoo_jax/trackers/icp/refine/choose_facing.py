"""Which way somebody faces: where a start might as well face the other way, both are tracked. Host side."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.model.body import Body
from voodoo_jax.records.segment import Segment
from voodoo_jax.trackers.icp.refine.stage import Stage, refined
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.segment import WRONG_WAY, Followed, bent, segment_of
from voodoo_jax.trackers.icp.start.hypothesis import RIVAL, StartHypothesis
from voodoo_jax.trackers.icp.trials import facing

WHILE, STRAIGHT = 0.3, 0.95  # seconds in which who goes ahead turns by no more than the angle of that cosine


@dataclass(frozen=True)
class ChooseFacing:
    """Where the start has a rival that costs hardly more, or the body goes backwards or bends its joints the wrong way,
    the rival is tracked too, and what is in less doubt is kept. Numbers were chosen by hand."""

    name: ClassVar = "choose_facing"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body"})

    among: tuple[Stage, ...]  # stages that the rival goes through before it is compared
    step: float = 0.5  # metres ahead or backwards that tell nothing; who goes farther backwards is looked at
    stride: float = 0.5  # metres beyond which say all that going tells
    ahead: float = 0.25  # logarithm of what costs are divided by where somebody goes ahead, and times where backwards

    def __call__(self, run: Runner, segment: Followed) -> Followed:
        start = segment.start
        if start is None or start.rival is None:
            return segment
        if start.close_rival is None and not self._speaks_for(run, start, segment):
            return segment
        state, step = run.forwards(start.rival.poses, segment.first, segment.end)
        other = refined(run, segment_of(run, step, segment.first, len(segment)), self.among)
        # a few frames hardly tell front from back: all of them do
        doubt = [self._doubt(run, start.cost, segment), self._doubt(run, start.rival.cost, other)]
        return segment if doubt[0] <= doubt[1] else replace(other, start=start.rival, state=state)

    def _speaks_for(self, run: Runner, start: StartHypothesis, segment: Followed) -> bool:
        """Whether how a segment goes speaks for the start's rival, though that costs clearly more."""
        assert start.rival is not None
        bends = start.rival.cost < RIVAL * start.cost * _odds_of_bends(run, segment)
        return bends or _gone(run, segment) < -self.step

    def _doubt(self, run: Runner, trial: float, segment: Followed) -> float:
        """How unlikely a segment is, to compare: by the cost of its trial and its own, joints bent the wrong way, and
        where the body goes: people walk backwards, but seldom."""
        gone = _gone(run, segment)
        likely = self.ahead * np.sign(gone) * np.clip((abs(gone) - self.step) / self.stride, 0, 1)
        return trial * float(np.mean(segment.cost)) * _odds_of_bends(run, segment) * float(np.exp(-likely))


def _odds_of_bends(run: Runner, segment: Segment) -> float:
    """How much likelier it is, by the joints that are bent the wrong way, that the body faces the other way."""
    return float(np.exp(np.mean(bent(run, segment)) / WRONG_WAY))


def _gone(run: Runner, segment: Segment) -> float:
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
