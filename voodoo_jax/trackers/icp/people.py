"""Tracks several people in one recording separately, and assigns points and features to one person each. Host side.

At first, points are assigned by people's places in the previous frame (detect/tracklets.py), which is wrong where they
touch. Once all are tracked, a point near several people is assigned to the one with the nearest limb, and people whose
points changed are tracked again.

While people are close to each other all of them are tracked frame by frame together: else an arm that swings in front
of another person would become theirs, and their body would explain it well enough to keep it. In each frame every point
is assigned to the person with the nearest predicted limb, and after the solve to the one with the nearest solved limb.

A detector names two faces "face" alike. A 3D feature is assigned to the person with the nearest points, a line of sight
to the first person along it.
"""

from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int8

from voodoo_jax.config.options import Settings
from voodoo_jax.detect.visibility import has_far_sides
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.records.observation import BodyObservation, joined
from voodoo_jax.records.recording import NO_PAIRS, NO_RAYS, Pairs, Rays
from voodoo_jax.records.scene import Subject
from voodoo_jax.records.stretches import stretches
from voodoo_jax.records.tracks import Status, Tracks
from voodoo_jax.solve.scan import State, Visit, at_rest, options_from
from voodoo_jax.storage.cores import at_once
from voodoo_jax.trackers.base import Task
from voodoo_jax.trackers.icp.misfit import AROUND, body_distance, evenly
from voodoo_jax.trackers.icp.reflections import IMAGE, reflected
from voodoo_jax.trackers.icp.runner import LONG, Runner
from voodoo_jax.trackers.icp.tracker import placed, track_poses, with_rating
from voodoo_jax.trackers.shared.runner import FEW_POINTS

# metres from a person's points within which a line of sight meets them: a detector's error at 3 m. 0.067 and 0.15 give
# 2 and 9 of 550 features to another person (measured, experiments/numbers)
IN_ITS_WAY = 0.1
CLOSE = 0.15  # metres from another person's limbs within which points may be mixed up; measured: with 0.25 0.2 cm worse
FUSED = (
    "Points are on all sides of the body: clouds of several sensors were merged, and their positions are unknown. "
    "Points are matched to all sides of a limb."
)
# share of a person's points reassigned in a frame, and number of such frames: fewer make no difference. Measured: any
# change in any frame instead gives the same in five of six logs, 0.2 cm more in one
MOVED, FRAMES = 0.02, 3
# share of a person's usual visible area: with less they are not tracked, from the second on they are wholly in view.
# Measured: with 0 for the first, 7 % of the frames of two-crossing are wrong, for the second 3.8 cm more
SLIVER, WHOLE = 0.12, 0.5


def with_own_features(subjects: list[Subject]) -> list[Subject]:
    """Each subject with only their own features of each frame; unchanged if these are all."""
    frames = [list(subject.frames) for subject in subjects]
    for at, seen in enumerate(zip(*frames)):
        if not (seen[0].rays.names or seen[0].pairs.names) or not any(len(f.points) for f in seen):
            continue
        of_pairs, of_rays = owners_of_pairs(seen[0].pairs, seen), owners_of_rays(seen[0].rays, seen)
        for k, own in enumerate(seen):
            frames[k][at] = replace(own, pairs=own.pairs.only(of_pairs == k), rays=own.rays.only(of_rays == k))
    return [replace(s, frames=own) for s, own in zip(subjects, frames)]


def owners_of_pairs(pairs: Pairs, seen: tuple[BodyObservation, ...]) -> Int[np.ndarray, " pair"]:
    """The person with the nearest points, for each feature."""
    places = np.asarray(pairs.points, float).reshape(-1, 3)
    return np.argmin([[_least(np.linalg.norm(f.points - p, axis=1)) for p in places] for f in seen], 0).astype(int)


def owners_of_rays(rays: Rays, seen: tuple[BodyObservation, ...]) -> Int[np.ndarray, " ray"]:
    """The first person along each line of sight; if it meets no person, the one whose points it passes most closely."""
    return np.argmin([_in_the_way(rays, f) for f in seen], 0).astype(int)


