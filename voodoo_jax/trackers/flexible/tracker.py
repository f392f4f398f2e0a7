"""The flexible tracker on a whole recording: features, person's points, head, filters, tracks. Host side."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import prod
from typing import IO, Any, NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, UInt8
from scipy.ndimage import gaussian_filter1d

from voodoo_jax.compile.executable import seconds_of_waiting
from voodoo_jax.config.options import FlexibleSettings, Settings
from voodoo_jax.detect.disk_buffer import spilled
from voodoo_jax.detect.pipeline import watched
from voodoo_jax.detect.target_selection import Chooser
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.model.body import Body, scaled
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Frame, Picture, Rays
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.stretches import stretches
from voodoo_jax.records.tracks import Status, Tracks
from voodoo_jax.storage.scratch import nameless_file
from voodoo_jax.trackers.base import Progress, Source, Unsuitable
from voodoo_jax.trackers.flexible.confidence import rated
from voodoo_jax.trackers.flexible.filters import Inputs, Numbers, Seen, Shape, State, start, track_chunk
from voodoo_jax.trackers.flexible.flexible_body import (
    LIMBS,
    LOWER,
    NECK,
    OTHER_SIDE,
    UPPER,
    FlexibleBody,
    flexible_body,
    rest_points,
)
from voodoo_jax.trackers.flexible.head import HeadFilter, Start, find_start, first_pose
from voodoo_jax.trackers.flexible.image_features import Extractor, Features, Near, SkinModel, depth_points
from voodoo_jax.trackers.flexible.poses import centres_of, directions, limb_poses
from voodoo_jax.trackers.flexible.scores import View, Weighing, log_weight

CHUNK = 16  # frames per run of the program: what fits into memory as images, by hand
_PATIENCE = 60  # frames without an image at the beginning of a log, after which none are expected, by hand
_BELOW = 0.35  # share of the stature that a face is at most from the person's top: else it is a hand, by hand
# frames over which passes are compared, and by how much the other has to be better (share of the points; logarithm of
# a weight): by hand
_STRETCH, _EXPLAINS_MORE, _SCORES_MORE = 2.0, 0.02, 2.0
_AWAY = -0.3  # cosine of the angle from the body's front to the camera, from which on it looks away, by hand
_AGREE = 0.15  # metres between passes up to which their mean is taken: on the study's half of stereo logs, measured
_SMOOTH = 0.047  # seconds, standard deviation: measured on the same ones
_OVER_FLOOR = 0.06  # metres: lower points are the floor's as often as the feet's by stereo, by hand
_OTHER_LIMB = np.array([1, 0, 3, 2])  # of each of the paper's filters, that of the other side
_OTHER_PART = np.array([3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8, 12, 13, 14])  # of each of the paper's cylinders
_TRUNK = np.unique([*UPPER, *LOWER])
_LIMB_OF = np.array([next((n for n, rows in enumerate(LIMBS) if p in rows), -1) for p in range(16)])
_NOTHING = np.zeros((0, 3), np.float32)
_BESIDE, _FASTEST = 0.25, 2.5  # metres from a person's points, and per second: so far hands may be next, by hand
_FEWEST = 120  # points of a person from which on tracking starts, by hand


class _Kept(NamedTuple):
    """Features of a frame on disk."""

    begin: int  # byte of the file
    kinds: list[tuple[np.dtype, tuple[int, ...]]]  # of the arrays
    place: Float64[np.ndarray, "3"]  # of the camera, metres


class FeatureStore:
    """A camera's features on disk, in the order of time; a recording's images do not fit into memory."""

    def __init__(self, file: IO[bytes] | None = None, at: Sequence["_Kept | None"] = ()):
        self._file = nameless_file() if file is None else file
        self._at = list(at)

    def __len__(self) -> int:
        return len(self._at)

    def close(self) -> None:
        """Gives the disk space back."""
        self._file.close()

    def add(self, f: Features | None, place: Float64[np.ndarray, "3"] | None = None) -> None:
        """Those of one more frame, and where the camera is, metres; None: it has no image of it."""
        if f is None or place is None:
            self._at.append(None)
            return
        self._at.append(_Kept(self._file.seek(0, 2), [(array.dtype, array.shape) for array in f], place))
        for array in f:
            self._file.write(np.ascontiguousarray(array).data)

    def place(self, i: int) -> Float64[np.ndarray, "3"]:
        """Where the camera is, metres."""
        return self._kept(i).place

    def _kept(self, i: int) -> "_Kept":
        found = self._at[i]
        if found is None:
            raise IndexError(f"no image in row {i}")
        return found

    def has(self, i: int) -> bool:
        return self._at[i] is not None

    def latest(self, i: int) -> tuple[Features, bool]:
        """Those of the row, or else the nearest ones, and which of both."""
        if self.has(i):
            return self[i], True
        there = [k for k in range(len(self)) if self.has(k)]
        return self[min(there, key=lambda k: abs(k - i))], False

    def rows(self, at: Sequence[int]) -> "FeatureStore":
        """Of some frames alone."""
        return FeatureStore(self._file, [self._at[i] for i in at])

    def __getitem__(self, i: int) -> Features:
        found = self._kept(i)
        self._file.seek(found.begin)
        read = self._file.read
        return Features(*(np.frombuffer(read(t.itemsize * prod(s)), t).reshape(s) for t, s in found.kinds))


def numbers(s: FlexibleSettings, floor: Plane | None = None) -> Numbers:
    """What of the settings a program takes as numbers. The paper knows no floor: only where points are used."""
    plane = (0.0, 0.0, 1.0, -1e3) if floor is None or not uses_dense(s) else (*floor.normal.tolist(), floor.offset)
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
    )  # fmt: skip


def shape_of(s: FlexibleSettings) -> Shape:
    """What of the settings a program is compiled for."""
    restarts = round(s.restart * s.particles)
    return Shape(s.particles, s.layers, s.relaxations, s.refine, restarts, s.flow, s.points_weight > 0 or s.refine > 0)


def uses_dense(s: FlexibleSettings) -> bool:
    """Whether the depth of all pixels is needed in all frames; else only while colours are learnt, and of the face."""
    return s.depth_weight > 0 or s.points_weight > 0 or s.refine > 0


@dataclass(frozen=True)
class Observed:
    """A recording as the filters take it. Rows are frames in which the first camera has an image."""

    features: FeatureStore  # of the first camera: flow, motion and the head come from it
    others: tuple[FeatureStore, ...]  # of further ones, which may have no image in some rows
    people: list[BodyObservation]
    scene: Scene
    time_ns: np.ndarray
    row: np.ndarray  # which frame of the recording each is
    count: int  # frames of the recording

    def close(self) -> None:
        """Gives the disk space back."""
        for store in (self.features, *self.others):
            store.close()

    def from_camera(self, number: int) -> "Observed":
        """With another camera as the first one."""
        stores = [self.features, *self.others]
        first = stores.pop(number)
        rows = [i for i in range(len(first)) if first.has(i)]
        return replace(
            self, features=first.rows(rows), others=tuple(s.rows(rows) for s in stores),
            people=[self.people[i] for i in rows], row=self.row[rows],
        )  # fmt: skip


class _Eyes:
    """All cameras of a recording: features, and the points of pairs; of frames with points none if these are `given`,
    which then tell the depth of all pixels. Raises ValueError for broken images."""

    def __init__(self, s: FlexibleSettings, given: bool):
        self._s, self._given, self._extract = s, given, dict[str, Extractor]()
        self.stores: dict[str, FeatureStore] = {}
        self._origins: dict[str, np.ndarray] = {}
        self.shown = 0  # frames with an image

    def __call__(self, frame: Frame, near: Near | None) -> Frame:
        """The frame with the points that are measured; its features are kept."""
        s, found = self._s, dict[str, tuple[Features, bool]]()
        given = self._given and len(frame.points) > 0
        for picture in sorted(frame.pictures, key=lambda picture: picture.topic):
            picture = _one_eyed(picture) if given else picture
            dense = given or uses_dense(s) or self.shown < s.learn_frames
            extract = self._extract.setdefault(picture.topic, Extractor())
            found[picture.topic] = extract(frame, picture, dense, s.flow, near), picture.baseline > 0
            if picture.topic not in self.stores:
                self.stores[picture.topic] = FeatureStore(at=[None] * self.shown)
        places = {picture.topic: picture.T_fixed_camera[:3, 3] for picture in frame.pictures}
        for topic, store in self.stores.items():
            store.add(found[topic][0] if topic in found else None, places.get(topic))
        self.shown += 1
        if given:
            return replace(frame, pictures=())
        frame = replace(frame, rays=Rays(), pictures=(), weight=None)
        pairs = {topic: f for topic, (f, is_pair) in found.items() if is_pair}
        if not pairs:
            return frame
        self._origins |= {topic: -f.shift @ f.turn for topic, f in pairs.items()}
        clouds = [depth_points(pairs[topic])[0] if topic in pairs else _NOTHING for topic in self._origins]
        sensor = np.repeat(np.arange(len(clouds), dtype=np.int32), [len(cloud) for cloud in clouds])
        origins = np.stack(list(self._origins.values())).astype(np.float32)
        return replace(frame, points=np.concatenate(clouds), sensor=sensor, origins=origins)

    def close(self) -> None:
        for store in self.stores.values():
            store.close()


def _one_eyed(picture: Picture) -> Picture:
    """A pair's left image alone."""
    return replace(picture, unpack=lambda: picture.unpack()[:1], baseline=0.0) if picture.baseline > 0 else picture


