"""Consecutive frames that were tracked as one, from one start of the tracker to the next. Host side, NumPy."""

from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int8, Int32

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.records.tracks import Status

Kind = TypeVar("Kind", bound="Segment")  # a tracker may add to a segment what it alone knows


@dataclass(frozen=True)
class Segment:
    """Consecutive tracked frames. Leading axis of all arrays: frame; NaN where there is none.

    Slices share the arrays with the segment that they are of; `put` alone writes into them.
    """

    first: int  # its first frame in the recording
    status: Int8[np.ndarray, " frame"]  # values of Status
    rotation: Float[np.ndarray, "frame limb 4"]  # T_fixed_limb, unit quaternion wxyz
    translation: Float[np.ndarray, "frame limb 3"]  # metres
    cost: Float[np.ndarray, " frame"]  # how badly measurements are explained, square metres; see solve.scan.cost_of
    passes_apart: Float[np.ndarray, "frame limb"]  # metres between forward and backward pass; NaN of one pass
    residual: Float[np.ndarray, " frame"]  # root mean square distance of the used points, metres
    explained: Float[np.ndarray, " frame"]  # share of the body's points that the model explains, 0..1
    steps: Int32[np.ndarray, " frame"]  # ICP steps taken
    limb_weight: Float[np.ndarray, "frame limb"]  # measured weight per limb
    limb_covariance: Float[np.ndarray, "frame limb 6 6"]  # turn (rad), shift (m) in the limb's frame
    # logarithm of the odds that the body does not face the other way; NaN: nobody has asked
    facing_odds: Float[np.ndarray, " frame"]

    @classmethod
    def blank(cls: type[Kind], count: int, limbs: int) -> Kind:
        """`count` frames from the recording's first one on in which nothing is tracked yet."""
        nothing = lambda *shape: np.full((count, *shape), np.nan, np.float32)  # noqa: E731
        return cls(
            first=0, status=np.full(count, Status.NOT_STARTED, np.int8), rotation=nothing(limbs, 4),
            translation=nothing(limbs, 3), cost=np.zeros(count), passes_apart=nothing(limbs), residual=nothing(),
            explained=np.zeros(count, np.float32), steps=np.zeros(count, np.int32),
            limb_weight=np.zeros((count, limbs), np.float32), limb_covariance=nothing(limbs, 6, 6),
            facing_odds=nothing(),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.status)

    def __bool__(self) -> bool:
        return True  # as other records, whatever its length

    @property
    def end(self) -> int:
        """The frame of the recording after its last one."""
        return self.first + len(self)

    @property
    def tracked(self) -> Bool[np.ndarray, " frame"]:
        """In which frames the body explains the points."""
        return self.status == Status.TRACKED

    @property
    def poses(self) -> Poses:
        """T_fixed_limb [frame, limb]."""
        return Poses(self.rotation, self.translation)

    def pose_at(self, at: int) -> Poses:
        """The pose in one of the frames, counted from the segment's first one."""
        return Poses(self.rotation[at], self.translation[at])

    def __getitem__(self: Kind, frames: slice) -> Kind:
        """Some successive frames, counted from the segment's first one."""
        begin, _, step = frames.indices(len(self))
        assert step == 1
        arrays = {name: array[frames] for name, array in self._arrays().items()}
        return replace(self, first=self.first + begin, **arrays)

    def spliced(self: Kind, begin: int, other: "Segment", taken: Bool[np.ndarray, " frame"]) -> Kind:
        """A copy with those frames of another segment that are taken; the other one begins in frame `begin`, counted
        from this one's first."""
        at, theirs = begin + np.flatnonzero(taken), other._arrays()
        found = {name: np.array(array) for name, array in self._arrays().items()}
        for name, array in found.items():
            array[at] = theirs[name][taken]
        return replace(self, **found)

    def joined(self: Kind, later: "Segment") -> Kind:
        """This segment and the frames that follow it, in another one."""
        theirs = later._arrays()
        return replace(self, **{name: np.concatenate([a, theirs[name]]) for name, a in self._arrays().items()})

    def picked(self: Kind, other: "Segment", taken: Bool[np.ndarray, " frame"]) -> Kind:
        """A copy with the frames that are taken from another segment of the same frames."""
        theirs = other._arrays()
        pick = lambda old, new: np.where(taken.reshape(-1, *[1] * (old.ndim - 1)), new, old)  # noqa: E731
        return replace(self, **{name: pick(array, theirs[name]) for name, array in self._arrays().items()})

    def put(self, other: "Segment") -> None:
        """Writes another segment into this one, which holds its frames."""
        span, theirs = slice(other.first - self.first, other.end - self.first), other._arrays()
        for name, array in self._arrays().items():
            array[span] = theirs[name]

    def _arrays(self) -> dict[str, np.ndarray]:
        return {f.name: getattr(self, f.name) for f in fields(Segment) if f.name != "first"}