def _in_the_way(rays: Rays, seen: BodyObservation) -> Float[np.ndarray, " ray"]:
    """Distance of a person along each line, metres; for people beside the line, its distance from them, ranked after
    all others."""
    out = []
    for origin, direction in zip(np.asarray(rays.origins, float), np.asarray(rays.directions, float)):
        to = seen.points - origin
        along = to @ direction
        aside = np.linalg.norm(to - along[:, None] * direction, axis=1)
        hit = (aside < IN_ITS_WAY) & (along > 0)
        out.append(_least(along[hit]) if hit.any() else 1e6 + _least(aside[along > 0]))
    return np.array(out)


def _least(values: np.ndarray) -> float:
    return float(np.min(values, initial=1e9))


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


def track_subjects(task: Task, subjects: list[Subject]) -> list[Tracks]:
    """Tracks a body for each person, see find_people; `person` is 0 for reflections of other people."""
    settings, visit = task.settings, task.visit
    frames, repeats = subjects[0].frames, settings.looks_ahead("track") and not settings.changes
    added = max(0, settings.start.frames - len(frames)) if frames and repeats else 0
    subjects = [replace(s, frames=held(s.frames, added, settings.track.prior_interval)) for s in subjects]
    if any(has_far_sides(s.frames[:: len(s.frames) // settings.start.size_frames + 1]) for s in subjects):
        settings = replace(settings, solve=replace(settings.solve, near_side=False))
        task = replace(task, settings=settings, source=task.source.noted(FUSED))
    several = len(subjects) > 1
    shares = several and any(len(frame.points) for subject in subjects for frame in subject.frames)
    if shares:
        subjects = with_own_features(subjects)
    begins = [in_view_from(s) if several else 0 for s in subjects]
    people = at_once(lambda work: track_poses(task, *work), list(zip(subjects, begins)))
    if shares and not settings.changes:
        seen = at_once(lambda one: with_rating(one.run, one.tracks), people)
        touching = touching_in(subjects, seen, close_in(seen))
        frames = owned_in_turn(subjects, seen, touching, settings, AROUND, visit)
        anew = np.flatnonzero(_exchanged(subjects, frames)).tolist()
        subjects = [replace(s, frames=own) for s, own in zip(subjects, frames)]
        silent = replace(task, progress=None)
        now = at_once(lambda s: track_poses(silent, s, in_view_from(s)), [subjects[k] for k in anew])
        for k, one in zip(anew, now):  # with the time of both passes
            both = one.tracks.seconds + people[k].tracks.seconds
            people[k] = one._replace(tracks=replace(one.tracks, seconds=both))
    found = at_once(placed, people)
    if several:
        found = [replace(t, status=_doubted(s, t.status)) for s, t in zip(subjects, found)]
    images = reflected(subjects, found) if shares else {}
    for person, away in images.values():
        found[person] = replace(found[person], notes=(*found[person].notes, IMAGE.format(away)))
    found, many = [t.since(added) for t in found], len(subjects) - len(images)
    return [
        replace(t, person=0 if k in images else s.number, people=many) for k, (s, t) in enumerate(zip(subjects, found))
    ]


def main_first(found: list[Tracks]) -> list[int]:
    """The order of people: those seen longest first, but uncertain people last, and without images of others."""
    return sorted((k for k, t in enumerate(found) if t.person), key=lambda k: not found[k].tracked.any())


def numbered(found: list[Tracks], order: list[int]) -> list[Tracks]:
    """People in an order, with their numbers."""
    return [replace(found[k], person=number) for number, k in enumerate(order, 1)]


def held(frames: list[BodyObservation], count: int, interval: float) -> list[BodyObservation]:
    """Frames after copies of the first one, so that one or two scans take as many steps as the start of a recording."""
    # measured: a person with arms stretched out 12.6 -> 6.6 cm beside copies at 30 Hz
    step = round(LONG * interval * 1e9)
    return [replace(f, time_ns=f.time_ns - k * step) for f in frames[:1] for k in range(count, 0, -1)] + frames


def _doubted(subject: Subject, status: Int8[np.ndarray, " frame"]) -> Int8[np.ndarray, " frame"]:
    """Status, LOST where only a small part of a person is visible, at the edge of the image or beside an occluding
    person."""
    area = np.array([_area(frame) for frame in subject.frames])
    usual = np.percentile(area[area > 0], 80) if (area > 0).any() else 0.0
    return np.where((status == Status.TRACKED) & (area < SLIVER * usual), Status.LOST, status).astype(np.int8)


def in_view_from(subject: Subject) -> int:
    """The first frame in which a person is wholly in view, before they leave it for the first time; if there is none,
    the first one in which they are visible."""
    area = np.array([_area(frame) for frame in subject.frames])
    there = np.flatnonzero(area > 0)
    if not len(there):
        return 0
    gaps = np.flatnonzero(np.diff(there) > FEW_POINTS)
    until = there[gaps[0]] + 1 if len(gaps) else len(area)
    whole = np.flatnonzero(area[:until] >= WHOLE * np.percentile(area[there], 80))
    return int(whole[0]) if len(whole) else int(there[0])


def _area(frame: BodyObservation) -> float:
    """Visible area of a person, in square metres times points per steradian."""
    if len(frame.points) < 3 * FEW_POINTS:
        return 0.0
    return float(np.sum((frame.points - frame.origins[frame.sensor]) ** 2))


def close_in(tracks: list[Tracks]) -> Bool[np.ndarray, "person frame"]:
    """Frames in which people may be near each other, for each person."""
    close = np.zeros((len(tracks), len(tracks[0].status)), bool)
    for at in range(close.shape[1]):
        sure = [k for k, t in enumerate(tracks) if t.status[at] == Status.TRACKED]
        boxes = {k: _box(tracks[k], at) for k in sure}
        for k in sure:
            close[k, at] = any(_meet(boxes[k], boxes[j]) for j in sure if j != k)
    return close


def touching_in(
    subjects: list[Subject], tracks: list[Tracks], close: Bool[np.ndarray, "person frame"]
) -> Bool[np.ndarray, "person frame"]:
    """Of the frames in which people are `close`, those in which points of a person are near enough to another one's
    limbs to be mixed up."""
    touch = np.zeros_like(close)
    for at in np.flatnonzero(np.sum(close, 0) > 1).tolist():
        who = np.flatnonzero(close[:, at]).tolist()
        for k, j in permutations(who, 2):
            some = evenly(subjects[k].frames[at].points)
            if np.any(surface_distance(tracks[j], at, some, CLOSE) < CLOSE):
                touch[[k, j], at] = True
    return touch


def _exchanged(subjects: list[Subject], frames: list[list[BodyObservation]]) -> Bool[np.ndarray, " person"]:
    """People whose points changed enough to be tracked again. Frames without changes stay."""
    concerned = np.zeros(len(subjects), bool)
    for k, (subject, own) in enumerate(zip(subjects, frames)):
        count = 0  # of frames in which enough points change hands
        for at, (before, now) in enumerate(zip(subject.frames, own)):
            if now is before:
                continue
            moved = len(np.setxor1d(_rows(before), _rows(now)))
            count += moved > MOVED * max(len(before.points), 1)
            own[at] = now if moved else before
        concerned[k] = count >= FRAMES
    return concerned


def _rows(frame: BodyObservation) -> np.ndarray:
    """A frame's points, each as one value."""
    return np.ascontiguousarray(frame.points, np.float32).view(np.dtype((np.void, 12))).ravel()


def surface_distance(
    tracks: Tracks, at: int, points: Float32[np.ndarray, "point 3"], most: float = np.inf
) -> Float[np.ndarray, " point"]:
    """Distances of points from the surface of a person's nearest limb in a frame, metres; at most `most`."""
    sizes = np.asarray(tracks.body.sizes, np.float32)
    return body_distance(sizes, tracks.rotation[at], tracks.translation[at], points, most)


def _box(tracks: Tracks, at: int) -> tuple[Float32[np.ndarray, "3"], Float32[np.ndarray, "3"]]:
    """Lower and upper corner of a box around a person, metres."""
    places = np.concatenate([tracks.translation[at], tracks.joints[at]])
    wide = float(np.max(np.asarray(tracks.body.sizes)[:, :4]))
    return np.nanmin(places, 0) - wide, np.nanmax(places, 0) + wide


def _meet(one: tuple, other: tuple) -> bool:
    """Whether two boxes have a place in common."""
    return bool(np.all(one[0] < other[1]) and np.all(other[0] < one[1]))
