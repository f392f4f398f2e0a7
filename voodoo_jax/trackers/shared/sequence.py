"""Goes through a recording segment by segment: starts, tracks chunk by chunk, and starts again after the body was lost.

Long segments are cut into spans, so that memory does not grow with the length of a recording, and each is refined
(tracked backwards, too) while the next ones are tracked forwards.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.records.tracks import Status
from voodoo_jax.solve.scan import State, at_rest
from voodoo_jax.storage.cores import begun
from voodoo_jax.trackers.shared.runner import FrameRunner, first_run
from voodoo_jax.trackers.shared.segment import Followed, Start, segment_of

Progress = Callable[[int], None]
SPAN = 512  # frames after which a segment is tracked back, even if it goes on
MOST = 2  # spans whose refinement may wait while others are tracked: as many keep two cores busy
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


class Span(NamedTuple):
    """A part of a segment that is refined as one."""

    start: Start
    until: int  # frame before which it counts
    end: int  # frame before which it was tracked

    def refined(self, run: FrameRunner, out: Followed, method: Method) -> Followed:
        return method.refine(run, replace(out[self.start.frame : self.end], start=self.start))

    def put(self, found: Followed, out: Followed) -> None:
        """Fills in its refinement."""
        last = self.until if found.state is None else self.end  # another start's frames take the place of all
        out.put(found[: last - self.start.frame])


class Refining:
    """Spans of a segment that are refined aside, while later ones are tracked."""

    def __init__(self, run: FrameRunner, out: Followed, method: Method):
        self._given, self._waiting = (run, out, method), deque[tuple[Span, Callable[[], Followed]]]()

    def begin(self, span: Span) -> None:
        self._waiting.append((span, begun(span.refined, *self._given)))

    def collect(self, most: int) -> tuple[Span, State] | None:
        """Fills in refinements until at most `most` spans wait. Returns the first span that ends in another state than
        it was tracked to, and that state; spans after it are discarded."""
        while len(self._waiting) > most:
            span, result = self._waiting.popleft()
            span.put(found := result(), self._given[1])
            if found.state is not None:
                for _, later in self._waiting:
                    later()  # what it looks at is overwritten next
                self._waiting.clear()
                return span, found.state
        return None


# 70 lines: one state machine, whose steps share eight variables
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
    refines, spans = method.refines(run), Refining(run, out, method)
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
            span = Span(start, at if over else at - OVERLAP, at)
            spans.begin(span)
            say(span.until - start.frame)
            if (other := spans.collect(0 if over else MOST)) is not None:
                span, state = other
            start = KnownStart(span.until, state.poses)
            if span.end < at:
                at = span.end
                continue
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
