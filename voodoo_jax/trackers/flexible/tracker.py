"""The flexible tracker on a whole recording: from features, points and head to filters and tracks. Host side."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Float32, Float64, Int, Int64
from scipy.ndimage import gaussian_filter1d

from voodoo_jax.compile.executable import seconds_of_waiting
from voodoo_jax.config.options import FlexibleSettings, Settings
from voodoo_jax.detect.disk_buffer import spilled
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.model.body import Body, scaled
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Evidence, Status, Tracks
from voodoo_jax.trackers.base import LogInfo, Progress, Unsuitable
from voodoo_jax.trackers.flexible.confidence import rate_joints
from voodoo_jax.trackers.flexible.filters import start, track_chunk
from voodoo_jax.trackers.flexible.flexible_body import (
    LIMBS,
    LOWER,
    UPPER,
    FlexibleBody,
    flexible_body,
    rest_points,
)
from voodoo_jax.trackers.flexible.guesses import Guesses
from voodoo_jax.trackers.flexible.head import HeadFilter, Start, find_start, first_pose, with_bare_legs
from voodoo_jax.trackers.flexible.image_features import SkinModel
from voodoo_jax.trackers.flexible.observed import Observed, chosen_points, looks, observe, uses_dense, view_of
from voodoo_jax.trackers.flexible.physics import NO_FLOOR
from voodoo_jax.trackers.flexible.poses import centres_of, limb_poses
from voodoo_jax.trackers.flexible.scores import NO_GUESS, Weighing, log_weight
from voodoo_jax.trackers.flexible.state import Inputs, Numbers, Seen, Shape, State
from voodoo_jax.trackers.shared.leftovers import FURNITURE_NOTE, Leftovers
from voodoo_jax.trackers.shared.runner import FEW_POINTS

NOBODY = "Nobody was found."
LEFTOVERS = Leftovers()
CHUNK = 16  # frames per run of the program, limited by the images' memory: any gives the same
# greatest distance of a face from the person's highest points, share of stature: farther skin is a hand. Measured:
# without it a punch is 1 cm worse
_BELOW = 0.35
# frames over which both passes are compared, and least advantage of the second one (share of the points; logarithm of a
# weight): by hand
_STRETCH, _EXPLAINS_MORE, _SCORES_MORE = 2.0, 0.02, 2.0
_AGREE = 0.15  # metres between passes up to which their mean is taken: measured on half of the stereo logs
_SMOOTH = 0.047  # seconds, standard deviation: measured on the same logs
_TRUNK = np.unique([*UPPER, *LOWER])
_LIMB_OF = np.array([next((n for n, rows in enumerate(LIMBS) if p in rows), -1) for p in range(16)])


def numbers(s: FlexibleSettings, floor: Plane | None = None) -> Numbers:
    """The settings that a program takes as traced numbers. The floor is used only with points: the paper has none."""
    plane = NO_FLOOR if floor is None or not uses_dense(s) else (*floor.normal.tolist(), floor.offset)
    f = lambda x: jnp.asarray(x, jnp.float32)  # noqa: E731
    weighing = Weighing(
        f(s.edge_weight), f(s.surface_weight), f(s.depth_weight), f(s.points_weight), f(s.skin_weight),
        f(s.hidden_edge), f(s.hidden_surface), f(0.5), f(float(s.seen_length)), f(s.unseen),
        f(0.2),
    )  # fmt: skip
    return Numbers(
        weighing, f(s.velocity), f(s.depth_share), f(s.depth_noise), f(s.base_noise), f(s.spread_noise),
        f(s.motion_noise), f([s.follow_level, s.follow_up]), f(s.gravity),
        f([s.mass_base, s.mass_variable, s.mass_falloff]), f(s.legs_apart - s.legs_cross), f(plane),
        f([s.turning, s.leaning]), f(s.sharpness),
    )  # fmt: skip


def shape_of(s: FlexibleSettings) -> Shape:
    """The settings that a program is compiled for."""
    points = s.points_weight > 0 or s.refine > 0
    return Shape(s.particles, s.layers, s.relaxations, s.refine, s.hypotheses, points)


def check_suited(body: Body, settings: Settings) -> None:
    """Raises Unsuitable for a body without a person's joints and for one that changes, before long computations."""
    rest_points(body)
    if settings.changes:
        raise Unsuitable("[[change]] in the settings: the flexible tracker does not support it, use --tracker icp")


