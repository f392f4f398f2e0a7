"""Input of the flexible tracker from a recording: features of its images, and the person's points. Host side."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import prod
from typing import IO, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

from voodoo_jax.config.options import FlexibleSettings, Settings
from voodoo_jax.detect.disk_buffer import spilled
from voodoo_jax.detect.pipeline import watched
from voodoo_jax.detect.tracklets import Tracklets
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Frame, Picture, Rays
from voodoo_jax.records.scene import Scene
from voodoo_jax.storage.scratch import nameless_file
from voodoo_jax.trackers.base import Unsuitable
from voodoo_jax.trackers.flexible.image_features import Extractor, Features, Near, SkinModel, depth_points
from voodoo_jax.trackers.flexible.physics import ANKLE
from voodoo_jax.trackers.flexible.scores import View
from voodoo_jax.trackers.shared.confidence import STATURE

_PATIENCE = 60  # frames without an image at the beginning of a log after which tracking gives up, by hand
_NOTHING = np.zeros((0, 3), np.float32)
_BESIDE, _FASTEST = 0.25, 2.5  # metres from a person's last points, and metres per second: reach of the hands, by hand


class _Kept(NamedTuple):
    """Location of a frame's features on disk."""

    begin: int  # first byte in the file
    kinds: list[tuple[np.dtype, tuple[int, ...]]]  # dtype and shape of the arrays
    place: Float64[np.ndarray, "3"]  # position of the camera, metres


class FeatureStore:
    """A camera's features on disk, ordered by time; those of a whole recording do not fit into memory."""

    def __init__(self, file: IO[bytes] | None = None, at: Sequence["_Kept | None"] = ()):
        self._file = nameless_file() if file is None else file
        self._at = list(at)

    def __len__(self) -> int:
        return len(self._at)

    def close(self) -> None:
        """Gives the disk space back."""
        self._file.close()

    def add(self, f: Features | None, place: Float64[np.ndarray, "3"] | None = None) -> None:
        """Adds the features of one more frame and the camera's position, metres; None: no image."""
        if f is None or place is None:
            self._at.append(None)
            return
        self._at.append(_Kept(self._file.seek(0, 2), [(array.dtype, array.shape) for array in f], place))
        for array in f:
            self._file.write(np.ascontiguousarray(array).data)

    def place(self, i: int) -> Float64[np.ndarray, "3"]:
        """Position of the camera, metres."""
        return self._find_entry(i).place

    def _find_entry(self, i: int) -> "_Kept":
        found = self._at[i]
        if found is None:
            raise IndexError(f"no image in row {i}")
        return found

    def has(self, i: int) -> bool:
        return self._at[i] is not None

    def latest(self, i: int) -> tuple[Features, bool]:
        """Features of the row and True, or of the nearest row with an image and False."""
        if self.has(i):
            return self[i], True
        there = [k for k in range(len(self)) if self.has(k)]
        return self[min(there, key=lambda k: abs(k - i))], False

    def forget(self) -> None:
        """Deletes all features so far, but not the camera's positions."""
        self._file.truncate(0)

    def rows(self, at: Sequence[int]) -> "FeatureStore":
        """The store of some rows alone."""
        return FeatureStore(self._file, [self._at[i] for i in at])

    def __getitem__(self, i: int) -> Features:
        found = self._find_entry(i)
        self._file.seek(found.begin)
        read = self._file.read
        return Features(*(np.frombuffer(read(t.itemsize * prod(s)), t).reshape(s) for t, s in found.kinds))


def uses_dense(s: FlexibleSettings) -> bool:
    """Whether all frames need dense depth; otherwise depth is needed while colours are learnt, and of the face."""
    return s.depth_weight > 0 or s.points_weight > 0 or s.refine > 0


@dataclass(frozen=True)
class Observed:
    """A recording as input of the filters. Rows are frames in which the first camera has an image."""

    features: FeatureStore  # of the first camera, which gives motion and the head
    others: tuple[FeatureStore, ...]  # of further cameras, which may lack images in some rows
    people: list[BodyObservation]
    scene: Scene
    time_ns: np.ndarray
    row: np.ndarray  # frame of the recording of each row

    def close(self) -> None:
        """Gives the disk space back."""
        for store in (self.features, *self.others):
            store.close()

    def from_camera(self, number: int) -> "Observed":
        """The recording with another camera as the first one."""
        stores = [self.features, *self.others]
        first = stores.pop(number)
        rows = [i for i in range(len(first)) if first.has(i)]
        return replace(
            self, features=first.rows(rows), others=tuple(s.rows(rows) for s in stores),
            people=[self.people[i] for i in rows], row=self.row[rows],
        )  # fmt: skip

    def since(self, first: int) -> "Observed":
        """The recording from row `first` on, with the first camera alone."""
        at = int(self.row[first])
        return replace(
            self, features=self.features.rows(range(first, len(self.row))), others=(), people=self.people[first:],
            time_ns=self.time_ns[at:], row=self.row[first:] - at,
        )  # fmt: skip


