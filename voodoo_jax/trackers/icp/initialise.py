"""Starts a segment: the best of several starts, tracked as trials. Host side."""

import numpy as np

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.stage import is_active
from voodoo_jax.trackers.icp.start.cut_off_size import CutOffSize
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis, measured_at, sized_at, trial
from voodoo_jax.trackers.icp.start.later_start import LaterStart
from voodoo_jax.trackers.icp.start.lying_down import LyingDown
from voodoo_jax.trackers.icp.start.other_stances import OtherStances
from voodoo_jax.trackers.icp.start.stage import Search, StartStage
from voodoo_jax.trackers.icp.start.taller_size import TallerSize

# after the trials in all headings, of which the best one stands
START: tuple[StartStage, ...] = (CutOffSize(), LyingDown(), LaterStart(), OtherStances(), TallerSize())

WRONG = 4  # times what a start that is sure may leave unexplained: it is in doubt


def begin(run: Runner, at: int, before: Poses | None = None) -> StartHypothesis:
    """The best trial in frame `at`, or a better later one, tracked backwards to `at`.

    The first start also determines the body's size. `before` the last poses before the body was lost, which may still
    hold at another place. Where nothing later is looked at a start may be in doubt: then points that the learned eye
    does not take for the person's are left out until there is a clearer one.
    """
    run.doubt, run.facing = False, np.nan
    best = _searched(run, at, before)
    run.doubt = not run.settings.looks_ahead("track") and best.unexplained > WRONG * run.settings.start.sure
    if run.doubt and run.person_in(run.people[at]) is not None:
        best = _searched(run, at, before)
    run.body, run.sized = best.body, True
    run.bodies[-1] = (run.bodies[-1][0], run.body)
    if best.frame > at:
        best = best._replace(poses=_followed(run, best, at))
    return best._replace(frame=at)


def _searched(run: Runner, at: int, before: Poses | None) -> StartHypothesis:
    """The best trial in frame `at`, or a better later one."""
    first = trial(run, at, sized_at(run, at), before)
    search = Search(at, first, (first,))
    for stage in START:
        if is_active(run, stage):
            search = stage(run, search)
    return search.best


def clearer(run: Runner, at: int) -> StartHypothesis | None:
    """A certain start in frame `at`, by all points, with the body's size there, if there is one; it determines the size
    again. For doubtful starts without later frames."""
    if not run.can_start(at):
        return None
    run.doubt = False
    found = trial(run, at, measured_at(run, at))
    if not found.clear(run.settings.start.sure):
        run.doubt = True
        return None
    run.body = found.body
    run.bodies.append((at, run.body))
    return found


def _followed(run: Runner, start: StartHypothesis, at: int) -> Poses:
    """The poses tracked backwards to an earlier frame `at`."""
    return run.backwards(start.poses, at, start.frame + 1).poses[0]
