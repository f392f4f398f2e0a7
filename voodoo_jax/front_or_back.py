"""Which way somebody faces: where a start might as well face the other way, both are tracked. Host side."""

import numpy as np

from voodoo_jax.beginning import Beginning
from voodoo_jax.crossed_legs import uncrossed
from voodoo_jax.passage import WRONG_WAY, Rows, bent, rows_of, there_and_back
from voodoo_jax.session import Session
from voodoo_jax.tracking import State


def likelier_way(run: Session, start: Beginning, forward: Rows) -> tuple[Rows, State | None]:
    """A passage that began with `start` and was tracked forwards, with what a pass back makes of it.

    Where the start has a rival, that is tracked there and back too, and what is in less doubt is kept; then the state
    comes with it that this ends in.
    """
    found = _whole(run, start.frame, forward)
    if start.rival is None:
        return found, None
    count = len(forward["status"])
    end, step = run.forwards(start.rival.poses, start.frame, start.frame + count)
    other = _whole(run, start.frame, rows_of(run, step, start.frame, count))
    # a few frames hardly tell front from back: all of them do
    doubt = [_doubt(run, cost, rows) for cost, rows in ((start.cost, found), (start.rival.cost, other))]
    return (found, None) if doubt[0] <= doubt[1] else (other, end)


def _whole(run: Session, first: int, forward: Rows) -> Rows:
    # before the ways are compared: who faces the right way with the legs exchanged costs more than who faces the other
    return uncrossed(run, first, there_and_back(run, first, forward))


def _doubt(run: Session, trial: float, rows: Rows) -> float:
    """How unlikely a passage is, to compare: by the cost of its trial and its own, and joints bent the wrong way."""
    return trial * float(np.mean(rows["cost"])) * float(np.exp(np.mean(bent(run, rows)) / WRONG_WAY))