def track_frames(
    body: Body, frames: Iterable[Frame], source: LogInfo, settings: Settings, progress: Progress | None = None
) -> Tracks:
    """Tracks a person through frames with pictures. Raises Unsuitable."""
    check_suited(body, settings)
    began = time.perf_counter()
    seen = observe(frames, source.up, body, settings, source.path, source.up_is_given)
    try:
        return follow(body, seen, settings, source.path, source.fixed_frame, source.notes(), progress, began)
    finally:
        seen.close()


class Followed(NamedTuple):
    """Tracks of a recording, and the results that they are made from."""

    tracks: Tracks
    found: Seen | None  # results in the rows from `first` on; None: no person was found
    first: int
    skin: SkinModel
    seen: Observed  # its first camera is the one that sees the face


# 8 parameters: those of the program that it is
def follow(
    body: Body, seen: Observed, settings: Settings, source: str, fixed_frame: str, notes: tuple[str, ...] = (),
    progress: Progress | None = None, began: float | None = None,
) -> Tracks:  # fmt: skip
    """Tracks of what was observed."""
    return followed(body, seen, settings, source, fixed_frame, notes, progress, began).tracks


# 8 parameters: those of `follow`
def followed(
    body: Body, seen: Observed, settings: Settings, source: str, fixed_frame: str, notes: tuple[str, ...] = (),
    progress: Progress | None = None, began: float | None = None,
) -> Followed:  # fmt: skip
    """Tracks an observed recording; returns the tracks and the results that they are made from."""
    s, waited = settings.flexible, seconds_of_waiting()
    began = time.perf_counter() if began is None else began
    on = begun(body, seen, settings)
    if on is None:
        nobody = nobody_of(body, seen.time_ns, seen.scene, source, fixed_frame, (*notes, NOBODY))
        return Followed(nobody, None, 0, SkinModel(), seen)
    states, every = forward_pass(on, s, progress)
    for _ in range(0 if settings.skips("track", "drop_unexplained", True) else LEFTOVERS.most):
        left = without_furniture(
            scaled(body, on.begin.stature), on.seen.people, on.first, chosen(every, descent(every))
        )
        again = None if left is None else begun(body, replace(on.seen, people=left), settings)
        if again is None:
            break
        on, notes = again, (*notes, FURNITURE_NOTE) if FURNITURE_NOTE not in notes else notes
        states, every = forward_pass(on, s)
    seen, order = on.seen, range(on.first, len(on.seen.features))
    at = descent(every, settings.online)
    found = chosen(every, at)
    if s.backwards and not settings.online:
        again = jax.random.fold_in(on.key, 2**30 + 1)
        back = states._replace(before=states.x, previous=states.particles, rate=-states.rate)
        last = int((every.follows[-1] == at[-1]).argmax())
        back = jax.tree.map(lambda a: jnp.repeat(a[last : last + 1], len(a), 0), back)
        _, every = filtered(on, back, seen, order[::-1], again, s, progress)
        second = chosen(every, descent(every))
        found = better(found, jax.tree.map(lambda a: a[::-1], second), numbers(s).weighing)
        found = found._replace(x=smoothed(np.asarray(found.x), seen.time_ns[seen.row[on.first :]]))
    nobody = nobody_of(body, seen.time_ns, seen.scene, source, fixed_frame, notes)
    tracks = finished(on, nobody, found, settings)
    compiling = seconds_of_waiting() - waited
    tracks = replace(tracks, seconds=time.perf_counter() - began - compiling, compile_seconds=compiling)
    return Followed(tracks, found, on.first, on.skin, seen)


