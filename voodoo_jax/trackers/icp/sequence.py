"""Segment after segment through a recording: starts, tracks chunk by chunk, and starts anew where the body was lost.

Long segments are cut in spans, each tracked there and back in time before the next one: what is held in memory
meanwhile does not grow with the length of a recording.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Bool

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.tracks import Status
from voodoo_jax.solve.scan import State, at_rest
from voodoo_jax.trackers.icp.initialise import begin, clearer
from voodoo_jax.trackers.icp.refine.stage import Named, Stage, is_active, refined
from voodoo_jax.trackers.icp.runner import Runner, first_run
from voodoo_jax.trackers.icp.segment import Followed, backwards, segment_of
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis

Progress = Callable[[int], None]
SPAN = 1800  # frames after which a segment is tracked back, even if it goes on
WRONG = 4  # times what a start that is sure may leave unexplained: it is in doubt
DOUBT = 15  # frames after which a start that is in doubt is compared with another one, if nothing later is looked at
OVERLAP = 30  # frames of a span that the next one goes back over: a pass is not good before it has settled


@dataclass(frozen=True)
class Whole:
    """A recording that is tracked, on its way through the stages that look at all of it."""

    run: Runner
    segment: Followed  # all its frames
    begin: int  # frame in which tracking began
    first: int  # the first one that was tracked, back in time from there
    enough: Bool[np.ndarray, " frame"]  # frames with points enough to look anew for a body that was lost
    notes: tuple[str, ...] = ()  # what stages want to be known

    def tracked_anew(self, people: list[BodyObservation], stages: tuple[Stage, ...]) -> "Whole":
        """The recording tracked once more, with other points on the body."""
        return track_whole(self.run.anew(people), self.begin, self.enough, stages, first=self.first)


@runtime_checkable
class RecordingStage(Named, Protocol):
    """One correction of a recording, once all of it is tracked."""

    def __call__(self, whole: Whole) -> Whole: ...


def track_whole(
    run: Runner,
    begin: int,
    enough: Bool[np.ndarray, " frame"],
    stages: tuple[Stage, ...],
    progress: Progress | None = None,
    first: int | None = None,
) -> Whole:
    """Tracks from frame `begin` on; each segment goes through the stages. Then from there back to frame `first`, if it
    is an earlier one. `enough` see Whole."""
    segment = Followed.blank(len(run.people), run.body.limb_count)
    first = begin if first is None else first
    follow(run, begin, enough, segment, stages, progress)
    if first < begin and segment.status[begin] == Status.TRACKED:
        segment.put(backwards(run, segment.pose_at(begin), first, begin + 1)[:-1])
    return Whole(run, segment, begin, first, enough)


# 62 lines: one state machine, whose steps share eight variables
def follow(
    run: Runner,
    at: int,
    enough: Bool[np.ndarray, " frame"],
    out: Followed,
    stages: tuple[Stage, ...],
    progress: Progress | None,
) -> None:
    """Tracks from frame `at` to the end and fills in `out`; `enough` see Whole."""
    ahead = run.settings.looks_ahead("track")  # whether later frames may be looked at
    refines = any(is_active(run, stage) for stage in stages)
    count, patience = len(run.people), run.settings.track.patience
    wait = 0 if ahead else patience  # frames until it is known that the body is gone
    say = progress or (lambda _: None)
    state: State | None = None
    start: StartHypothesis | None = None  # of the present span
    before: Poses | None = None  # the last ones before the body was gone
    tried, doubt = -1, False
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
            start = begin(run, at, before)
            state = at_rest(start.poses)
            doubt = not ahead and start.unexplained > WRONG * run.settings.start.sure
        after, step, taken = run.chunk(state, at, DOUBT if doubt else SPAN)
        found = segment_of(run, step, at, taken)
        # gone or lost for long: stop here and look anew
        gone = first_run(found.status == Status.NO_DATA, patience)
        lost = first_run(found.status == Status.LOST, patience) if tried < at else taken
        known = gone + wait if gone < taken else taken
        keep = min(known, lost + patience if lost < taken else taken, taken)
        if doubt:
            found = replace(found, status=np.where(found.tracked, Status.LOST, found.status).astype(np.int8))
        out.put(found[:keep])
        at, state = at + keep, after
        say(keep)
        over = keep < taken or at == count or at in run.others
        if refines and start is not None and (over or at - start.frame >= SPAN):
            until = at if over else at - OVERLAP
            state = _refined(run, start, until, at, out, stages) or state
            say(until - start.frame)
            start = StartHypothesis(until, run.body, state.poses, 0.0)
        if doubt and keep == taken and at < count and (better := clearer(run, at)) is not None:
            state, doubt = at_rest(better.poses), False
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


def _refined(
    run: Runner, start: StartHypothesis, until: int, at: int, out: Followed, stages: tuple[Stage, ...]
) -> State | None:
    """Fills in a span, tracked forwards to before frame `at`, with what the stages make of it up to `until`; the state
    to go on with, where that is another one."""
    first = start.frame
    found = refined(run, replace(out[first:at], start=start), stages)
    last = until if found.state is None else at  # another start's frames take the place of all
    out.put(found[: last - first])
    return found.state
