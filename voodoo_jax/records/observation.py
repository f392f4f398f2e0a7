"""The points of one frame that are taken to be on the body. Host side, NumPy."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, Int32

from voodoo_jax.geometry.point_cloud import picked
from voodoo_jax.records.recording import NO_PAIRS, NO_RAYS, Frame, Pairs, Rays


@dataclass(frozen=True)
class BodyObservation:
    """The points of one frame that seem to be on the body."""

    time_ns: int
    points: Float32[np.ndarray, "point 3"]  # fixed frame, metres
    sensor: Int[np.ndarray, " point"]
    origins: Float32[np.ndarray, "sensor 3"]
    rays: Rays = NO_RAYS
    pairs: Pairs = NO_PAIRS
    part: Int32[np.ndarray, " point"] | None = None  # as in Frame
    parts: tuple[str, ...] = ()
    weight: Float32[np.ndarray, " point"] | None = None
    noise: float = (
        0.0  # standard deviation of the points' distances, metres; 0: not known (see detect/weigh_by_noise.py)
    )
    doubt: float = (
        1.0  # how much less the points weigh because of it: sum of the weights that they would have, over theirs
    )
    T_fixed_steady: Float64[np.ndarray, "4 4"] | None = None  # as in Frame
    # some points of whatever is nearer to a sensor than the body and may hide it, and which sensor; None: nothing is
    before: Float32[np.ndarray, "some 3"] | None = None
    before_sensor: Int[np.ndarray, " some"] | None = None
    matched: bool = False  # as in Frame
    other: bool = False  # from here on something else is taken for the body than in the frames before

    def only(self, keep: np.ndarray) -> "BodyObservation":
        """The frame with some of its points: a mask or indices."""
        keep = np.flatnonzero(keep) if keep.dtype == bool else keep
        part = None if self.part is None else self.part[keep]
        weight = None if self.weight is None else self.weight[keep]
        other = copy(self)  # dataclasses.replace takes as long as all else here
        vars(other).update(points=picked(self.points, keep), sensor=self.sensor[keep], part=part, weight=weight)
        return other


def joined(frames: Sequence[BodyObservation]) -> BodyObservation:
    """The first frame with the points of the others, which are of the same time and sensors."""
    first = frames[0]
    sizes = [len(f.points) for f in frames]
    part, weight = None, None
    if any(f.part is not None for f in frames):
        part = np.concatenate([np.full(n, -1, np.int32) if f.part is None else f.part for f, n in zip(frames, sizes)])
    if any(f.weight is not None for f in frames):
        weight = np.concatenate(
            [np.ones(n, np.float32) if f.weight is None else f.weight for f, n in zip(frames, sizes)]
        )
    points, sensor = (np.concatenate([getattr(f, name) for f in frames]) for name in ("points", "sensor"))
    return replace(first, points=points, sensor=sensor, part=part, weight=weight)


Seen = TypeVar("Seen", Frame, BodyObservation)


def whole(frame: Frame | BodyObservation) -> BodyObservation:
    """A frame with all its points."""
    if isinstance(frame, BodyObservation):
        return frame
    return BodyObservation(
        frame.time_ns, frame.points, frame.sensor, frame.origins, frame.rays, frame.pairs, frame.part, frame.parts,
        frame.weight, T_fixed_steady=frame.T_fixed_steady, matched=frame.matched,
    )  # fmt: skip


def with_places(
    frame: Seen, place: Callable[[np.ndarray], np.ndarray], direction: Callable[[np.ndarray], np.ndarray] = lambda v: v
) -> Seen:
    """The frame with all that is in it elsewhere: `place` moves points, `direction` turns lines of sight."""
    rays = replace(frame.rays, origins=place(frame.rays.origins), directions=direction(frame.rays.directions))
    pairs = replace(frame.pairs, points=place(frame.pairs.points))
    moved = replace(frame, points=place(frame.points), origins=place(frame.origins), rays=rays, pairs=pairs)
    if isinstance(moved, BodyObservation) and moved.before is not None:
        moved = replace(moved, before=place(moved.before))
    return moved


def that_differ(frames: Sequence[BodyObservation], least: int) -> list[int]:
    """Which frames with at least that many points are not copies of the previous one: a sensor never measures the same
    noise twice, and copies are useless for detecting motion."""
    there = [k for k, f in enumerate(frames) if len(f.points) >= least]
    same = (np.array_equal(frames[a].points, frames[b].points) for a, b in pairwise(there))
    return there[:1] + [k for k, copied in zip(there[1:], same) if not copied]


def assigned(frame: Frame | BodyObservation) -> Bool[np.ndarray, " point"]:
    """Which points a segmentation has assigned to the body, or to one of its limbs."""
    return np.zeros(len(frame.points), bool) if frame.part is None else frame.part >= 0
