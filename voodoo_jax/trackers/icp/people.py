"""Tracks several people in one recording separately, and assigns points between them. Host side.

At first, points are assigned by people's places in the previous frame (detect/tracklets.py), which is wrong where they
touch. Once all are tracked, a point near several people is assigned to the one with the nearest limb, and people whose
points changed are tracked again.
"""

from dataclasses import replace
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float, Float32, Int8

from voodoo_jax.detect.visibility import has_far_sides
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.subject import Subject
from voodoo_jax.records.tracks import Status, Tracks
from voodoo_jax.storage.cores import at_once
from voodoo_jax.trackers.base import Task
from voodoo_jax.trackers.icp.limb_distance import body_distance
from voodoo_jax.trackers.icp.misfit import AROUND, evenly
from voodoo_jax.trackers.icp.own_features import with_own_features
from voodoo_jax.trackers.icp.side_by_side import owned_in_turn
from voodoo_jax.trackers.icp.tracker import Unplaced, placed, track_poses, with_rating
from voodoo_jax.trackers.shared.runner import FEW_POINTS

CLOSE = 0.15  # metres from another person's limbs within which points may be mixed up; measured: with 0.25 0.2 cm worse
# times track.prior_interval from copy to copy of a scan: over it the pull to the prediction is weakest (solve/scan);
# measured: a person with arms stretched out 12.6 -> 6.6 cm beside copies at 30 Hz
LONG = 4
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


def track_subjects(task: Task, subjects: list[Subject]) -> list[Tracks]:
    """Tracks a body for each person, see find_people."""
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
    # recordings that are one batch wait for each other
    each = at_once if visit is None else lambda work, some: [work(one) for one in some]
    people = each(_tracked, [(task, s, begin) for s, begin in zip(subjects, begins)])
    if shares and not settings.changes:
        seen = each(_rated, people)
        touching = touching_in(subjects, seen, close_in(seen))
        frames = owned_in_turn(subjects, seen, touching, settings, AROUND, visit)
        anew = np.flatnonzero(_exchanged(subjects, frames)).tolist()
        subjects = [replace(s, frames=own) for s, own in zip(subjects, frames)]
        silent = replace(task, progress=None)
        now = each(_tracked, [(silent, subjects[k], in_view_from(subjects[k])) for k in anew])
        for k, one in zip(anew, now):
            people[k] = _again(one, people[k])
    found = each(placed, people)
    if several:
        found = [replace(t, status=_doubted(s, t.status)) for s, t in zip(subjects, found)]
    found = [t.since(added) for t in found]
    return [replace(t, person=s.number, people=len(subjects)) for s, t in zip(subjects, found)]


def _tracked(work: tuple[Task, Subject, int]) -> Unplaced:
    return track_poses(*work)


def _rated(one: Unplaced) -> Tracks:
    return with_rating(one.run, one.tracks)


def main_first(found: list[Tracks]) -> list[int]:
    """The order of people: those seen longest first, but uncertain people last."""
    return sorted(range(len(found)), key=lambda k: not found[k].tracked.any())


def numbered(found: list[Tracks], order: list[int]) -> list[Tracks]:
    """People in an order, with their numbers."""
    return [replace(found[k], person=number) for number, k in enumerate(order, 1)]


def held(frames: list[BodyObservation], count: int, interval: float) -> list[BodyObservation]:
    """Frames after copies of the first one, so that one or two scans take as many steps as the start of a recording."""
    step = round(LONG * interval * 1e9)
    return [replace(f, time_ns=f.time_ns - k * step) for f in frames[:1] for k in range(count, 0, -1)] + frames


def _again(now: Unplaced, before: Unplaced) -> Unplaced:
    """A person tracked again, with the time of both passes."""
    return now._replace(tracks=replace(now.tracks, seconds=now.tracks.seconds + before.tracks.seconds))


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