def started(seen: Observed, stature: float) -> tuple[Observed, SkinModel, int, Start | None]:
    """Finds the start: the recording with the camera that sees a face in the person's first row as first camera, the
    colours of skin, that row, and the start (None: no person was found).

    **Arguments:** `stature` metres, 0: measured.
    """
    found: list[tuple[Observed, SkinModel, int, Start]] = []
    for camera in range(1 + len(seen.others)):
        view, skin = seen.from_camera(camera) if camera else seen, SkinModel()
        enough = (i for i, person in enumerate(view.people) if len(person.points) >= 3 * FEW_POINTS)
        if (first := next(enough, None)) is None:
            continue
        # this camera's points alone: the head's centre lies behind the side of it that the camera sees
        points = _select_nearest_sensor(view.people[first], view.features.place(first))
        begin = find_start(view.features[first], points, view.scene.floor, skin, stature)
        found.append((view, skin, first, begin))
        if begin.face_seen:
            return found[-1]
    return found[0] if found else (seen, SkinModel(), 0, None)


def _select_nearest_sensor(person: BodyObservation, camera: Float64[np.ndarray, "3"]) -> Float32[np.ndarray, "point 3"]:
    """The points on a person from the sensor nearest to a camera."""
    if len(person.origins) == 1:
        return person.points
    return person.points[person.sensor == np.linalg.norm(person.origins - camera, axis=1).argmin()]


class Heads:
    """The head in each row so far, from its filter. Metres, fixed frame."""

    def __init__(self, seen: Observed, first: int, begin: Start, skin: SkinModel, s: FlexibleSettings):
        self.place: dict[int, np.ndarray] = {}  # [3] by row; absent: no face was seen
        self._stature = begin.stature
        self._filter = HeadFilter(skin, begin.stature, s.head_particles, np.random.default_rng(s.seed))
        self._filter.begin(seen.features[first], begin.head, begin.face_seen)
        self._blind = not begin.face_seen

    def look(self, seen: Observed, i: int) -> None:
        """Adds the next row."""
        if self._blind:
            return
        f, points = seen.features[i], seen.people[i].points
        found = self._filter(f)
        if len(points) > 50:
            height = seen.scene.floor.height(points)
            top = np.median(points[height > np.percentile(height, 97)], 0).astype(np.float32)
            if found is not None and np.linalg.norm(found - top) > _BELOW * self._stature:
                found = None  # skin elsewhere, such as a hand
            if found is None:
                self._filter.follow(f, top)
        if found is not None:
            self.place[i] = found


class Begun(NamedTuple):
    """Tracking from the first row with a person."""

    seen: Observed  # its first camera is the one that sees the face
    skin: SkinModel
    first: int  # row
    begin: Start
    heads: Heads
    guesses: Guesses | None  # None: a single hypothesis, as in the paper, or an unknown floor
    model: FlexibleBody
    states: State  # before the first row; leading axis: hypothesis
    key: jax.Array

    def look(self, row: int) -> None:
        """Adds the next row."""
        self.heads.look(self.seen, row)
        if self.guesses is not None:
            self.guesses.look(row, self.seen.people[row], self.seen.scene.floor)


def begun(body: Body, seen: Observed, settings: Settings) -> Begun | None:
    """Starts tracking; None without a person so far."""
    s = settings.flexible
    seen, skin, first, begin = started(seen, settings.start.scale)
    if begin is None:
        return None
    model, shape, key = flexible_body(body, begin.stature), shape_of(s), jax.random.PRNGKey(s.seed)
    x = first_pose(np.asarray(model.rest), begin, seen.scene.floor.normal.astype(np.float32))
    model = with_bare_legs(model, x, *chosen_points(seen, first, s, looks(seen, first, s, skin)))
    state = start(jax.random.fold_in(key, 2**30), model, jnp.asarray(x), shape)
    states = jax.tree.map(lambda a: jnp.repeat(a[None], shape.hypotheses, 0), state)
    guesses = None if shape.hypotheses == 1 or seen.scene.floor_open else Guesses(np.asarray(model.rest))
    return Begun(seen, skin, first, begin, Heads(seen, first, begin, skin, s), guesses, model, states, key)


def forward_pass(on: Begun, s: FlexibleSettings, progress: Progress | None = None) -> tuple[State, Seen]:
    """The states after all rows and what was seen in each, by a pass forwards through the recording."""
    order = range(on.first, len(on.seen.features))
    for i in order:
        on.look(i)
    return filtered(on, on.states, on.seen, order, on.key, s, progress)


