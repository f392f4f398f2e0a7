"""Segments from the steps of the compiled program. Host side."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Int8

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Status
from voodoo_jax.solve.scan import State, Step, cost_of
from voodoo_jax.trackers.shared.runner import FEW_POINTS, FrameRunner


@runtime_checkable
class Start(Protocol):
    """The start of a segment."""

    @property
    def frame(self) -> int: ...

    @property
    def poses(self) -> Poses: ...

    @property
    def unexplained(self) -> float: ...  # what it costs beyond what noise would, square metres


@dataclass(frozen=True)
class Followed(Segment):
    """A segment, and the tracker's data about it."""

    start: Start | None = None  # that it was tracked from
    state: State | None = None  # after its last frame, where another start took the place of its own


def segment_of(run: FrameRunner, step: Step, first: int, count: int) -> Followed:
    """The steps of `count` frames from `first` on, as a segment of one pass."""
    span = slice(first, first + count)
    weight = np.asarray(step.limb_weight)[:count]
    return Followed(
        first=first,
        status=status_of(step, run.settings.track.lost_explained, run.named[span], run.featured[span])[:count],
        rotation=np.asarray(step.poses.rotation)[:count],
        translation=np.asarray(step.poses.translation)[:count],
        cost=np.asarray(cost_of(step))[:count],
        passes_apart=np.full_like(weight, np.nan),
        residual=np.asarray(step.residual)[:count],
        explained=np.asarray(step.explained)[:count],
        steps=np.asarray(step.steps)[:count],
        limb_weight=weight,
        limb_covariance=np.asarray(step.covariance)[:count],
        facing_odds=np.full(count, np.nan, np.float32),
    )


def status_of(
    step: Step, lost_explained: float, named: Bool[np.ndarray, " frame"], featured: Bool[np.ndarray, " frame"]
) -> Int8[np.ndarray, " frame"]:
    """Status of each frame; `named` those with named points alone, `featured` those with some feature."""
    few = (np.asarray(step.points)[: len(named)] < FEW_POINTS) & ~named
    lost = np.asarray(step.explained)[: len(named)] < lost_explained
    status = np.where(lost, Status.LOST, Status.TRACKED)
    return np.where(few, np.where(featured, Status.FEATURES, Status.NO_DATA), status).astype(np.int8)
