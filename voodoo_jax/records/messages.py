"""What a decoded message holds, in whatever format it came: clouds, images, calibrations, named features."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from sys import intern
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from voodoo_jax.records.notes import plain_name

DEPTH_ENCODINGS = {"16UC1": ("u2", 0.001), "MONO16": ("u2", 0.001), "32FC1": ("f4", 1.0)}  # pixels, metres per unit
# what topics of Features are used as: lines of sight, and markers and the like
RAYS, PAIRS = "2D features", "named points"
FARTHEST = 1e9  # larger numbers are none of metres or pixels, and overflow later


class Unusable(ValueError):
    """A message is whole, and its sender did not say what it takes to use it."""


@dataclass(frozen=True)
class Cloud:
    """A point cloud as it lies in the message: `grid` is a structured [row, column] view with x, y, z and the other
    fields of one number."""

    stamp_ns: int
    frame: str
    grid: np.ndarray
    pose: tuple[np.ndarray, np.ndarray] | None = None  # frame_T_cloud: rotation matrix, translation in metres

    def points(self, max_points: int) -> Float[np.ndarray, "point 3"]:
        """At most about `max_points` points in metres, in the cloud's own frame; invalid ones still among them."""
        return np.stack([self.field(axis, max_points) for axis in "xyz"], axis=-1).astype(np.float64)

    def field(self, name: str, max_points: int) -> np.ndarray:
        """A field [point] of the same points as `points` gives, as it lies in the message. Raises ValueError for a
        field that the cloud does not have."""
        rows, columns = self.grid.shape
        if rows > 1 and columns > 1:
            k = stride(rows, columns, max_points)
            return self.grid[name][::k, ::k].ravel()
        return self.grid[name].reshape(-1)[:: max(1, -(-self.grid.size // max_points))]

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields."""
        return self.grid.dtype.names or ()


@dataclass(frozen=True)
class Colour:
    """A colour or grey image as it lies in the message; `io.pictures.pixels` decodes it."""

    stamp_ns: int
    frame: str
    encoding: str  # of the pixels, lower case; "jpeg", "png" and so on for a compressed one
    shape: tuple[int, int]  # rows, columns; 0, 0 where only the decoder knows
    step: int  # bytes per row; 0 for a compressed one
    data: np.ndarray | bytes


@dataclass(frozen=True)
class Image:
    """A one-channel image of distances along the optical axis, or a reason why it is none."""

    stamp_ns: int
    frame: str
    encoding: str
    shape: tuple[int, int]  # rows, columns
    raw: np.ndarray | None  # [row, column] view; None if the encoding is none of depth
    unit: float  # metres per raw unit
    colour: Colour | None = None  # if it is one of colour or grey
    packed: bytes | None = None  # a compressed depth image, instead of `raw`; `io.decode.image_codec` unpacks it
    start: int = 0  # bytes before the image itself in `packed`
    calibration: "Calibration | None" = None  # if it comes with the image


@dataclass(frozen=True)
class Calibration:
    """Camera model in OpenCV's terms. K and D describe the raw image, R and P the rectified one. Pixels."""

    stamp_ns: int
    frame: str
    width: int
    height: int
    model: str
    D: Float[np.ndarray, " coefficient"]
    K: Float[np.ndarray, "3 3"]
    P: Float[np.ndarray, "3 4"]
    R: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))  # rotation, camera to rectified camera
    others: tuple["Calibration", ...] = ()  # without the region of interest, the binning, or both, if one is stated


@dataclass(frozen=True)
class Features:
    """Named features of one message: pixels of a camera's image, or 3D points.

    A name of "" stands for the last part of the topic. `suffixes` tell features of one name apart; they are part of
    the name only where a name repeats.
    """

    stamp_ns: int  # of the message, else the first of its features; 0: not said
    names: tuple[str, ...]
    suffixes: tuple[str, ...]
    frames: tuple[str, ...]  # "": not said
    stamps: Int64[np.ndarray, " feature"]  # nanoseconds; 0: not said
    values: Float[np.ndarray, "feature dim"]  # 2 pixels, or 3 metres; finite
    scores: Float[np.ndarray, " feature"]  # larger is surer


@dataclass(frozen=True)
class Named:
    """One feature on its way into `Features`."""

    name: str
    suffix: str
    frame: str
    stamp_ns: int
    value: Sequence[float] | np.ndarray
    score: float = 0.0


def features(stamp_ns: int, items: Sequence[Named], dim: int) -> Features:
    """The features of a message, those without usable numbers left out. Raises OverflowError for absurd stamps."""
    values = np.array([i.value for i in items], float).reshape(-1, dim)
    stamps = np.array([i.stamp_ns for i in items], np.int64)
    if (np.abs(stamps) >= 1 << 62).any() or abs(stamp_ns) >= 1 << 62:  # after 2116: differences would not fit
        raise OverflowError("a stamp is impossible")
    # NaN fails every comparison
    kept: list[int] = np.flatnonzero((np.abs(values) < FARTHEST).all(axis=1)).tolist()
    return Features(
        int(np.int64(stamp_ns)) or int(min(stamps[stamps != 0], default=0)),
        # The same few texts come with every message: keep one copy of each.
        tuple(intern(plain_name(items[i].name)) for i in kept),
        tuple(intern(plain_name(items[i].suffix)) for i in kept),
        tuple(intern(plain_name(items[i].frame)) for i in kept),
        stamps[kept],
        values[kept],
        np.nan_to_num(np.array([items[i].score for i in kept], float)),
    )


def moved(found: Features, by_ns: int) -> Features:
    """The same features so much later; what has no stamp keeps none."""
    stamps = np.where(found.stamps == 0, 0, found.stamps + by_ns)
    return replace(found, stamp_ns=found.stamp_ns and found.stamp_ns + by_ns, stamps=stamps)


def many(n: int) -> str:
    """A number of messages, in words."""
    return "1 message" if n == 1 else f"{n} messages"


def stride(rows: int, columns: int, most: int) -> int:
    """Smallest step in rows and columns that leaves at most `most` pixels."""
    k = max(1, int(np.sqrt(rows * columns / most)))
    while -(-rows // k) * -(-columns // k) > most and k < max(rows, columns):
        k += 1
    return k


def ros_stamp(header: Any) -> int:
    """Nanoseconds of a std_msgs/Header."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def pb_stamp(m: Any) -> int:
    """Nanoseconds of a Foxglove message's timestamp; 0 if there is none. Raises OverflowError for absurd ones."""
    t = getattr(m, "timestamp", None)  # older schemas have fewer timestamps
    return 0 if t is None else int(np.int64(t.seconds * 1_000_000_000 + t.nanos))


def frame_name(name: str) -> str:
    """Name of a coordinate frame without the leading slash of tf1, which old drivers still write."""
    return plain_name(name.lstrip("/"))


def xyz(v: Any) -> np.ndarray:
    """A vector message as an array."""
    return np.array([v.x, v.y, v.z], float)


def xyzw(q: Any) -> np.ndarray:
    """A quaternion message as an array."""
    return np.array([q.x, q.y, q.z, q.w], float)