def without_furniture(
    body: Body, people: Sequence[BodyObservation], first: int, found: Seen
) -> Sequence[BodyObservation] | None:
    """The people of all rows without points at rest that the body, as it was found in the rows from `first` on, leaves
    unexplained; None without any."""
    segment, rows = Segment.blank(len(people), body.limb_count), slice(first, None)
    segment.status[rows], segment.explained[rows] = Status.TRACKED, found.explained
    segment.rotation[rows], segment.translation[rows] = limb_poses(body, np.asarray(found.x, float))
    left = LEFTOVERS.without(list(people), [(0, body)], segment)
    return None if left is None else spilled(left)


def finished(on: Begun, nobody: Tracks, found: Seen, settings: Settings) -> Tracks:
    """The tracks of `nobody_of` filled with results and confidence."""
    rows = range(on.first, on.first + len(found.x))
    tracks = tracks_of(nobody, on.begin, on.seen, on.first, found, camera_places(on.seen, rows))
    if not on.begin.face_seen:
        tracks = replace(
            tracks, notes=(*tracks.notes, "No face was seen at the start: it was taken to be turned here.")
        )
    least = settings.flexible.lost_confidence
    return rate_joints(tracks, found, on.seen.row[on.first :], least, not settings.online)


# 6 parameters: the sources of a chunk of frames
def _build_inputs(on: Begun, seen: Observed, at: list[int], s: FlexibleSettings, up: np.ndarray, pad: int) -> Inputs:
    rows, heads, skin = [], on.heads, on.skin
    guesses = on.guesses.place if on.guesses is not None else {}
    for k, i in enumerate(at):
        views = looks(seen, i, s, skin)
        view, *more = (view_of(look) for look in views)
        points, share, bare = chosen_points(seen, i, s, views)
        dt = 1 / 15 if i == 0 else abs(int(seen.time_ns[seen.row[i]]) - int(seen.time_ns[seen.row[i - 1]])) / 1e9
        rows.append(Inputs(
            view._replace(more=tuple(more)), points, share, bare, heads.place.get(i, np.zeros(3, np.float32)),
            np.float32(float(i in heads.place)), up, np.float32(min(dt, 0.2)), np.asarray(i, np.int32),
            np.float32(float(i < s.learn_frames)), np.asarray(k < len(at) - pad),
            guesses.get(i, NO_GUESS),
        ))  # fmt: skip
    return jax.tree.map(lambda *each: np.stack(each), *rows)


# 7 parameters: a pass runs in both directions and live
def filtered(
    on: Begun, states: State, seen: Observed, order: range, key: jax.Array, s: FlexibleSettings,
    progress: Progress | None = None,
) -> tuple[State, Seen]:  # fmt: skip
    """Runs the filters over rows in a given order. Leading axes: of states hypothesis; of results frame, hypothesis."""
    out, n, shape = [], numbers(s, seen.scene.floor), shape_of(s)
    up, frames = seen.scene.floor.normal.astype(np.float32), list(order)
    for begin in range(0, len(frames), CHUNK):
        at = frames[begin : begin + CHUNK]
        pad = CHUNK - len(at)
        given = jax.device_put(_build_inputs(on, seen, at + at[-1:] * pad, s, up, pad))
        states, found = track_chunk(on.model, states, given, key, n, shape)
        out.append(jax.tree.map(np.asarray, found))
        if progress is not None:
            progress(len(at))
    return states, jax.tree.map(lambda *each: np.concatenate(each)[: len(frames)], *out)  # without padding


def chosen(every: Seen, at: Int[np.ndarray, " frame"]) -> Seen:
    """The results of one hypothesis in each frame."""
    return jax.tree.map(lambda a: a[np.arange(len(at)), at], every)


def descent(every: Seen, online: bool = False) -> Int[np.ndarray, " frame"]:
    """For each frame the ancestor of the best hypothesis in the last frame; `online`: the best hypothesis of the
    frame."""
    fit, follows, anew = (np.asarray(a) for a in (every.fit, every.follows, every.anew))
    at = fit.argmax(1)
    for i in range(len(fit) - 1, 0, -1) if not online else ():
        at[i - 1] = at[i - 1] if anew[i, at[i]] else follows[i - 1, at[i]]  # before a restart: the best of that frame
    return at


