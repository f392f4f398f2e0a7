"""Where and how a segment begins: the best of several starts, tracked as trials. Host side."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Float32

from voodoo_jax.config.options import StartSettings
from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.markers.table import TO_START, marker_start
from voodoo_jax.model.body import Body, scaled
from voodoo_jax.model.pose_library import STANCES, Stance, in_stance
from voodoo_jax.records.observation import PersonFrame
from voodoo_jax.trackers.icp.body_size import sized, unlikely
from voodoo_jax.trackers.icp.runner import FEW_POINTS, Session, first_run
from voodoo_jax.trackers.icp.trials import facing, opposite, standing_places

BETTER = 0.9  # a fresh start replaces a track where it costs less than this share of it
MUCH_BETTER = 0.5  # of its cost, where the fresh start is in doubt, too
CLEARER = 0.5  # a later start is taken where it costs less than this share of the first
LIKELIER = 0.8  # to stand, or else what was found before, is left where something else costs less than this share of it
RIVAL = 1.1  # a start that faces the other way is looked at where it costs less than so much more than the best
FAR_RIVAL = 3.0  # and if it costs less than so much more where something else speaks for it
ALIKE = 3.0  # starts that cost less than so much more than the best may tell the size
AS_WELL = 1.2  # times what it costs in the size that it seems to have, at most, where it is taken to be taller
OFF_FLOOR, HIDDEN = 0.04, 0.35  # metres: whose lowest points are so much higher jumps; if even higher, feet are hidden
USUAL = 0.018  # metres of noise that a start is allowed in any case
NOISY = 0.03  # metres of noise from which on a clearer start is looked for however good the first one is


class Beginning(NamedTuple):
    """A start that could be."""

    frame: int
    body: Body  # with its size
    poses: Poses
    cost: float  # see solve.scan.cost_of and body_size.unlikely
    noise: float = 0.0  # of the points that it was tried on, metres, at least USUAL
    rival: "Beginning | None" = None  # faces the other way

    def clear(self, sure: float) -> bool:
        """Whether neither what it costs nor noise leaves a doubt that it is right."""
        return self.unexplained <= sure and self.noise <= NOISY

    @property
    def close_rival(self) -> "Beginning | None":
        """The rival, if it costs hardly more."""
        return self.rival if self.rival is not None and self.rival.cost < RIVAL * self.cost else None

    @property
    def unexplained(self) -> float:
        """What it costs beyond what noise would, square metres."""
        return self.cost - self.noise**2


def begin(run: Session, at: int, before: Poses | None = None) -> Beginning:
    """The best trial in frame `at`, or a better one later on, followed back to there.

    By markers alone: in the nearest frame that has enough of them. The first start settles the body's size, too.
    `before` the last poses before the body was lost: it may still be in them, elsewhere.
    """
    if run.by_markers:
        good = np.flatnonzero(run.table.enough(TO_START))
        frame = int(good[np.argmin(np.abs(good - at))])
        return Beginning(at, run.body, marker_start(run.body, run.table.markers, frame), 0.0)
    found, sure = [_trial(run, at, _sized(run, at), before)], run.settings.start.sure
    low = _lowest(run, run.people[at])
    for frame in _later(run, at) if not found[0].clear(sure) else ():
        found.append(_trial(run, frame, _sized(run, frame, low)))
        if found[-1].clear(0.0):  # who was in doubt is not easily sure again
            break
    clearest = min(found, key=lambda b: b.cost)
    best = clearest if clearest.cost < CLEARER * found[0].cost else found[0]
    # who sat before what is at rest was taken away did not stand up by that; else people stand
    earlier = run.stances.pop(at, None)
    posed = _in_stances(run, best.frame) if best.unexplained > sure else []
    best, stance = min([(best, None), *posed], key=lambda b: b[0].cost * (LIKELIER if b[1] is earlier else 1.0))
    if stance is not None:
        run.stances[at] = stance
    else:
        # who bends or walks is taller than they look
        taller = [b.body for b in found if b.cost < ALIKE * best.cost and _scale(b.body) > 1.01 * _scale(best.body)]
        for body in sorted(taller, key=_scale, reverse=True)[:2]:
            trial = _trial(run, best.frame, body)
            if trial.cost < AS_WELL * best.cost:  # else a hand was what was highest
                best = trial
                break
    run.body, run.sized = best.body, True
    run.bodies[-1] = (run.bodies[-1][0], run.body)
    if best.frame > at:
        best = best._replace(poses=_followed(run, best, at), rival=best.rival and best.rival._replace(
            poses=_followed(run, best.rival, at)))  # fmt: skip
    return best._replace(frame=at)


def clearer(run: Session, at: int) -> Beginning | None:
    """A start in frame `at` that leaves no doubt, in the size that the body has there, if there is one; it settles the
    size anew. For who began in doubt and may not look ahead."""
    if run.by_markers or not run.can_start(at):
        return None
    found = _trial(run, at, _measured(run, at))
    if not found.clear(run.settings.start.sure):
        return None
    run.body = found.body
    run.bodies.append((at, run.body))
    return found


def _followed(run: Session, start: Beginning, at: int) -> Poses:
    """The poses in an earlier frame `at`."""
    return run.backwards(start.poses, at, start.frame + 1).poses[0]


def fresh(
    run: Session, first: int, cost: Float[np.ndarray, " frame"], rotation: Float32[np.ndarray, "frame limb 4"]
) -> Poses | None:
    """Poses in the last of some frames, the first of them `first`, from a start of its own shortly before, if that
    explains more than the track with this `cost` and these `rotation`s, and is in no doubt: a wrong track is left so.
    """
    count = 3 * run.settings.start.frames
    skip = max(0, len(cost) - count)
    at, end = first + skip, first + len(cost)
    if run.by_markers or end - at < 2 * run.settings.start.frames or not run.can_start(at):
        return None
    tried = _tried_on(run, at)
    here = float(np.mean(cost[skip : skip + len(tried)]))
    if here - _noise(tried) ** 2 <= run.settings.start.sure:  # it is in no doubt itself
        return None
    best = _trial(run, at, run.body)
    if (rival := best.close_rival) is not None:
        # a few frames hardly tell front from back: the track knows it from all before
        ways = facing(on_host(run.body), np.stack([rotation[skip], best.poses.rotation]))
        best = best if ways[0] @ ways[1] > 0 else rival
    if not best.cost < (BETTER if best.unexplained <= run.settings.start.sure else MUCH_BETTER) * here:
        return None
    return run.through(best.poses, run.people[at:end])[0].poses


def _in_stances(run: Session, at: int) -> list[tuple[Beginning, Stance]]:
    """Starts from frame `at` with arms raised or sitting; none for a body that can do neither."""
    found, seen = [], _sized(run, at)
    for stance in STANCES:
        # where the size is known, so is what the highest point is
        for size in (1.0,) if run.sized else stance.sizes:
            body = seen if size == 1.0 else scaled(seen, float(seen.scale) * size)
            posed = in_stance(body, stance)
            if posed is not None:
                found.append((_trial(run, at, body, rest=posed), stance))
    return found


def _sized(run: Session, at: int, low: float = np.inf) -> Body:
    """The body in the size that it is known to have, or else in the one that it seems to have, see _measured."""
    return run.body if run.sized else _measured(run, at, low)


def _measured(run: Session, at: int, low: float = np.inf) -> Body:
    """The body in the size that it seems to have from frame `at` on.

    `low` how high above the floor the lowest points are when it stands, metres: in the air it is as much lower."""
    s: StartSettings = run.settings.start
    frames, up = run.people[at : at + s.size_frames], run.scene.floor.normal
    lifts = (_lowest(run, frame) - low for frame in frames)
    lowered = [replace(f, points=f.points - by * up) if OFF_FLOOR < by < HIDDEN else f for f, by in zip(frames, lifts)]
    return sized(run.body, lowered, run.scene.floor, s)


def _lowest(run: Session, frame: PersonFrame) -> float:
    """How high above the floor the lowest points are, metres."""
    return float(np.percentile(run.scene.floor.height(frame.points), 1)) if len(frame.points) else -np.inf


def _scale(body: Body) -> float:
    return float(body.scale)


def _tried_on(run: Session, at: int) -> list[PersonFrame]:
    """The frames from `at` on by which trials are compared."""
    s: StartSettings = run.settings.start
    return soon([f for f in run.people[at : at + 3 * s.frames] if len(f.points) >= FEW_POINTS], s)


def soon(frames: list[PersonFrame], s: StartSettings) -> list[PersonFrame]:
    """As many of the frames, from the first on, as trials are compared by: over a longer time starts that are right
    are lost, too."""
    return [f for k, f in enumerate(frames[: s.frames]) if k < 3 or f.time_ns - frames[0].time_ns <= s.seconds * 1e9]


def _noise(frames: list[PersonFrame]) -> float:
    """What noise a start from these frames is allowed, metres."""
    # people are no cylinders: a quieter sensor does not come nearer to them
    return max(USUAL, float(np.median([f.noise for f in frames])))


def _trial(run: Session, at: int, body: Body, before: Poses | None = None, rest: Body | None = None) -> Beginning:
    """The best of trials in all headings from frame `at`, and of one in the poses `before`, moved there.

    `rest` the body with another rest pose, to begin with that.
    """
    s: StartSettings = run.settings.start
    frames = _tried_on(run, at)
    places = standing_places(rest or body, frames[::-1], run.scene.floor, s.headings)
    if before is not None:
        there, last = np.median(np.concatenate([f.points for f in frames]), 0), on_host(before)
        shift = (there - np.median(last.translation, 0)).astype(np.float32)
        places.append(Poses(last.rotation, last.translation + shift))
    noise = _noise(frames)
    trial = run.trials(body, frames, places)
    odds = 1.0 if body is run.body or s.scale > 0 else unlikely(body)  # of a size that is known nobody doubts
    found = [
        Beginning(at, body, jax.tree.map(lambda x, k=k: x[k], trial.state.poses), odds * float(trial.cost[k]), noise)
        for k in opposite(body, trial, FAR_RIVAL)
    ]
    return found[0]._replace(rival=found[1] if len(found) > 1 else None)


def _later(run: Session, at: int) -> list[int]:
    """Frames after `at` to start from: with points on end until there, and before the body changes."""
    if not run.settings.looks_ahead("track"):
        return []
    end = min([len(run.people), *(frame for frame, _ in run.pending)])
    seconds = np.array([f.time_ns - run.people[at].time_ns for f in run.people[at:end]]) / 1e9
    empty = np.array([len(f.points) < FEW_POINTS for f in run.people[at:end]], bool)
    # the first pause that is longer than what a start reaches over
    pause = first_run(empty, run.settings.track.patience)
    found = [int(np.searchsorted(seconds, t)) for t in run.settings.start.later]
    last = len(empty) - run.settings.start.frames  # of fewer frames some leg explains another one's points
    return [at + k for k in dict.fromkeys(found) if 0 < k < pause and k <= last and not empty[k]]
