"""Turns a body round where the learned eye sees it face the other way: at the start, or after a movement that lost it.
Back to front it explains the points hardly worse. A body that the eye does not see is tracked both ways. If nothing
later is looked at, the body continues in the pose that is seen. Host side."""

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int

from voodoo_jax.geometry.rigid import Poses, compose, on_host, rotate
from voodoo_jax.model.body import Body, rest_height
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.stretches import stretches
from voodoo_jax.solve.scan import State, at_rest
from voodoo_jax.trackers.icp.body_size import TELLS
from voodoo_jax.trackers.icp.refine.forward_backward import ForwardBackward
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.segment import pass_of, tracked_anew
from voodoo_jax.trackers.icp.start.hypothesis import TURNED, StartHypothesis, best_from, tried_on, turned
from voodoo_jax.trackers.icp.trials import facing, standing_places
from voodoo_jax.trackers.shared.eye import Seen, poses_of
from voodoo_jax.trackers.shared.runner import FEW_POINTS
from voodoo_jax.trackers.shared.segment import Followed, segment_of

EVERY = 16  # frames from one look to the next: measured, tracks with 4 and 8 are 0.02 cm better (experiments/eye)


class Looks(NamedTuple):
    """What the eye sees in some frames of a segment."""

    frame: Int[np.ndarray, " look"]  # of the segment
    people: list[Seen]  # of each look

    @property
    def front(self) -> Float[np.ndarray, "look 3"]:
        """Where the trunk faces, as long as the logarithm of the odds of that."""
        return np.array([person.front for person in self.people])

    def between(self, first: int, end: int) -> Float[np.ndarray, "frame 3"]:
        """The front in frames `first` to `end` - 1, also between two looks."""
        at = np.arange(first, end)
        return np.stack([np.interp(at, self.frame, axis) for axis in self.front.T], -1)

    def odds(self, body: Body, segment: Segment) -> Float[np.ndarray, " look"]:
        """Logarithm of the odds that the body faces the right way."""
        return np.sum(self.front * facing(on_host(body), segment.rotation[self.frame]), -1)


