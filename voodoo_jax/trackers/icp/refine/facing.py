"""Which way somebody faces: where a start might as well face the other way, both are tracked. Host side."""

import numpy as np
from jaxtyping import Float

from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.model.body import Body
from voodoo_jax.records.segment import Segment
from voodoo_jax.solve.scan import State
from voodoo_jax.trackers.icp.initialise import RIVAL, Beginning
from voodoo_jax.trackers.icp.refine.forward_backward import there_and_back
from voodoo_jax.trackers.icp.refine.leg_swap import uncrossed
from voodoo_jax.trackers.icp.runner import Session
from voodoo_jax.trackers.icp.segment import WRONG_WAY, bent, segment_of
from voodoo_jax.trackers.icp.trials import facing

STEP = 0.5  # metres ahead or backwards that tell nothing; who goes farther backwards is looked at the other way round
STRIDE = 0.5  # metres beyond which say all that going tells
WHILE, STRAIGHT = 0.3, 0.95  # seconds in which who goes ahead turns by no more than the angle of that cosine
GOES_AHEAD = 0.25  # logarithm of what costs are divided by where somebody goes ahead, and times where backwards


def likelier_way(run: Session, start: Beginning, forward: Segment) -> tuple[Segment, State | None]:
    """A segment that began with `start` and was tracked forwards, with what a pass back makes of it.

    Where the start has a rival that costs hardly more, or the body goes backwards or bends its joints the wrong way,
    the rival is tracked there and back too, and what is in less doubt is kept; then the state comes with it that this
    ends in.
    """
    found = _whole(run, forward)
    if start.rival is None or not (start.close_rival is not None or _speaks_for(run, start, found)):
        return found, None
    end, step = run.forwards(start.rival.poses, forward.first, forward.end)
    other = _whole(run, segment_of(run, step, forward.first, len(forward)))
    # a few frames hardly tell front from back: all of them do
    doubt = [_doubt(run, cost, segment) for cost, segment in ((start.cost, found), (start.rival.cost, other))]
    return (found, None) if doubt[0] <= doubt[1] else (other, end)


def _speaks_for(run: Session, start: Beginning, segment: Segment) -> bool:
    """Whether how a segment goes speaks for the start's rival, though that costs clearly more."""
    assert start.rival is not None
    bends = start.rival.cost < RIVAL * start.cost * _odds_of_bends(run, segment)
    return bends or _gone(run, segment) < -STEP


def _odds_of_bends(run: Session, segment: Segment) -> float:
    """How much likelier it is, by the joints that are bent the wrong way, that the body faces the other way."""
    return float(np.exp(np.mean(bent(run, segment)) / WRONG_WAY))


def _whole(run: Session, forward: Segment) -> Segment:
    # before the ways are compared: who faces the right way with the legs exchanged costs more than who faces the other
    return uncrossed(run, there_and_back(run, forward))


def _doubt(run: Session, trial: float, segment: Segment) -> float:
    """How unlikely a segment is, to compare: by the cost of its trial and its own, joints bent the wrong way, and where
    the body goes: people walk backwards, but seldom."""
    gone = _gone(run, segment)
    likely = GOES_AHEAD * np.sign(gone) * np.clip((abs(gone) - STEP) / STRIDE, 0, 1)
    return trial * float(np.mean(segment.cost)) * _odds_of_bends(run, segment) * float(np.exp(-likely))


def _gone(run: Session, segment: Segment) -> float:
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