def camera_places(seen: Observed, at: Iterable[int]) -> Float[np.ndarray, "frame 3"]:
    """Positions of the first camera in some rows, metres."""
    return np.array([seen.features.place(i) for i in at], float)


def better(ahead: Seen, back: Seen, weighing: Weighing) -> Seen:
    """Merges a forward and a backward pass: in each stretch of time the body that explains more points, with each limb
    from the pass with the higher score."""
    smooth = lambda a: gaussian_filter1d(np.asarray(a, float), _STRETCH, axis=0, mode="nearest")  # noqa: E731
    gain = smooth(back.explained - ahead.explained) > _EXPLAINS_MORE
    pick = lambda a, b: np.where(gain.reshape(-1, *[1] * (a.ndim - 1)), b, a)  # noqa: E731
    body, other = jax.tree.map(pick, ahead, back), jax.tree.map(pick, back, ahead)
    scores = [smooth(np.asarray(log_weight(jax.tree.map(jnp.asarray, s.score), weighing))) for s in (body, other)]
    swap = scores[1] - scores[0] > _SCORES_MORE  # [frame, limb]
    x, spread = body.x.copy(), body.spread.copy()
    for limb, rows in enumerate(LIMBS):
        moved = other.x[:, rows] + (body.x[:, rows[:1]] - other.x[:, rows[:1]])
        x[:, rows] = np.where(swap[:, limb, None, None], moved, x[:, rows])
        spread[:, limb] = np.where(swap[:, limb, None], other.spread[:, limb], spread[:, limb])
    # the mean where both agree, in the trunk too: each pass lags behind the motion in its direction
    swapped = (swap[:, _LIMB_OF] & (_LIMB_OF >= 0))[..., None]
    off = np.where(swapped, body.x, other.x) - x
    apart = np.linalg.norm(off, axis=-1)
    apart = np.maximum(apart, apart[:, _TRUNK].max(1, keepdims=True))
    share = 0.5 * np.clip(2 - apart / _AGREE, 0, 1)[..., None]
    return body._replace(x=(x + share * off).astype(np.float32), spread=spread)


def smoothed(x: Float32[np.ndarray, "frame 16 3"], time_ns: np.ndarray) -> Float32[np.ndarray, "frame 16 3"]:
    """Smooths the particles' noise: zero-phase, over a time too short to affect fast hands."""
    if len(x) < 2:
        return x
    sigma = _SMOOTH / max(float(np.median(np.diff(time_ns))) / 1e9, 1e-3)
    return gaussian_filter1d(x, sigma, axis=0, mode="nearest")


def tracks_of(tracks: Tracks, begin: Start, seen: Observed, first: int, found: Seen, camera: np.ndarray) -> Tracks:
    """The tracks of `nobody_of` filled with results from row `first` on."""
    body = scaled(tracks.body, begin.stature)
    rows, x = seen.row[first:], np.asarray(found.x, float)
    tracks.rotation[rows], tracks.translation[rows] = limb_poses(body, x)
    tracks.joints[rows] = centres_of(body, x, begin.stature, camera)
    tracks.status[rows] = Status.TRACKED
    fit = tracks.evidence
    fit.residual[rows], fit.explained[rows], fit.limb_weight[:] = found.residual, found.explained, 1
    fit.points[seen.row] = [len(p.points) for p in seen.people]
    return replace(tracks, body=body)


# 6 parameters: the fields of tracks
def nobody_of(
    body: Body, time_ns: Int64[np.ndarray, " frame"], scene: Scene, source: str = "", fixed_frame: str = "",
    notes: tuple[str, ...] = (),
) -> Tracks:  # fmt: skip
    """Tracks of a recording without a person."""
    count, limbs, centres = len(time_ns), body.limb_count, len(body.topology.centres)
    blank = lambda *shape: np.full((count, *shape), np.nan, np.float32)  # noqa: E731
    return Tracks(
        source, fixed_frame, body, time_ns, blank(limbs, 4), blank(limbs, 3), blank(centres, 3),
        np.full(count, Status.NOT_STARTED, np.int8), Evidence.blank(count, limbs), notes=notes,
        up=scene.floor.normal.astype(np.float32),
    )  # fmt: skip
