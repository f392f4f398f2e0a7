"""Passage after passage through a recording: starts, tracks chunk by chunk, and starts anew where the body was lost.

Long passages are cut in spans, each tracked there and back in time before the next one: what is held in memory
meanwhile does not grow with the length of a recording.
"""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Bool

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import PersonFrame
from voodoo_jax.records.segment import PASSAGE, Rows
from voodoo_jax.records.tracks import Status
from voodoo_jax.solve.scan import State, at_rest
from voodoo_jax.trackers.icp.initialise import Beginning, begin, clearer
from voodoo_jax.trackers.icp.refine.discontinuity import without_jumps
from voodoo_jax.trackers.icp.refine.facing import likelier_way
from voodoo_jax.trackers.icp.refine.limb_restart import looked_again
from voodoo_jax.trackers.icp.runner import Session, first_run
from voodoo_jax.trackers.icp.segment import rows_of

Progress = Callable[[int], None]
SPAN = 1800  # frames after which a passage is tracked back, even if it goes on
WRONG = 4  # times what a start that is sure may leave unexplained: it is in doubt
DOUBT = 15  # frames after which a start that is in doubt is compared with another one, if nothing later is looked at
OVERLAP = 30  # frames of a span that the next one goes back over: a pass is not good before it has settled


def blank(body: Body, people: list[PersonFrame]) -> Rows:
    """Arrays of Tracks, and "cost", before anything is tracked."""
    count, limbs = len(people), body.limb_count
    joints, centres = len(body.topology.joints), len(body.topology.centres)
    return {
        "rotation": np.full((count, limbs, 4), np.nan, np.float32),
        "translation": np.full((count, limbs, 3), np.nan, np.float32),
        "status": np.full(count, Status.NOT_STARTED, np.int8),
        "residual": np.full(count, np.nan, np.float32),
        "explained": np.zeros(count, np.float32),
        "steps": np.zeros(count, np.int32),
        "points": np.array([len(f.points) for f in people], np.int32),
        "limb_weight": np.zeros((count, limbs), np.float32),
        "passes_apart": np.full((count, limbs), np.nan, np.float32),
        "cost": np.zeros(count),
        "beyond_limits": np.full((count, joints), np.nan, np.float32),
        "depth_inside": np.full((count, limbs), np.nan, np.float32),
        "limb_covariance": np.full((count, limbs, 6, 6), np.nan, np.float32),
        "joint_covariance": np.full((count, centres, 3, 3), np.nan, np.float32),
    }


def follow(run: Session, at: int, enough: Bool[np.ndarray, " frame"], out: Rows, progress: Progress | None) -> None:
    """Tracks from frame `at` to the end and fills in `out`; `enough` the frames with points enough to look anew."""
    ahead = run.settings.track.both_ways  # whether later frames may be looked at
    both_ways = ahead and not run.by_markers and not run.settings.changes
    count, patience = len(run.people), run.settings.track.patience
    wait = 0 if ahead else patience  # frames until it is known that the body is gone
    say = progress or (lambda _: None)
    state: State | None = None
    start: Beginning | None = None  # of the present span
    before: Poses | None = None  # the last ones before the body was gone
    tried, doubt = -1, False
    say(at)
    while at < count:
        state = run.change(at, state)
        if run.others and run.others[0] <= at:
            state = before = None
            run.another(at)
        if state is None and not run.can_start(at):
            out["status"][at], at = Status.NO_DATA, at + 1
            say(1)
            continue
        if state is None:
            start = begin(run, at, before)
            state = at_rest(start.poses)
            doubt = not ahead and start.unexplained > WRONG * run.settings.start.sure
        after, step, taken = run.chunk(state, at, DOUBT if doubt else SPAN)
        rows = rows_of(run, step, at, taken)
        # gone or lost for long: stop here and look anew
        gone = first_run(rows["status"] == Status.NO_DATA, patience)
        lost = first_run(rows["status"] == Status.LOST, patience) if tried < at else taken
        known = gone + wait if gone < taken else taken
        keep = min(known, lost + patience if lost < taken else taken, taken)
        if doubt:
            rows["status"] = np.where(rows["status"] == Status.TRACKED, Status.LOST, rows["status"]).astype(np.int8)
        for name, row in rows.items():
            out[name][at : at + keep] = row[:keep]
        at, state = at + keep, after
        say(keep)
        over = keep < taken or at == count or at in run.others
        if both_ways and start is not None and (over or at - start.frame >= SPAN):
            until = at if over else at - OVERLAP
            state = _turned(run, start, until, at, out) or state
            say(until - start.frame)
            start = Beginning(until, run.body, state.poses, 0.0)
        if doubt and keep == taken and at < count and (found := clearer(run, at)) is not None:
            state, doubt = at_rest(found.poses), False
        if keep < taken:
            state = before = None
            if known == keep:
                before = jax.tree.map(lambda leaf, k=gone: leaf[k - 1], step.poses) if gone else None
                later = np.flatnonzero(enough[at:])
                skip = int(later[0]) if len(later) else count - at
                out["status"][at : at + skip] = Status.NO_DATA
                at += skip
                say(skip)
            tried = at + patience


def _turned(run: Session, start: Beginning, until: int, at: int, out: Rows) -> State | None:
    """Fills in a span, tracked forwards to before frame `at`, with what the pass back makes of it up to `until`; the
    state to go on with, where that is another one."""
    first = start.frame
    found, end = likelier_way(run, start, {name: out[name][first:at] for name in PASSAGE})
    last = until if end is None else at  # the rival's frames take the place of all
    found = without_jumps(run, first, looked_again(run, first, found))
    for name, row in found.items():
        out[name][first:last] = row[: last - first]
    return end