class Watching:
    """Frames on their way to who finds the person in them; features of their images are kept.

    **Arguments:** `source` path of the log; `given` somebody else tracks the same frames: they stay as they are but
    for their images, unless they have no points.
    """

    def __init__(self, settings: Settings, source: str, given: bool = False):
        self._eyes, self._source, self._given = _Eyes(settings.flexible, given), source, given
        self._preset = "both" if given else "flexible"
        self.near: Callable[[int], Near | None] = lambda time_ns: None  # where depth is needed at a time
        self._times: list[int] = []
        self.rows: list[int] = []  # which frames have an image

    def __call__(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The frames; those without an image are left out, unless they are given. Raises Unsuitable."""
        for number, frame in enumerate(frames):
            self._times.append(frame.time_ns)
            if frame.pictures:
                self.rows.append(number)
                yield self._eyes(frame, self.near(frame.time_ns))
            elif number >= _PATIENCE and not self.rows:
                raise self._without_images()
            elif self._given:
                yield frame

    def observed(self, people: list[BodyObservation], scene: Scene) -> Observed:
        """What was seen, once all frames are through; `people` of those with an image. Raises Unsuitable."""
        if not self.rows:
            raise self._without_images()
        first, *others = self._eyes.stores.values()
        row, times = np.array(self.rows, int), np.array(self._times, np.int64)
        whole = Observed(first, tuple(others), people, scene, times, row, len(times))
        return whole if all(first.has(i) for i in range(len(first))) else whole.from_camera(0)

    def close(self) -> None:
        """Gives the disk space back."""
        self._eyes.close()

    def _without_images(self) -> Unsuitable:
        return Unsuitable(
            f"'{self._source}' has no images that the flexible tracker could look at (a calibrated stereo pair, or a "
            "colour camera beside a depth camera; in Python read it with the settings of "
            f"vj.preset('{self._preset}')): use --tracker icp"
        )


def observe(
    frames: Iterable[Frame], up: Float32[np.ndarray, "3"], body: Body, settings: Settings, source: str
) -> Observed:
    """Reads features and finds the person's points. Raises Unsuitable."""
    watching = Watching(settings, source)
    try:
        chooser, found = watched(watching(frames), up, body, settings)
        watching.near = partial(_near, chooser)
        people = spilled(found)
        return watching.observed(people, chooser.finder.scene)  # now, for the floor may have been found with the body
    except BaseException:
        watching.close()
        raise


def _near(chooser: Chooser, time_ns: int) -> Near | None:
    """Where depth is needed in a frame of that time; None: everywhere."""
    points = chooser.near_only(time_ns)
    seconds = (time_ns - chooser.finder.last_ns) / 1e9
    return None if points is None else Near(points, _BESIDE + _FASTEST * max(seconds, 0.0))


def check_suited(body: Body, settings: Settings) -> None:
    """Raises Unsuitable, before anything long, for a body that is no person's and for one that changes."""
    rest_points(body)
    if settings.changes:
        raise Unsuitable("[[change]] in the settings: the flexible tracker knows none, use --tracker icp")


def track_frames(
    body: Body, frames: Iterable[Frame], source: Source, settings: Settings, progress: Progress | None = None
) -> Tracks:
    """Tracks a person through frames with pictures. Raises Unsuitable."""
    check_suited(body, settings)
    began = time.perf_counter()
    seen = observe(frames, source.up, body, settings, source.path)
    try:
        return follow(body, seen, settings, source.path, source.fixed_frame, source.notes(), progress, began)
    finally:
        seen.close()


class Followed(NamedTuple):
    """What was found of a recording, for those who look closer than tracks do."""

    tracks: Tracks
    found: Seen | None  # of frames with features, from number `first` on; None: nobody
    first: int
    skin: SkinModel
    seen: Observed  # with the camera first that sees the face


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
    """Tracks of what was observed, and what they were made of."""
    s, waited = settings.flexible, seconds_of_waiting()
    began = time.perf_counter() if began is None else began
    seen, skin, first, begin = started(seen, settings.start.scale)
    if begin is None:
        return Followed(_nobody(body, seen, source, fixed_frame, notes), None, first, skin, seen)
    model = flexible_body(body, begin.stature)
    floor_up = seen.scene.floor.normal.astype(np.float32)
    x = first_pose(np.asarray(model.rest), begin, floor_up)
    heads = heads_of(seen, first, begin, skin, s)
    key = jax.random.PRNGKey(s.seed)
    state = start(jax.random.fold_in(key, 2**30), model, jnp.asarray(x), shape_of(s))
    order = range(first, len(seen.features))
    state, found = run_filters(model, state, seen, heads, order, key, s, floor_up, skin, progress)
    camera = camera_places(seen, order)
    found = with_the_face(found, heads.seen[first:], camera, floor_up)
    if s.backwards and not settings.online:
        again = jax.random.fold_in(key, 2**30 + 1)
        back = state._replace(before=state.x, previous=state.particles)
        _, second = run_filters(model, back, seen, heads, order[::-1], again, s, floor_up, skin, progress)
        second = with_the_face(jax.tree.map(lambda a: a[::-1], second), heads.seen[first:], camera, floor_up)
        found = better(found, second, numbers(s).weighing)
        found = found._replace(x=smoothed(np.asarray(found.x), seen.time_ns[seen.row[first:]]))
    tracks = tracks_of(body, begin, seen, first, found, camera, source, fixed_frame, notes)
    compiling = seconds_of_waiting() - waited
    if not begin.face_seen:
        tracks = replace(
            tracks, notes=(*tracks.notes, "No face was seen at the start: it was taken to be turned here.")
        )
    tracks = rated(tracks, found, seen.row[first:], s.lost_confidence)
    tracks = replace(tracks, seconds=time.perf_counter() - began - compiling, compile_seconds=compiling)
    return Followed(tracks, found, first, skin, seen)


def started(seen: Observed, stature: float) -> tuple[Observed, SkinModel, int, Start | None]:
    """The recording with that camera first which sees a face where the person is first seen, the colours of skin there,
    the row, and what it says; None: nobody is found.

    **Arguments:** `stature` metres, 0: measured.
    """
    found: list[tuple[Observed, SkinModel, int, Start]] = []
    for camera in range(1 + len(seen.others)):
        view, skin = seen.from_camera(camera) if camera else seen, SkinModel()
        enough = (i for i, person in enumerate(view.people) if len(person.points) >= _FEWEST)
        if (first := next(enough, None)) is None:
            continue
        # of this camera alone: where a head is follows from the side that it sees of it
        points = _seen_by(view.people[first], view.features.place(first))
        begin = find_start(view.features[first], points, view.scene.floor, skin, stature)
        found.append((view, skin, first, begin))
        if begin.face_seen:
            return found[-1]
    return found[0] if found else (seen, SkinModel(), 0, None)


def _seen_by(person: BodyObservation, camera: Float64[np.ndarray, "3"]) -> Float32[np.ndarray, "point 3"]:
    """The points on a person that the sensor nearest to a camera measured."""
    if len(person.origins) == 1:
        return person.points
    return person.points[person.sensor == np.linalg.norm(person.origins - camera, axis=1).argmin()]


class Heads(NamedTuple):
    """The head in each frame, from its filter. Metres, fixed frame."""

    place: Float32[np.ndarray, "frame 3"]
    seen: Bool[np.ndarray, " frame"]  # whether a face is seen


def heads_of(seen: Observed, first: int, begin: Start, skin: SkinModel, s: FlexibleSettings) -> Heads:
    count = len(seen.features)
    out = Heads(np.zeros((count, 3), np.float32), np.zeros(count, bool))
    if not begin.face_seen:
        return out
    head = HeadFilter(skin, begin.stature, s.head_particles, np.random.default_rng(s.seed))
    head.begin(seen.features[first], begin.head, True)
    for i in range(first, count):
        f, points = seen.features[i], seen.people[i].points
        found = head(f)
        if len(points) > 50:
            height = seen.scene.floor.height(points)
            top = np.median(points[height > np.percentile(height, 97)], 0).astype(np.float32)
            if found is not None and np.linalg.norm(found - top) > _BELOW * begin.stature:
                found = None  # skin somewhere else
            if found is None:
                head.follow(f, top)
        if found is not None:
            out.place[i], out.seen[i] = found, True
    return out


class Look(NamedTuple):
    """What one camera sees in a row."""

    features: Features
    bare: UInt8[np.ndarray, "row column"]  # how likely each pixel is skin if it is the person's, 0..255
    there: bool  # False: it has no image then, this is the nearest one in time


def looks(seen: Observed, i: int, s: FlexibleSettings, skin: SkinModel) -> list[Look]:
    """What all cameras see in a row, the first one first."""
    found = [(seen.features[i], True), *(store.latest(i) for store in seen.others)]
    none = np.zeros(found[0][0].depth.shape, np.uint8)
    return [Look(f, skin.on_person(f.cell) if s.skin_weight > 0 else none, there) for f, there in found]


def chosen_points(
    seen: Observed, i: int, s: FlexibleSettings, views: Sequence[Look]
) -> tuple[Float32[np.ndarray, "point 3"], Float32[np.ndarray, " point"], Float32[np.ndarray, " point"]]:
    """The points on the person in a row that are used, metres, what each counts (0: there is none), and the same times
    how likely it is skin, by the camera that is nearest to where it was seen from."""
    person = seen.people[i]
    points, share = np.zeros((s.points, 3), np.float32), np.zeros(s.points, np.float32)
    good = np.flatnonzero(seen.scene.floor.height(person.points) > _OVER_FLOOR)
    chosen = np.random.default_rng([s.seed, i]).permutation(good)[: s.points]
    points[: len(chosen)] = person.points[chosen]
    share[: len(chosen)] = 1.0 if person.weight is None else person.weight[chosen]
    each = [at_points(look.bare, look.features, points) for look in views]
    if len(views) > 1:
        cameras = np.stack([-look.features.shift @ look.features.turn for look in views])
        apart = np.linalg.norm(person.origins[person.sensor[chosen], None] - cameras, axis=-1)
        each[0][: len(chosen)] = np.stack(each)[apart.argmin(1), np.arange(len(chosen))]
    return points, share, each[0] * share


# 7 parameters: what a chunk of frames is made of
def _inputs(
    seen: Observed, heads: Heads, at: list[int], s: FlexibleSettings, up: np.ndarray, pad: int, skin: SkinModel
) -> Inputs:
    rows = []
    for k, i in enumerate(at):
        views = looks(seen, i, s, skin)
        view, *more = (view_of(look) for look in views)
        points, share, bare = chosen_points(seen, i, s, views)
        dt = 1 / 15 if i == 0 else abs(int(seen.time_ns[seen.row[i]]) - int(seen.time_ns[seen.row[i - 1]])) / 1e9
        rows.append(Inputs(
            view._replace(more=tuple(more)), points, share, bare, heads.place[i],
            _number(float(heads.seen[i])), up, _number(min(dt, 0.2)), np.asarray(i, np.int32),
            _number(float(i < s.learn_frames)), np.asarray(k < len(at) - pad),
        ))  # fmt: skip
    return jax.tree.map(lambda *each: np.stack(each), *rows)


# 10 parameters: a pass is run from two places
def run_filters(
    model: FlexibleBody, state: State, seen: Observed, heads: Heads, order: range, key: jax.Array, s: FlexibleSettings,
    up: np.ndarray, skin: SkinModel, progress: Progress | None,
) -> tuple[State, Seen]:  # fmt: skip
    """Filters over frames in the order given."""
    out, n, shape = [], numbers(s, seen.scene.floor), shape_of(s)
    frames = list(order)
    for begin in range(0, len(frames), CHUNK):
        at = frames[begin : begin + CHUNK]
        pad = CHUNK - len(at)
        if heads.seen[at[0]] and _cosine(np.asarray(state.x)[None], camera_places(seen, at[:1]), up)[0] < _AWAY:
            state = _turned(state)
        state, found = track_chunk(
            model, state, jax.device_put(_inputs(seen, heads, at + at[-1:] * pad, s, up, pad, skin)), key, n, shape
        )
        out.append(jax.tree.map(partial(_first, len(at)), found))
        if progress is not None:
            progress(len(at))
    return state, jax.tree.map(lambda *each: np.concatenate(each), *out)


def with_the_face(
    found: Seen, face_seen: Bool[np.ndarray, " frame"], camera: Float[np.ndarray, "frame 3"],
    up: Float32[np.ndarray, "3"],
) -> Seen:  # fmt: skip
    """What a pass found, with left and right exchanged for as long as the body looks away from the camera though its
    face is seen: a body that turned past its side fits the points as well."""
    cosine = _cosine(np.asarray(found.x, float), camera, up)
    wrong = np.zeros(len(cosine), bool)
    for a, b in stretches(cosine < 0):
        wrong[a:b] = cosine[a:b].min() < _AWAY and face_seen[a:b].mean() > 0.5

    def exchanged(a: Any, order: np.ndarray) -> np.ndarray:
        a = np.array(a)
        a[wrong] = a[wrong][:, order]
        return a

    return found._replace(
        x=exchanged(found.x, OTHER_SIDE), masses=exchanged(found.masses, OTHER_SIDE),
        spread=exchanged(found.spread, _OTHER_LIMB),
        score=jax.tree.map(lambda a: exchanged(a, _OTHER_LIMB), found.score),
        support=exchanged(found.support, _OTHER_PART), off=exchanged(found.off, _OTHER_PART),
    )  # fmt: skip


def _turned(state: State) -> State:
    """With left and right exchanged."""
    limbs = {
        name: getattr(state, name)[_OTHER_LIMB] for name in ("particles", "previous", "spread", "colours", "learnt")
    }
    return state._replace(x=state.x[OTHER_SIDE], before=state.before[OTHER_SIDE], **limbs)


def camera_places(seen: Observed, at: Iterable[int]) -> Float[np.ndarray, "frame 3"]:
    """The camera's centres in some images, metres."""
    return np.array([seen.features.place(i) for i in at], float)


def _cosine(
    x: Float[np.ndarray, "frame 16 3"], camera: Float[np.ndarray, "frame 3"], up: Float32[np.ndarray, "3"]
) -> Float[np.ndarray, " frame"]:
    """Of the level angle from the body's front to the camera."""
    front, toward = directions(x, True)[:, 0], camera - x[:, NECK]
    front, toward = (v - (v @ up)[:, None] * up for v in (front, toward))
    size = np.linalg.norm(front, axis=1) * np.linalg.norm(toward, axis=1)
    return (front * toward).sum(1) / np.maximum(size, 1e-6)


def better(ahead: Seen, back: Seen, weighing: Weighing) -> Seen:
    """Of two passes, there and back in time, the body that explains more points in each stretch of time; each of its
    limbs from the pass in which it scores more."""
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
    # where both agree, the trunk among it, their mean: each trails what it comes from
    swapped = (swap[:, _LIMB_OF] & (_LIMB_OF >= 0))[..., None]
    off = np.where(swapped, body.x, other.x) - x
    apart = np.linalg.norm(off, axis=-1)
    apart = np.maximum(apart, apart[:, _TRUNK].max(1, keepdims=True))
    share = 0.5 * np.clip(2 - apart / _AGREE, 0, 1)[..., None]
    return body._replace(x=(x + share * off).astype(np.float32), spread=spread)


def smoothed(x: Float32[np.ndarray, "frame 16 3"], time_ns: np.ndarray) -> Float32[np.ndarray, "frame 16 3"]:
    """Without the particles' noise: zero-phase over so little time that fast hands keep their way."""
    if len(x) < 2:
        return x
    sigma = _SMOOTH / max(float(np.median(np.diff(time_ns))) / 1e9, 1e-3)
    return gaussian_filter1d(x, sigma, axis=0, mode="nearest")


def at_points(image: np.ndarray, f: Features, points: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, "point"]:
    """What an image says at points, 0..1; 0 outside of it."""
    q = points @ f.turn.T + f.shift
    at = np.round(q[:, :2] / np.maximum(q[:, 2:], 0.1) * f.focal[:2] + f.focal[2:]).astype(int)
    rows, columns = image.shape
    inside = (at >= 0).all(1) & (at[:, 0] < columns) & (at[:, 1] < rows) & (q[:, 2] > 0.1)
    value = image[at[:, 1].clip(0, rows - 1), at[:, 0].clip(0, columns - 1)].astype(np.float32) / 255
    return np.where(inside, value, np.float32(0))


def view_of(look: Look) -> View:
    """What a program takes of features."""
    f = look.features
    pixels = np.asarray(cv2.merge((f.colour, f.edge))).view("<u4")[..., 0]
    return View(pixels, f.motion, f.flow, f.depth, f.focal, f.turn, f.shift, look.bare, _number(float(look.there)))


def _number(value: float) -> np.ndarray:
    return np.asarray(value, np.float32)


def _first(count: int, a: jax.Array) -> np.ndarray:
    return np.asarray(a)[:count]


# 9 parameters: what a log says of itself, and what was found
def tracks_of(
    body: Body, begin: Start, seen: Observed, first: int, found: Seen, camera: np.ndarray, source: str,
    fixed_frame: str, notes: tuple[str, ...],
) -> Tracks:  # fmt: skip
    body = scaled(body, begin.stature)
    rows = seen.row[first:]
    x = np.asarray(found.x, float)
    count, limbs = seen.count, body.limb_count
    blank = lambda *shape: np.full((count, *shape), np.nan, np.float32)  # noqa: E731
    rotation, translation, joints = blank(limbs, 4), blank(limbs, 3), blank(len(body.topology.centres), 3)
    rotation[rows], translation[rows] = limb_poses(body, x)
    joints[rows] = centres_of(body, x, begin.stature, camera)
    status = np.full(count, Status.NOT_STARTED, np.int8)
    status[rows] = Status.TRACKED
    residual, explained = blank(), np.zeros(count, np.float32)
    residual[rows], explained[rows] = found.residual, found.explained
    points = np.zeros(count, np.int32)
    points[seen.row] = [len(p.points) for p in seen.people]
    return Tracks(
        source, fixed_frame, body, seen.time_ns, rotation, translation, joints, status, residual, explained,
        np.zeros(count, np.int32), points, np.ones((count, limbs), np.float32), notes=notes,
        up=seen.scene.floor.normal.astype(np.float32),
    )  # fmt: skip


def _nobody(body: Body, seen: Observed, source: str, fixed_frame: str, notes: tuple[str, ...]) -> Tracks:
    """Tracks of a recording in which nobody was found."""
    count, limbs, centres = seen.count, body.limb_count, len(body.topology.centres)
    blank = lambda *shape: np.full((count, *shape), np.nan, np.float32)  # noqa: E731
    return Tracks(
        source, fixed_frame, body, seen.time_ns, blank(limbs, 4), blank(limbs, 3), blank(centres, 3),
        np.full(count, Status.NOT_STARTED, np.int8), blank(), np.zeros(count, np.float32), np.zeros(count, np.int32),
        np.zeros(count, np.int32), np.zeros((count, limbs), np.float32), notes=(*notes, "Nobody was found."),
        up=seen.scene.floor.normal.astype(np.float32),
    )  # fmt: skip
