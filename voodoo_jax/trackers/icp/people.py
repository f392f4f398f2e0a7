"""Several people in one recording, each tracked by itself, and which of them owns a point decided by all. Host side.

People are told apart first by where they were in the frame before (detect/people.py), which is wrong where they touch.
Once each is tracked, a point that is near several goes to whom its nearest limb belongs to, as within one body, and who
has gained or lost some is tracked anew.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int8

from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation, joined
from voodoo_jax.records.subject import Subject
from voodoo_jax.records.tracks import Status, Tracks
from voodoo_jax.solve.scan import Visit
from voodoo_jax.trackers.icp.limb_distance import signed_distance
from voodoo_jax.trackers.icp.runner import FEW_POINTS
from voodoo_jax.trackers.icp.sequence import Progress
from voodoo_jax.trackers.icp.tracker import track_person

ROUNDS = 2  # in which points change hands and who is concerned is tracked anew; by hand
NEAR = 0.25  # metres from somebody's surface: what is farther off is none of their points; by hand
CLEARLY = 0.02  # metres nearer to somebody else: who has a point keeps it else; about a depth camera's noise, by hand
MOVED = 0.02  # of somebody's points that change hands in a frame: fewer make no difference; by hand
FRAMES = 3  # with so many points that change hands: fewer make no difference; by hand
SLIVER = 0.12  # of that area: who shows less is not tracked; by hand
WHOLE = 0.5  # of the area that is usually seen of somebody: who shows so much is wholly in view; by hand


# 8 parameters, as track_person
def track_subjects(
    body: Body,
    subjects: list[Subject],
    settings: Settings,
    source: str,
    fixed_frame: str,
    notes: tuple[str, ...] = (),
    progress: Progress | None = None,
    visit: Visit | None = None,
) -> list[Tracks]:
    """Tracks a body through what was seen of each person, see find_people; the others as for track_person."""

    names = [subject.name for subject in subjects if subject.name]
    shares = any(len(frame.points) for subject in subjects for frame in subject.frames)

    def tracked(subject: Subject, say: Progress | None = None) -> Tracks:
        whose = f"Named points of {len(names)} people: these are the tracks of '{subject.name}'."
        told = [whose] if subject.name else []
        begin = in_view_from(subject) if len(subjects) > 1 else 0
        return track_person(
            body, subject.scene, subject.frames, settings, source, fixed_frame, (*notes, *told), say, visit, begin
        )

    found = [tracked(subject, progress) for subject in subjects]
    for _ in range(ROUNDS if len(subjects) > 1 and shares else 0):
        subjects, concerned = shared_out(subjects, found)
        if not concerned.any():
            break
        anew = [(tracked(s), t) if c else (t, None) for s, t, c in zip(subjects, found, concerned)]
        found = [replace(t, seconds=t.seconds + old.seconds) if old else t for t, old in anew]
    if len(subjects) > 1:
        found = [replace(t, status=_doubted(s, t.status)) for s, t in zip(subjects, found)]
    return [replace(t, person=s.number, people=len(subjects)) for s, t in zip(subjects, found)]


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


def shared_out(subjects: list[Subject], tracks: list[Tracks]) -> tuple[list[Subject], Bool[np.ndarray, " person"]]:
    """The subjects with the points near several of them given to whom the nearest limb is, and who has gained or lost
    enough to be tracked anew."""
    frames = [list(subject.frames) for subject in subjects]
    counts = np.zeros(len(subjects), int)  # of frames in which enough points change hands
    for at in range(len(frames[0])):
        sure = [k for k, t in enumerate(tracks) if t.status[at] == Status.TRACKED]
        boxes = {k: _box(tracks[k], at) for k in sure}
        close = [k for k in sure if any(_meet(boxes[k], boxes[j]) for j in sure if j != k)]
        if len(close) < 2:
            continue
        now, moved = _given([f[at] for f in frames], tracks, close, at)
        for k in close:
            if moved[k] > MOVED * max(len(frames[k][at].points), 1):
                counts[k] += 1
            frames[k][at] = now[k]
    concerned = counts >= FRAMES
    return [replace(s, frames=f) for s, f in zip(subjects, frames)], concerned


def _given(
    seen: list[BodyObservation], tracks: list[Tracks], close: list[int], at: int
) -> tuple[list[BodyObservation], Int[np.ndarray, " person"]]:
    """The frames of all people after those who are close to each other have given points away, and of each how many
    they have gained or lost."""
    owner = {}
    for k in close:
        points = seen[k].points
        distance = np.stack([surface_distance(tracks[j], at, points, NEAR) for j in close])
        distance[close.index(k)] -= CLEARLY
        best = np.argmin(distance, 0)
        owner[k] = np.where(np.min(distance, 0) < NEAR, np.array(close)[best], k)
    out, moved = list(seen), np.zeros(len(seen), int)
    for k in close:
        gained = [seen[j].only(owner[j] == k) for j in close if j != k]
        moved[k] = np.sum(owner[k] != k) + sum(len(g.points) for g in gained)
        out[k] = joined([seen[k].only(owner[k] == k), *gained]) if moved[k] else seen[k]
    return out, moved


def surface_distance(
    tracks: Tracks, at: int, points: Float32[np.ndarray, "point 3"], most: float = np.inf
) -> Float[np.ndarray, " point"]:
    """How far points are from the surface of somebody's nearest limb in a frame, metres; `most` where it is more."""
    out = np.full(len(points), min(most, 1e3))
    low, high = _box(tracks, at)
    near = np.flatnonzero(np.all((points > low - out[:1].max(initial=0)) & (points < high + out.max(initial=0)), 1))
    some = points[near]
    best = out[near]
    for limb, size in enumerate(np.asarray(tracks.body.sizes, np.float32)):
        turn, place = tracks.rotation[at, limb], tracks.translation[at, limb]
        if not np.isfinite(place).all():
            continue
        best = np.minimum(best, np.abs(signed_distance(size, _into(turn, some - place))))
    out[near] = best
    return out


def _into(turn: Float32[np.ndarray, "4"], v: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, "point 3"]:
    """Vectors in a limb's frame; `turn` unit quaternion wxyz of the limb."""
    w, axis = turn[0], turn[1:]
    twice = 2 * np.cross(-axis, v)
    return v + w * twice + np.cross(-axis, twice)


def _box(tracks: Tracks, at: int) -> tuple[Float32[np.ndarray, "3"], Float32[np.ndarray, "3"]]:
    """Lower and upper corner of a box around somebody, metres."""
    places = np.concatenate([tracks.translation[at], tracks.joints[at]])
    wide = float(np.max(np.asarray(tracks.body.sizes)[:, :4]))
    return np.nanmin(places, 0) - wide, np.nanmax(places, 0) + wide


def _meet(one: tuple, other: tuple) -> bool:
    """Whether two boxes have a place in common."""
    return bool(np.all(one[0] < other[1]) and np.all(other[0] < one[1]))