def _keep_left(picture: Picture) -> Picture:
    """The left image of a pair alone."""
    return replace(picture, unpack=lambda: picture.unpack()[:1], baseline=0.0) if picture.baseline > 0 else picture


class Watching:
    """Passes frames on to the detection of people, and stores the features of the images of all cameras.

    **Arguments:** `source` path of the log; `given` another tracker uses the same frames, so their points stay as they
    are and give the depth of pixels; otherwise points of stereo pairs are added.
    """

    def __init__(self, settings: Settings, source: str, given: bool = False):
        self._settings, self._source, self._given = settings.flexible, source, given
        self.near: Callable[[int], Near | None] = lambda time_ns: None  # region that needs depth at a time
        self._times: list[int] = []
        self.rows: list[int] = []  # numbers of the frames with an image
        self._extract, self._stores = dict[str, Extractor](), dict[str, FeatureStore]()
        self._origins: dict[str, np.ndarray] = {}

    def __call__(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The frames; those without an image are left out, unless points are given. Raises Unsuitable, and ValueError
        for broken images."""
        for number, frame in enumerate(frames):
            self._times.append(frame.time_ns)
            if frame.pictures:
                seen = self._store_features(frame, self.near(frame.time_ns))
                self.rows.append(number)
                yield seen
            elif number >= _PATIENCE and not self.rows:
                raise self._explain_missing_images()
            elif self._given:
                yield frame

    def watched(
        self, frames: Iterable[Frame], up: Float32[np.ndarray, "3"], body: Body, settings: Settings, up_is_given: bool
    ) -> tuple[Tracklets, Iterator[BodyObservation]]:
        """The person in each frame, and the tracklets behind it: see `detect.pipeline.watched`."""
        tracklets, found = watched(self(frames), up, body, settings, up_is_given)
        self.near = partial(near, tracklets)
        return tracklets, found

    def _store_features(self, frame: Frame, near: Near | None) -> Frame:
        """The frame with the points of its stereo pairs; stores its features."""
        s, found, shown = self._settings, dict[str, tuple[Features, bool]](), len(self.rows)
        given = self._given and len(frame.points) > 0
        for picture in sorted(frame.pictures, key=lambda picture: picture.topic):
            picture = _keep_left(picture) if given else picture
            dense = given or uses_dense(s) or shown < s.learn_frames
            extract = self._extract.setdefault(picture.topic, Extractor())
            found[picture.topic] = extract(frame, picture, dense, near), picture.baseline > 0
            if picture.topic not in self._stores:
                self._stores[picture.topic] = FeatureStore(at=[None] * shown)
        places = {picture.topic: picture.T_fixed_camera[:3, 3] for picture in frame.pictures}
        for topic, store in self._stores.items():
            store.add(found[topic][0] if topic in found else None, places.get(topic))
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
        return replace(frame, points=np.concatenate(clouds), sensor=sensor, origins=origins, matched=True)

    def observed(self, people: list[BodyObservation], scene: Scene) -> Observed:
        """The recording, once all frames are read; `people` of the frames with an image. Raises Unsuitable."""
        if not self.rows:
            raise self._explain_missing_images()
        first, *others = self._stores.values()
        row, times = np.array(self.rows[: len(people)], int), np.array(self._times, np.int64)
        whole = Observed(first, tuple(others), people, scene, times, row)
        return whole if all(first.has(i) for i in range(len(first))) else whole.from_camera(0)

    def shows(self, row: int, time_ns: int) -> bool:
        """Whether a row is that of the frame at a time."""
        return row < len(self.rows) and self._times[self.rows[row]] == time_ns

    def forget(self, rows: int) -> None:
        """Deletes the features so far, if there are exactly `rows` rows."""
        for store in self._stores.values():
            if rows == len(store):
                store.forget()

    def close(self) -> None:
        """Gives the disk space back."""
        for store in self._stores.values():
            store.close()

    def _explain_missing_images(self) -> Unsuitable:
        return Unsuitable(
            f"'{self._source}' has no images for the flexible tracker (it needs a calibrated stereo pair, or a "
            "colour camera beside a depth camera; in Python read it with the settings of "
            f"vj.preset('{'both' if self._given else 'flexible'}')): use --tracker icp"
        )


# 6 parameters: those of the detection of people, and the log's name
def observe(
    frames: Iterable[Frame], up: Float32[np.ndarray, "3"], body: Body, settings: Settings, source: str,
    up_is_given: bool = False,
) -> Observed:  # fmt: skip
    """Reads the frames' features and finds the person's points. Raises Unsuitable."""
    watching = Watching(settings, source)
    try:
        tracklets, found = watching.watched(frames, up, body, settings, up_is_given)
        people = spilled(found)
        return watching.observed(people, tracklets.finder.scene)  # now: the floor may be found with the body
    except BaseException:
        watching.close()
        raise


def near(tracklets: Tracklets, time_ns: int) -> Near | None:
    """The region that needs depth in a frame of that time; None: everywhere."""
    points = tracklets.near_only(time_ns)
    seconds = (time_ns - tracklets.finder.last_ns) / 1e9
    return None if points is None else Near(points, _BESIDE + _FASTEST * max(seconds, 0.0))


class Look(NamedTuple):
    """The image of one camera in a row."""

    features: Features
    bare: UInt8[np.ndarray, "row column"]  # probability that each pixel is skin if it belongs to the person, 0..255
    there: bool  # False: no image in this row; these are the nearest features in time


def looks(seen: Observed, i: int, s: FlexibleSettings, skin: SkinModel) -> list[Look]:
    """The images of all cameras in a row, the first camera first."""
    found = [(seen.features[i], True), *(store.latest(i) for store in seen.others)]
    none = np.zeros(found[0][0].depth.shape, np.uint8)
    return [Look(f, skin.on_person(f.cell) if s.skin_weight > 0 else none, there) for f, there in found]


def chosen_points(
    seen: Observed, i: int, s: FlexibleSettings, views: Sequence[Look]
) -> tuple[Float32[np.ndarray, "point 3"], Float32[np.ndarray, " point"], Float32[np.ndarray, " point"]]:
    """The points on the person used in a row, metres, their weights (0: padding), and these times the probability of
    skin, from the camera nearest to the sensor of each point."""
    person = seen.people[i]
    points, share = np.zeros((s.points, 3), np.float32), np.zeros(s.points, np.float32)
    # by stereo, lower points belong to the floor as often as to the feet
    good = np.flatnonzero(seen.scene.floor.height(person.points) > ANKLE * STATURE)
    chosen = np.random.default_rng([s.seed, i]).permutation(good)[: s.points]
    points[: len(chosen)] = person.points[chosen]
    share[: len(chosen)] = 1.0 if person.weight is None else person.weight[chosen]
    each = [at_points(look.bare, look.features, points) for look in views]
    if len(views) > 1:
        cameras = np.stack([-look.features.shift @ look.features.turn for look in views])
        apart = np.linalg.norm(person.origins[person.sensor[chosen], None] - cameras, axis=-1)
        each[0][: len(chosen)] = np.stack(each)[apart.argmin(1), np.arange(len(chosen))]
    return points, share, each[0] * share


def at_points(image: np.ndarray, f: Features, points: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, "point"]:
    """Values of an image at points, 0..1; 0 outside of it."""
    q = points @ f.turn.T + f.shift
    at = np.round(q[:, :2] / np.maximum(q[:, 2:], 0.1) * f.focal[:2] + f.focal[2:]).astype(int)
    rows, columns = image.shape
    inside = (at >= 0).all(1) & (at[:, 0] < columns) & (at[:, 1] < rows) & (q[:, 2] > 0.1)
    value = image[at[:, 1].clip(0, rows - 1), at[:, 0].clip(0, columns - 1)].astype(np.float32) / 255
    return np.where(inside, value, np.float32(0))


def view_of(look: Look) -> View:
    """The features that a program uses."""
    f = look.features
    pixels = np.asarray(cv2.merge((f.colour, f.edge))).view("<u4")[..., 0]
    return View(pixels, f.motion, f.depth, f.focal, f.turn, f.shift, look.bare, np.float32(float(look.there)))
