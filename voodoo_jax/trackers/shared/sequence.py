"""Goes through a recording segment by segment: starts, tracks chunk by chunk, and starts again after the body was lost.

Long segments are cut into spans, each tracked forwards and backwards before the next one, so that memory does not grow
with the length of a recording.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.records.tracks import Status
from voodoo_jax.solve.scan import State, at_rest
from voodoo_jax.trackers.shared.runner import FrameRunner, first_run
from voodoo_jax.trackers.shared.segment import Followed, Start, segment_of

Progress = Callable[[int], None]
SPAN = 1800  # frames after which a segment is tracked back, even if it goes on
DOUBT = 15  # frames after which a start that is in doubt is compared with another one, if nothing later is looked at
OVERLAP = 30  # frames of a span that the next one goes back over: a pass is not good before it has settled


class KnownStart(NamedTuple):
    """A start from certain poses."""

    frame: int
    poses: Poses
    unexplained: float = 0.0


class Method:
    """The tracker's own methods for starting and refining segments; by default they are not refined."""

    def begin(self, run: Any, at: int, before: Poses | None) -> Start:
        """The start in frame `at`; `before` the last poses before the body was lost, which may still hold."""
        raise NotImplementedError

    def clearer(self, run: Any, at: int) -> Start | None:
        """A certain start in frame `at`, if there is one; for doubtful starts without later frames."""

    def looked(self, run: Any, found: Followed) -> tuple[Followed, State | None]:
        """Frames that were just tracked, up to the first one whose pose was mended, and the state after that one; all,
        and None, if none was. For tracking without later frames."""
        return found, None

    def refines(self, run: Any) -> bool:
        """Whether segments are refined."""
        return False

    def refine(self, run: Any, segment: Followed) -> Followed:
        """A segment after all refinements."""
        return segment


# 62 lines: one state machine, whose steps share eight variables
def follow(
    run: FrameRunner,
    at: int,
    enough: Bool[np.ndarray, " frame"],
    out: Followed,
    method: Method,
    progress: Progress | None,
) -> None:
    """Tracks from frame `at` to the end and fills in `out`; `enough`: frames with enough points to search again for a
    lost body."""
    ahead = run.settings.looks_ahead("track")  # whether later frames may be looked at
    refines = method.refines(run)
    count, patience = len(run.people), run.settings.track.patience
    wait = 0 if ahead else patience  # frames until it is known that the body is gone
    say = progress or (lambda _: None)
    state: State | None = None
    start: Start | None = None  # of the present span
    before: Poses | None = None  # the last ones before the body was gone
    tried = -1
    say(at)
    while at < count:
        state = run.change(at, state)
        if run.others and run.others[0] <= at:
            state = before = None
            run.another(at)
        if state is None and not run.can_start(at):
            out.status[at], at = Status.NO_DATA, at + 1
            say(1)
            continue
        if state is None:
            start = method.begin(run, at, before)
            state = at_rest(start.poses)
        after, step, taken = run.chunk(state, at, DOUBT if run.doubt else SPAN)
        found = segment_of(run, step, at, taken)
        if not ahead:
            found, mended = method.looked(run, found)
            after, taken = mended or after, len(found)
        # gone or lost for long: stop here and look anew
        gone = first_run(found.status == Status.NO_DATA, patience)
        lost = first_run(found.status == Status.LOST, patience) if tried < at else taken
        known = gone + wait if gone < taken else taken
        keep = min(known, lost + patience if lost < taken else taken, taken)
        if run.doubt:
            found = replace(found, status=np.where(found.tracked, Status.LOST, found.status).astype(np.int8))
        out.put(found[:keep])
        at, state = at + keep, after
        say(keep)
        over = keep < taken or at == count or at in run.others
        if refines and start is not None and (over or at - start.frame >= SPAN):
            until = at if over else at - OVERLAP
            state = _refined(run, start, until, at, out, method) or state
            say(until - start.frame)
            start = KnownStart(until, state.poses)
        if run.doubt and keep == taken and at < count and (better := method.clearer(run, at)) is not None:
            state = at_rest(better.poses)
        if keep < taken:
            state = before = None
            if known == keep:
                before = jax.tree.map(lambda leaf, k=gone: leaf[k - 1], step.poses) if gone else None
                later = np.flatnonzero(enough[at:])
                skip = int(later[0]) if len(later) else count - at
                out.status[at : at + skip] = Status.NO_DATA
                at += skip
                say(skip)
            tried = at + patience


def _refined(run: FrameRunner, start: Start, until: int, at: int, out: Followed, method: Method) -> State | None:
    """Fills in a span, tracked forwards to before frame `at`, with its refinement up to `until`; returns the state to
    continue with, if it changed."""
    first = start.frame
    found = method.refine(run, replace(out[first:at], start=start))
    last = until if found.state is None else at  # another start's frames take the place of all
    out.put(found[: last - first])
    return found.state
