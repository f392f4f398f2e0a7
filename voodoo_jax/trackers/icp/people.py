"""Several people in one recording, each tracked by itself, and which of them owns a point decided by all. Host side.

People are told apart first by where they were in the frame before (detect/tracklets.py), which is wrong where they
touch. Once each is tracked, a point that is near several goes to whom its nearest limb belongs to, as within one body,
and who has gained or lost some is tracked anew.
"""

from dataclasses import replace
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float, Float32, Int8

from voodoo_jax.detect.tracklets import CLOSE
from voodoo_jax.detect.visibility import has_far_sides
from voodoo_jax.records.observation import BodyObservation, joined
from voodoo_jax.records.subject import Subject
from voodoo_jax.records.tracks import Status, Tracks
from voodoo_jax.trackers.base import Task
from voodoo_jax.trackers.icp.limb_distance import body_distance
from voodoo_jax.trackers.icp.misfit import AROUND
from voodoo_jax.trackers.icp.own_features import with_own_features
from voodoo_jax.trackers.icp.side_by_side import owned_in_turn
from voodoo_jax.trackers.icp.tracker import Unplaced, placed, track_poses, with_rating
from voodoo_jax.trackers.shared.runner import FEW_POINTS

ASKED_FRAMES = 10  # of a recording: by so many, evenly spread, it is told whether clouds were joined; by hand
# times track.prior_interval from copy to copy of a scan: over it the pull to the prediction is weakest (solve/scan);
# measured: somebody with arms stretched out 12.6 -> 6.6 cm beside copies at 30 Hz
LONG = 4
FUSED = (
    "Points are on all sides of the body: clouds of several sensors were joined, and where these stood is not known. "
    "Which side of a limb a sensor sees is not asked."
)
ROUNDS = 2  # in which points change hands and who is concerned is tracked anew; by hand
SOME = 4  # of somebody's points, one of so many tells whether they are near to somebody else; by hand
CLEARLY = 0.02  # metres nearer to somebody else: who has a point keeps it else; about a depth camera's noise, by hand
MOVED = 0.02  # of somebody's points that change hands in a frame: fewer make no difference; by hand
FRAMES = 3  # with so many points that change hands: fewer make no difference; by hand
SLIVER = 0.12  # of that area: who shows less is not tracked; by hand
WHOLE = 0.5  # of the area that is usually seen of somebody: who shows so much is wholly in view; by hand


