"""Starts limbs again where a segment explains the measurements worse than elsewhere: a limb may be lost there. Host
side.

A limb that no points reach any more is not found again from its present pose. So arms and legs are started again in the
middle of the bad stretch, and the whole body if it may be lost, in several poses, tracked from there in both
directions, and kept where they explain more.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from voodoo_jax.geometry.rigid import Poses, compose, inverse, on_host
from voodoo_jax.model.body import Body
from voodoo_jax.model.pose_library import HIPS, SHOULDERS, Stance, Turn, beyond, both, exchanged, rest_in_stance
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.stretches import stretches
from voodoo_jax.trackers.icp.refine.forward_backward import ForwardBackward
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.segment import implausible, pass_of, tracked_anew
from voodoo_jax.trackers.icp.start.hypothesis import USUAL, soon
from voodoo_jax.trackers.icp.trials import Trial, standing_places, too_fast
from voodoo_jax.trackers.shared.runner import FEW_POINTS
from voodoo_jax.trackers.shared.segment import Followed

# against the rest pose, in which they hang: as there, forwards, to the side and bent, up
ARMS: tuple[tuple[Turn, ...], ...] = (
    (),
    (*both("shoulder", "y", -80.0), *both("elbow", "y", -20.0)),
    (*both("shoulder", "x", 80.0), *both("elbow", "y", -60.0)),
    both("shoulder", "x", 165.0),
)
# hanging, forwards, forwards and bent, to the side, backwards and bent
LEGS: tuple[tuple[Turn, ...], ...] = (
    (),
    both("hip", "y", -85.0),
    (*both("hip", "y", -85.0), *both("knee", "y", 95.0)),
    both("hip", "x", 70.0),
    (*both("hip", "y", 30.0), *both("knee", "y", 80.0)),
)


@dataclass(frozen=True)
class RestartLimbs:
    """Starts limbs, or the whole body, again where little is explained, and keeps them where they explain more. Numbers
    were chosen by hand."""

    name: ClassVar = "restart_limbs"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body"})

    worse: float = 1.6  # times what a frame costs where the segment goes well: here it is in doubt
    lost: float = 2.5  # times that: all of the body may be lost
    well: float = 10  # percent of the frames cost less where it goes well
    better: float = 0.85  # what is started anew is followed where it costs less than this share
    fewest: int = 3  # frames in doubt on end that are worth a look
    longest: int = 30  # frames in doubt on end that one look is for
    around: int = 15  # frames before and after them that are tracked anew, too
    passes: ForwardBackward = ForwardBackward()  # by which passes are compared frame by frame

    def __call__(self, run: Runner, segment: Followed) -> Followed:
        people, cost = run.people[segment.first : segment.end], pass_of(run, segment).cost
        # what is not plausible is looked at however well it explains what is seen
        plain = self.plain(people, segment) & (cost <= segment.cost)
        for start, end in self.in_doubt(people, cost, segment.tracked, plain):
            segment = self._looked(run, segment, start, end)
        return segment

    def plain(self, people: list[BodyObservation], segment: Segment) -> Bool[np.ndarray, " frame"]:
        """Frames in which nothing better can be found: both passes agree on all limbs, and the residual of the points
        is no more than their measured noise."""
        if not people:
            return np.zeros(0, bool)
        noise = np.array([f.noise for f in people]) ** 2
        apart = np.max(segment.passes_apart, axis=1, initial=0.0)  # NaN, of one pass, does not agree
        return (apart < self.passes.agree) & (self.passes.smoothed(segment.cost) <= self.passes.smoothed(noise))

    def in_doubt(
        self,
        people: list[BodyObservation],
        cost: Float[np.ndarray, " frame"],
        tracked: Bool[np.ndarray, " frame"],
        plain: Bool[np.ndarray, " frame"] | bool = False,
    ) -> list[tuple[int, int]]:
        """Begin and end of the stretches of `tracked` frames that cost more than noise and the rest of them explain,
        and are not `plain`."""
        if not tracked.any():
            return []
        cost, longest = self.passes.smoothed(cost / np.maximum([f.noise for f in people], USUAL) ** 2), self.longest
        bad = stretches(tracked & np.logical_not(plain) & (cost > self.worse * np.percentile(cost[tracked], self.well)))
        found = [(k, min(k + longest, end)) for start, end in bad for k in range(start, end, longest)]
        return [(start, end) for start, end in found if end - start >= self.fewest]

    def _looked(self, run: Runner, segment: Followed, start: int, end: int) -> Followed:
        """The segment with limbs that were started again between two of its frames, where they cost less."""
        first, low, high = segment.first, max(0, start - self.around), min(len(segment), end + self.around)
        cost = pass_of(run, segment[low : high + run.settings.start.frames]).cost  # from frame `low` on
        at = start + int(np.argmax(self.passes.smoothed(cost)[start - low : end - low]))
        frames = soon(run.people[first + at : segment.end], run.settings.start)
        last = at + len(frames) - 1
        poses = segment.pose_at(last)
        limbs = [starts for starts in (other_arms(run.body, poses), other_legs(run.body, poses)) if starts]
        if not limbs or any(len(f.points) < FEW_POINTS for f in frames):
            return segment
        here = float(np.mean(cost[at - low : last + 1 - low]))
        if np.mean(segment.cost[at : last + 1]) > self.lost * np.percentile(segment.cost, self.well):
            limbs.append(standing_places(run.body, frames[::-1], run.scene.floor, run.settings.start.headings))
        # not all at once: the best few after two frames might all be of one kind
        tried = [run.trials(run.body, frames, starts) for starts in limbs]
        costs = [_cost(run, each) for each in tried]
        k = int(np.argmin([np.min(each) for each in costs]))
        trial, best = tried[k], int(np.argmin(costs[k]))
        if not costs[k][best] < self.better * here:
            return segment
        other = tracked_anew(run, trial.state.poses[best], first + low, first + at, first + high)
        after = segment.spliced(low, other, self.passes.is_better(pass_of(run, other).cost, cost[: high - low]))
        before, then = (too_fast(run.body, each, run.people[first : segment.end]) for each in (segment, after))
        return segment if then > before else after


def _cost(run: Runner, trial: Trial) -> Float[np.ndarray, " trial"]:
    """What trials cost, more where the poses that they end in are not plausible."""
    found = on_host(trial.state.poses)
    return trial.cost * implausible(run.body, found.rotation, found.translation, run.settings.track.chunk)


def other_arms(body: Body, poses: Poses) -> list[Poses]:
    """The poses with the left arm, the right one or both in other places; nothing for a body without arms."""
    return _others(body, poses, ARMS, (SHOULDERS[:1], SHOULDERS[1:], SHOULDERS))


def other_legs(body: Body, poses: Poses) -> list[Poses]:
    """The poses with the left or the right leg in other places, or both exchanged; nothing for a body without legs."""
    found = _others(body, poses, LEGS, (HIPS[:1], HIPS[1:]))
    return found and [*found, exchanged(body, poses, HIPS)]


def _others(
    body: Body, poses: Poses, turned: tuple[tuple[Turn, ...], ...], sides: tuple[tuple[str, ...], ...]
) -> list[Poses]:
    """The poses with the limbs on some joints as each of the stances holds them; nothing for a body without these."""
    body = on_host(body)
    rests = [rest for turns in turned if (rest := rest_in_stance(body, Stance(turns, (1.0,)))) is not None]
    if len(rests) < len(turned):
        return []
    return [_with_limbs(body, rest, poses, some) for rest in rests for some in sides]


def _with_limbs(body: Body, rest: Poses, poses: Poses, joints: tuple[str, ...]) -> Poses:
    """The poses with what hangs on some joints as a stance, the `rest` pose, holds it against the limb before them."""
    t = body.topology
    rotation, translation = np.array(poses.rotation), np.array(poses.translation)
    for name in joints:
        joint = t.joints.index(name)
        limbs, parent = beyond(body, joint), t.parents[joint]
        held = compose(compose(poses[parent], inverse(rest[parent])), rest[limbs])
        rotation[limbs], translation[limbs] = held.rotation, held.translation
    return Poses(rotation, translation)