@dataclass(frozen=True)
class ChooseFacing:
    """Tracks a stretch in which the eye sees the body face the other way again, from what it sees where it is surest,
    and keeps that where it costs less, odds of facing included."""

    name: ClassVar = "choose_facing"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body"})

    passes: ForwardBackward = ForwardBackward()  # by which passes are compared frame by frame

    def __call__(self, run: Runner, segment: Followed) -> Followed:
        looks = looks_at(run, segment)
        if not looks.people:
            return self._cheaper(run, segment)
        odds = looks.odds(run.body, segment)
        for start, end in stretches(odds < 0):
            at = start + int(np.argmin(odds[start:end]))
            if odds[at] < -1 / TURNED:  # the facing counts as much as costs e times as high
                low, high = looks.frame[start] - 2 * EVERY, looks.frame[end - 1] + 2 * EVERY
                span = slice(max(0, int(low)), min(len(segment), int(high)))
                segment = self._turned(run, segment, looks, span, at)
        odds = looks.odds(run.body, segment)
        alone = odds < -1 / TURNED  # it would have turned the body; the others look at one that faces one way
        odds[~alone] = odds[~alone].sum() / max(np.sum(~alone), 1)
        return _with_odds(segment, np.interp(np.arange(len(segment)), looks.frame, odds))

    def so_far(self, run: Runner, segment: Followed) -> tuple[Followed, State | None]:
        """Frames that were just tracked, where nothing later is looked at: up to the first in which the body is turned,
        and the state after that one; all, and None, if it is turned in none."""
        odds, state = np.full(len(segment), np.nan), None
        for k in range(len(segment)):
            frame = run.people[segment.first + k]
            due = ((segment.first + k) % EVERY == 0 or np.isnan(run.facing)) and len(frame.points) >= FEW_POINTS
            if due and (person := run.person_in(frame)) is not None:
                run.facing, row, state = self._faced(run, segment[k : k + 1], person)
                segment = segment if state is None else segment[:k].joined(row)
            odds[k] = run.facing
            if state is not None:
                break
        return _with_odds(segment, odds[: len(segment)]), state

    def _faced(self, run: Runner, row: Followed, person: Seen) -> tuple[float, Followed, State | None]:
        """Odds of a frame, tracked from what the eye sees there if that is better, the frame, and then the state after
        it."""
        body, at = on_host(run.body), row.first
        odds = lambda row: float(np.vdot(facing(body, row.rotation)[0], person.front))  # noqa: E731
        if odds(row) >= -1 / TURNED or (pose := poses_of(run.body, person)) is None:
            return odds(row), row, None
        frames = run.frames(at, at + 1)
        tried = run.trials(run.body, frames, [pose, *standing_places(body, frames, run.scene.floor, 1, person.front)])
        costs = tried.cost * turned(body, np.asarray(tried.state.poses.rotation), person.front)
        poses = tried.state.poses[int(np.argmin(costs))]
        state, step, _ = run.chunk(at_rest(poses), at, 1)
        other = segment_of(run, step, at, 1)
        new, old = (float(one.cost[0] * turned(body, one.rotation, person.front)[0]) for one in (other, row))
        return (odds(other), other, state) if new < old else (odds(row), row, None)

    def _cheaper(self, run: Runner, segment: Followed) -> Followed:
        """The segment, or that of the body turned round at its start, whichever costs less."""
        if not isinstance(segment.start, StartHypothesis):  # it goes on from a span that was asked
            return segment
        other_way = turned_round(segment.start.poses, run.scene.floor.normal)
        start = best_from(run, segment.first, run.body, [other_way])
        state, step = run.forwards(start.poses, segment.first, segment.end)
        other = self.passes(run, segment_of(run, step, segment.first, len(segment)))
        odds = self._rate(run, segment.start, segment) - self._rate(run, start, other)
        better = segment if odds >= 0 else replace(other, start=start, state=state)
        return _with_odds(better, np.full(len(better), TELLS * abs(odds)))

    def _rate(self, run: Runner, start: StartHypothesis, segment: Segment) -> float:
        """Logarithm of the odds of a facing: by the cost of the start, by that of all frames, since a few hardly
        distinguish front from back, and by how far the body moves forwards, in body heights, at most one."""
        front, steps = facing(on_host(run.body), segment.rotation)[1:], np.diff(segment.translation[:, 0], axis=0)
        ahead = float(np.nansum(front * steps)) / rest_height(run.body)
        return float(np.clip(ahead, -1.0, 1.0) - np.log(start.cost * np.mean(pass_of(run, segment).cost)))

    def _turned(self, run: Runner, segment: Followed, looks: Looks, span: slice, look: int) -> Followed:
        """The segment with frames of a span tracked from what the eye sees in one of its looks, where that is
        better."""
        first, at, person = segment.first, segment.first + int(looks.frame[look]), looks.people[look]
        pose = poses_of(run.body, person)
        if pose is None:
            return segment
        standing = standing_places(run.body, tried_on(run, at)[::-1], run.scene.floor, 1, person.front)
        start = best_from(run, at, run.body, [pose, *standing])
        other = tracked_anew(run, start.poses, first + span.start, at, first + span.stop)
        front = looks.between(span.start, span.stop)
        costs = [pass_of(run, s).cost * turned(run.body, s.rotation, front) for s in (other, segment[span])]
        return segment.spliced(span.start, other, self.passes.is_better(*costs))


def looks_at(run: Runner, segment: Segment) -> Looks:
    """What the eye sees in every n-th frame of a segment that has points."""
    people = run.people[segment.first : segment.end]
    at = [k for k in range(0, len(people), EVERY) if len(people[k].points) >= FEW_POINTS]
    found = [(k, person) for k in at if (person := run.person_in(people[k])) is not None]
    return Looks(np.array([k for k, _ in found], int), [person for _, person in found])


def _with_odds(segment: Followed, odds: Float[np.ndarray, " frame"]) -> Followed:
    return replace(segment, facing_odds=odds.astype(np.float32))


def turned_round(poses: Poses, up: Float32[np.ndarray, "3"]) -> Poses:
    """The poses after half a turn of the body about the vertical through its first limb; `up` unit vector."""
    turn = np.concatenate([[0.0], up]).astype(np.float32)
    middle = poses.translation[0]
    return on_host(compose(Poses(turn, middle - rotate(turn, middle)), poses))