def track_subjects(task: Task, subjects: list[Subject]) -> list[Tracks]:
    """Tracks a body through what was seen of each person, see find_people."""
    settings, visit = task.settings, task.visit
    frames, repeats = subjects[0].frames, settings.looks_ahead("track") and not settings.changes
    added = max(0, settings.start.frames - len(frames)) if frames and repeats else 0
    subjects = [replace(s, frames=held(s.frames, added, settings.track.prior_interval)) for s in subjects]
    if any(has_far_sides(s.frames[:: len(s.frames) // ASKED_FRAMES + 1]) for s in subjects):
        settings = replace(settings, solve=replace(settings.solve, near_side=False))
        task = replace(task, settings=settings, source=task.source.noted(FUSED))
    several = len(subjects) > 1
    shares = several and any(len(frame.points) for subject in subjects for frame in subject.frames)
    if shares:
        subjects = with_own_features(subjects)
    begins = [in_view_from(s) if several else 0 for s in subjects]
    people = [track_poses(task, s, begin) for s, begin in zip(subjects, begins)]
    silent = replace(task, progress=None)
    for turn in range(ROUNDS if shares else 0):
        seen = [with_rating(one.run, one.tracks) for one in people]
        close = close_in(seen)
        if turn == 0 and not settings.changes:
            frames = owned_in_turn(subjects, seen, touching_in(subjects, seen, close), settings, AROUND, visit)
        else:
            frames = shared_out([s.frames for s in subjects], seen, close)
        concerned = _exchanged(subjects, frames)
        subjects = [replace(s, frames=own) for s, own in zip(subjects, frames)]
        if not concerned.any():
            break
        people = [
            _again(track_poses(silent, s, in_view_from(s)), one) if c else one
            for s, one, c in zip(subjects, people, concerned)
        ]
    found = [placed(one) for one in people]
    if several:
        found = [replace(t, status=_doubted(s, t.status)) for s, t in zip(subjects, found)]
    found = [t.since(added) for t in found]
    return [replace(t, person=s.number, people=len(subjects)) for s, t in zip(subjects, found)]


def main_first(found: list[Tracks]) -> list[int]:
    """The order of people: as they are, who is seen longest first, but last what was never surely a person."""
    return sorted(range(len(found)), key=lambda k: not found[k].tracked.any())


def numbered(found: list[Tracks], order: list[int]) -> list[Tracks]:
    """People in an order, with their numbers."""
    return [replace(found[k], person=number) for number, k in enumerate(order, 1)]


def held(frames: list[BodyObservation], count: int, interval: float) -> list[BodyObservation]:
    """Frames after so many copies of the first one: a scan or two take as many steps as the start of a recording."""
    step = round(LONG * interval * 1e9)
    return [replace(f, time_ns=f.time_ns - k * step) for f in frames[:1] for k in range(count, 0, -1)] + frames


def _again(now: Unplaced, before: Unplaced) -> Unplaced:
    """Who was tracked anew, with the time that both took."""
    return now._replace(tracks=replace(now.tracks, seconds=now.tracks.seconds + before.tracks.seconds))


def _doubted(subject: Subject, status: Int8[np.ndarray, " frame"]) -> Int8[np.ndarray, " frame"]:
    """Status, LOST where only a sliver of somebody is seen, at the edge of the picture or beside who hides them."""
    area = np.array([_area(frame) for frame in subject.frames])
    usual = np.percentile(area[area > 0], 80) if (area > 0).any() else 0.0
    return np.where((status == Status.TRACKED) & (area < SLIVER * usual), Status.LOST, status).astype(np.int8)


def in_view_from(subject: Subject) -> int:
    """The first frame in which somebody is wholly in view, before they are out of it for the first time; the first one
    in which they are seen at all if there is none."""
    area = np.array([_area(frame) for frame in subject.frames])
    there = np.flatnonzero(area > 0)
    if not len(there):
        return 0
    gaps = np.flatnonzero(np.diff(there) > FEW_POINTS)
    until = there[gaps[0]] + 1 if len(gaps) else len(area)
    whole = np.flatnonzero(area[:until] >= WHOLE * np.percentile(area[there], 80))
    return int(whole[0]) if len(whole) else int(there[0])


def _area(frame: BodyObservation) -> float:
    """As large as what is seen of somebody, in square metres times points per steradian."""
    if len(frame.points) < 3 * FEW_POINTS:
        return 0.0
    return float(np.sum((frame.points - frame.origins[frame.sensor]) ** 2))


def close_in(tracks: list[Tracks]) -> Bool[np.ndarray, "person frame"]:
    """In which frames each of some people may be near to another one."""
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
    """In which of the frames in which people are `close` some points of theirs are so near to another one's limbs that
    they may be mixed up."""
    touch = np.zeros_like(close)
    for at in np.flatnonzero(np.sum(close, 0) > 1).tolist():
        who = np.flatnonzero(close[:, at]).tolist()
        for k, j in permutations(who, 2):
            some = subjects[k].frames[at].points[::SOME]
            if np.any(surface_distance(tracks[j], at, some, CLOSE) < CLOSE):
                touch[[k, j], at] = True
    return touch


def shared_out(
    frames: list[list[BodyObservation]], tracks: list[Tracks], close: Bool[np.ndarray, "person frame"]
) -> list[list[BodyObservation]]:
    """Everybody's frames with the points of those who are `close` to each other given to whom the nearest limb is."""
    frames = [list(own) for own in frames]
    for at in np.flatnonzero(np.sum(close, 0) > 1).tolist():
        who = np.flatnonzero(close[:, at]).tolist()
        for k, now in zip(who, _given([frames[k][at] for k in who], [tracks[k] for k in who], at)):
            frames[k][at] = now
    return frames


def _given(seen: list[BodyObservation], tracks: list[Tracks], at: int) -> list[BodyObservation]:
    """What is seen of some people in a frame after they have given points away."""
    owner = []
    for k, own in enumerate(seen):
        distance = np.stack([surface_distance(other, at, own.points, AROUND) for other in tracks])
        distance[k] -= CLEARLY
        owner.append(np.where(np.min(distance, 0) < AROUND, np.argmin(distance, 0), k))
    everybody = range(len(seen))
    return [
        joined([own.only(owner[k] == k), *(seen[j].only(owner[j] == k) for j in everybody if j != k)])
        for k, own in enumerate(seen)
    ]


def _exchanged(subjects: list[Subject], frames: list[list[BodyObservation]]) -> Bool[np.ndarray, " person"]:
    """Who has gained or lost enough to be tracked anew. Where nothing changes hands the old frame stays."""
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
    """How far points are from the surface of somebody's nearest limb in a frame, metres; `most` where it is more."""
    sizes = np.asarray(tracks.body.sizes, np.float32)
    return body_distance(sizes, tracks.rotation[at], tracks.translation[at], points, most)


def _box(tracks: Tracks, at: int) -> tuple[Float32[np.ndarray, "3"], Float32[np.ndarray, "3"]]:
    """Lower and upper corner of a box around somebody, metres."""
    places = np.concatenate([tracks.translation[at], tracks.joints[at]])
    wide = float(np.max(np.asarray(tracks.body.sizes)[:, :4]))
    return np.nanmin(places, 0) - wide, np.nanmax(places, 0) + wide


def _meet(one: tuple, other: tuple) -> bool:
    """Whether two boxes have a place in common."""
    return bool(np.all(one[0] < other[1]) and np.all(other[0] < one[1]))
