"""Which way somebody faces: where a start might as well face the other way, both are tracked. Host side."""

import numpy as np
from jaxtyping import Float

from voodoo_jax.geometry.rigid import on_host
from voodoo_jax.model.body import Body
from voodoo_jax.records.segment import Rows
from voodoo_jax.solve.scan import State
from voodoo_jax.trackers.icp.initialise import RIVAL, Beginning
from voodoo_jax.trackers.icp.refine.forward_backward import there_and_back
from voodoo_jax.trackers.icp.refine.leg_swap import uncrossed
from voodoo_jax.trackers.icp.runner import Session
from voodoo_jax.trackers.icp.segment import WRONG_WAY, bent, rows_of
from voodoo_jax.trackers.icp.trials import facing

STEP = 0.5  # metres ahead or backwards that tell nothing; who goes farther backwards is looked at the other way round
STRIDE = 0.5  # metres beyond which say all that going tells
WHILE, STRAIGHT = 0.3, 0.95  # seconds in which who goes ahead turns by no more than the angle of that cosine
GOES_AHEAD = 0.25  # logarithm of what costs are divided by where somebody goes ahead, and times where backwards


def likelier_way(run: Session, start: Beginning, forward: Rows) -> tuple[Rows, State | None]:
    """A passage that began with `start` and was tracked forwards, with what a pass back makes of it.

    Where the start has a rival that costs hardly more, or the body goes backwards or bends its joints the wrong way,
    the rival is tracked there and back too, and what is in less doubt is kept; then the state comes with it that this
    ends in.
    """
    found = _whole(run, start.frame, forward)
    if start.rival is None or not (start.close_rival is not None or _speaks_for(run, start, found)):
        return found, None
    count = len(forward["status"])
    end, step = run.forwards(start.rival.poses, start.frame, start.frame + count)
    other = _whole(run, start.frame, rows_of(run, step, start.frame, count))
    # a few frames hardly tell front from back: all of them do
    doubt = [_doubt(run, start.frame, cost, rows) for cost, rows in ((start.cost, found), (start.rival.cost, other))]
    return (found, None) if doubt[0] <= doubt[1] else (other, end)


def _speaks_for(run: Session, start: Beginning, rows: Rows) -> bool:
    """Whether how a passage goes speaks for the start's rival, though that costs clearly more."""
    assert start.rival is not None
    bends = start.rival.cost < RIVAL * start.cost * _odds_of_bends(run, rows)
    return bends or _gone(run, start.frame, rows) < -STEP


def _odds_of_bends(run: Session, rows: Rows) -> float:
    """How much likelier it is, by the joints that are bent the wrong way, that the body faces the other way."""
    return float(np.exp(np.mean(bent(run, rows)) / WRONG_WAY))


def _whole(run: Session, first: int, forward: Rows) -> Rows:
    # before the ways are compared: who faces the right way with the legs exchanged costs more than who faces the other
    return uncrossed(run, first, there_and_back(run, first, forward))


def _doubt(run: Session, first: int, trial: float, rows: Rows) -> float:
    """How unlikely a passage is, to compare: by the cost of its trial and its own, joints bent the wrong way, and where
    the body goes: people walk backwards, but seldom."""
    gone = _gone(run, first, rows)
    likely = GOES_AHEAD * np.sign(gone) * np.clip((abs(gone) - STEP) / STRIDE, 0, 1)
    return trial * float(np.mean(rows["cost"])) * _odds_of_bends(run, rows) * float(np.exp(-likely))


def _gone(run: Session, first: int, rows: Rows) -> float:
    times = [f.time_ns for f in run.people[first : first + len(rows["cost"])]]
    return gone_ahead(run.body, np.array(times) / 1e9, rows)


def gone_ahead(body: Body, time: Float[np.ndarray, " frame"], rows: Rows) -> float:
    """How far a passage goes to where the body faces, metres; negative: backwards. Turning does not count, nor what is
    gone meanwhile. `time` of its frames, seconds."""
    later = np.searchsorted(time, time + WHILE)
    now = np.flatnonzero(later < len(time))
    later = later[now]
    ahead = facing(on_host(body), rows["rotation"])
    way = np.sum((rows["translation"][later, 0] - rows["translation"][now, 0]) * (ahead[now] + ahead[later]) / 2, -1)
    straight = np.sum(ahead[now] * ahead[later], -1) > STRAIGHT
    return float(np.nansum(np.where(straight, way / (later - now), 0.0)))
