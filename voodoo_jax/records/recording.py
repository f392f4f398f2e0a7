"""A sensor log as the tracker sees it: frames of measurements, stamps and sensor positions. Host side, NumPy only."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from voodoo_jax.records.notes import filled

T = TypeVar("T", bound="NamedFeatures")


@dataclass(frozen=True)
class NamedFeatures:
    """Measurements of named features."""

    names: tuple[str, ...] = ()  # as the log calls them: "face", "left_hand", ...

    def only(self: T, keep: Bool[np.ndarray, " feature"]) -> T:
        """Some of them; the same object where that is all."""
        if keep.all():
            return self
        arrays = {k: v[keep] for k, v in vars(self).items() if k != "names" and v is not None}
        return replace(self, names=tuple(compress(self.names, keep)), **arrays)


@dataclass(frozen=True)
class Rays(NamedFeatures):
    """2D features (`ray` measurements of Knoop 2007, sec. 5.1): lines from a camera through a named feature."""

    origins: Float32[np.ndarray, "ray 3"] = field(default_factory=lambda: np.zeros((0, 3), np.float32))  # metres
    directions: Float32[np.ndarray, "ray 3"] = field(default_factory=lambda: np.zeros((0, 3), np.float32))  # unit
    weights: Float32[np.ndarray, " ray"] | None = None  # of the source, times the name's weight; None: all 1


@dataclass(frozen=True)
class Pairs(NamedFeatures):
    """3D measurements of named features (`point` measurements): markers, wrists of another tracker."""

    points: Float32[np.ndarray, "pair 3"] = field(default_factory=lambda: np.zeros((0, 3), np.float32))  # metres
    weights: Float32[np.ndarray, " pair"] | None = None  # of the source, times the name's weight; None: all 1


# in all frames without any: an object of its own in each would be half a kilobyte
NO_RAYS, NO_PAIRS = Rays(), Pairs()


def joined_rays(some: Sequence[Rays]) -> Rays:
    """All of them."""
    if not some:
        return NO_RAYS
    weights = [np.ones(len(r.names), np.float32) if r.weights is None else r.weights for r in some]
    return Rays(
        tuple(n for r in some for n in r.names), np.concatenate([r.origins for r in some]),
        np.concatenate([r.directions for r in some]),
        None if all(r.weights is None for r in some) else np.concatenate(weights),
    )  # fmt: skip


@dataclass(frozen=True)
class Picture:
    """A calibrated colour image, or a rectified pair, still packed: images that are not used are never decoded."""

    topic: str
    stamp_ns: int  # nanoseconds
    K: Float64[np.ndarray, "3 3"]  # of the image that `unpack` gives, which has no lens left; pixels
    T_fixed_camera: Float64[np.ndarray, "4 4"]  # metres
    unpack: Callable[[], tuple[np.ndarray, ...]]  # -> (image,) or (left, right): [row, column, 3] blue, green, red
    baseline: float = 0.0  # from the left to the right camera, metres; 0: there is one camera
    shift: float = 0.0  # pixels added to the disparity, where the principal points differ


@dataclass(frozen=True)
class Frame:
    """The measurements of all sensors at one time, in the recording's fixed frame.

    `points` are of three kinds (Knoop 2007, sec. 5.1): `free`, on the body or elsewhere; `body`, assigned to the body;
    `limb`, assigned to a limb.
    """

    time_ns: int  # stamp of the leading sensor (message header), nanoseconds
    points: Float32[np.ndarray, "point 3"]  # metres, finite
    sensor: Int32[np.ndarray, " point"]  # which row of `origins` saw the point
    origins: Float32[np.ndarray, "sensor 3"]  # where each sensor stood, metres
    rays: Rays = NO_RAYS
    pairs: Pairs = NO_PAIRS
    part: Int32[np.ndarray, " point"] | None = None  # index in `parts`, -1: free; None: all free
    parts: tuple[str, ...] = ()  # "body", or names of limbs
    weight: Float32[np.ndarray, " point"] | None = None  # None: all 1, as a depth camera's (2007, sec. 6)
    # None: all places are in the fixed frame; see detect/camera_motion.py
    T_fixed_steady: Float64[np.ndarray, "4 4"] | None = None
    pictures: tuple[Picture, ...] = ()  # where they are asked for (read.images)
    matched: bool = False  # all points were measured by matching the images of stereo pairs


@dataclass(frozen=True)
class Recording:
    """A log held in memory."""

    path: str  # of the log
    fixed_frame: str  # name of the frame of all positions
    up: Float32[np.ndarray, "3"]  # estimate of the upward direction in the fixed frame, unit vector
    sensors: tuple[str, ...]  # topic of each depth sensor, in the order of Frame.origins
    frames: tuple[Frame, ...]  # measurements of all sensors, in order of time
    features: tuple[str, ...] = ()  # topics of 2D features and named points
    notes: tuple[str, ...] = ()  # missing, damaged and unused parts of the log, one sentence each
    # origin of all coordinates of the frames, in the fixed frame, metres; 0 except for large coordinates such as UTM
    origin: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    up_is_given: bool = False  # by the setting read.up, which overrules the measurements
    sure: float = 1.0  # probability that positions are right, below 1 where a part of the calibration was assumed

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[Frame]:
        return iter(self.frames)

    def __repr__(self) -> str:
        return f"Recording({str(self).splitlines()[0]})"

    def _repr_html_(self) -> str:
        return filled("<pre>@TEXT@</pre>", TEXT=self)

    def __str__(self) -> str:
        n = len(self.frames)
        seconds = (self.frames[-1].time_ns - self.frames[0].time_ns) / 1e9 if n else 0.0
        lines = [
            f"{self.path}: {n} frames in {seconds:.2f} s, fixed frame '{self.fixed_frame}', "
            f"depth from {', '.join(self.sensors) or 'nothing'}"
        ]
        return "\n".join(lines + [f"  note: {note}" for note in self.notes])
