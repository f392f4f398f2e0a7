"""Assigns points while people are close to each other, by tracking all of them frame by frame together. Host side.

By places in the previous frame (detect/tracklets.py), an arm that swings in front of another person would become
theirs, and their body would explain it well enough to keep it. Here, in each frame, every point is assigned to the
person with the nearest predicted limb, and after the solve to the one with the nearest solved limb.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Int

from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.records.observation import BodyObservation, joined
from voodoo_jax.records.recording import NO_PAIRS, NO_RAYS
from voodoo_jax.records.stretches import stretches
from voodoo_jax.records.subject import Subject
from voodoo_jax.records.tracks import Status, Tracks
from voodoo_jax.solve.scan import State, Visit, at_rest, options_from
from voodoo_jax.trackers.icp.limb_distance import body_distance
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.shared.runner import FEW_POINTS


@dataclass
class Walker:
    """A person who is tracked frame by frame."""

    run: Runner
    state: State
    seconds: float = 0.0  # from one frame to the next

    @property
    def predicted(self) -> Poses:
        """Predicted poses in the next frame."""
        state = self.state
        return Poses(state.poses.rotation, state.poses.translation + np.float32(self.seconds) * state.velocity)

    def distance(self, poses: Poses, points: np.ndarray, most: float) -> np.ndarray:
        """Distances of points from the nearest limb's surface, metres; at most `most`."""
        sizes = np.asarray(self.run.body.sizes, np.float32)
        return body_distance(sizes, np.asarray(poses.rotation), np.asarray(poses.translation), points, most)

    def solved(self, frame: BodyObservation, at: int) -> State:
        """The state after a frame with these points."""
        self.run.people[at] = frame
        return self.run.one(self.state, at)


def owned_in_turn(
    subjects: list[Subject], tracks: list[Tracks], close: Bool[np.ndarray, "person frame"], settings: Settings,
    near: float, visit: Visit | None = None,
) -> list[list[BodyObservation]]:  # fmt: skip
    """All people's frames, with points of people who are `close` assigned again.

    **Arguments:** `tracks` of the subjects so far, in whose poses each stretch of close frames begins; `near` metres: a
    point farther from every surface keeps its owner.
    """
    frames = [list(subject.frames) for subject in subjects]
    for start, end in stretches(np.sum(close, 0) > 1):
        who = [k for k in range(len(subjects)) if close[k, start:end].any()]
        who = [k for k in who if tracks[k].status[start] == Status.TRACKED]
        if len(who) < 2:
            continue
        # tracked alone before they are close, as long as trials are: until it is known how fast they are
        lead = max(0, start - settings.start.frames)
        while lead < start and any(tracks[k].status[lead] != Status.TRACKED for k in who):
            lead += 1
        walkers = {k: _walker(subjects[k], frames[k], tracks[k], settings, lead, visit) for k in who}
        for at in range(lead, end):
            _walk(walkers, frames, at, near if at >= start else None)
    return frames


def _walker(
    subject: Subject, frames: list[BodyObservation], tracks: Tracks, settings: Settings, at: int, visit: Visit | None
) -> Walker:
    """A person at rest in the tracked poses of a frame."""
    options = options_from(settings.solve, settings.track, settings.features)
    # by points alone, which are what changes hands; nor does the body become another one on the way
    plain = [replace(f, rays=NO_RAYS, pairs=NO_PAIRS, other=False) for f in frames]
    run = Runner(tracks.body, options, plain, subject.scene, settings, visit=visit)
    run.length = 1  # one frame is asked for at a time: a program of its own, not a chunk of many
    return Walker(run, at_rest(Poses(tracks.rotation[at], tracks.translation[at])))


def _walk(walkers: dict[int, Walker], frames: list[list[BodyObservation]], at: int, near: float | None) -> None:
    """Tracks the next frame; reassigns points if `near` is given. `frames` of all people, changed in place."""
    who = list(walkers)
    own = [frames[k][at] for k in who]
    everything = joined(own)
    owner = np.repeat(np.arange(len(who)), [len(f.points) for f in own])
    for w in walkers.values():
        w.seconds = (w.run.people[at].time_ns - w.run.people[at - 1].time_ns) / 1e9 if at else 0.0
    states = {k: w.state for k, w in walkers.items()}
    for ahead in (True, False) if near is not None else (False,):
        if near is not None:
            poses = {k: w.predicted if ahead else states[k].poses for k, w in walkers.items()}
            owner = _nearest(walkers, poses, everything, owner, near)
        for j, k in enumerate(who):
            some = everything.only(owner == j)
            mine = replace(own[j], points=some.points, sensor=some.sensor, part=some.part, weight=some.weight)
            if len(mine.points) >= FEW_POINTS:
                states[k] = walkers[k].solved(replace(mine, rays=NO_RAYS, pairs=NO_PAIRS), at)
            frames[k][at] = mine
    for k, w in walkers.items():
        w.state = states[k]


def _nearest(
    walkers: dict[int, Walker], poses: dict[int, Poses], seen: BodyObservation, owner: Int[np.ndarray, " point"],
    near: float,
) -> Int[np.ndarray, " point"]:  # fmt: skip
    """The person with the nearest surface, for each point; the previous owner if none is near."""
    distance = np.stack([w.distance(poses[k], seen.points, near) for k, w in walkers.items()])
    return np.where(np.min(distance, 0) < near, np.argmin(distance, 0), owner)
