"""Segments from the steps of the compiled program, tracked anew from other poses, and what they cost. Host side."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.joint_bend import wrong_bend
from voodoo_jax.records.segment import Segment
from voodoo_jax.solve.scan import State, Step, cost_of
from voodoo_jax.trackers.icp.runner import Runner, status_of
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis


@dataclass(frozen=True)
class Followed(Segment):
    """A segment, and what this tracker knows of it."""

    start: StartHypothesis | None = None  # that it was tracked from
    state: State | None = None  # after its last frame, where another start took the place of its own


class Pass(NamedTuple):
    """Poses of consecutive frames, and how badly they explain what was measured."""

    rotation: Float32[np.ndarray, "frame limb 4"]  # unit quaternions wxyz
    translation: Float32[np.ndarray, "frame limb 3"]  # metres
    cost: Float[np.ndarray, " frame"]  # square metres, see kernels


FREE_BEND = 0.17  # radians beyond a joint's limits that say nothing: people differ
WRONG_WAY = 0.1  # radians beyond, mean of all joints and frames, that count as much as costs e times higher


def segment_of(run: Runner, step: Step, first: int, count: int) -> Followed:
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


def forwards(run: Runner, poses: Poses, first: int, end: int) -> Followed:
    """Frames `first` to `end` - 1 of the recording, tracked from `poses` in the first of them."""
    return segment_of(run, run.forwards(poses, first, end)[1], first, end - first)


def backwards(run: Runner, poses: Poses, first: int, end: int) -> Followed:
    """Frames `first` to `end` - 1 of the recording, tracked back in time from `poses` in the last of them."""
    return segment_of(run, run.backwards(poses, first, end), first, end - first)


def tracked_anew(run: Runner, poses: Poses, first: int, at: int, end: int) -> Followed:
    """Frames `first` to `end` - 1 of the recording, tracked both ways from `poses` in frame `at`."""
    return backwards(run, poses, first, at + 1)[:-1].joined(forwards(run, poses, at, end))


def pass_of(run: Runner, segment: Segment) -> Pass:
    """Poses of some frames, and what they cost; joints bent the wrong way cost more."""
    return Pass(segment.rotation, segment.translation, segment.cost * np.exp(bent(run, segment) / WRONG_WAY))


def bent(run: Runner, segment: Segment) -> Float[np.ndarray, " frame"]:
    """How far joints are bent the wrong way, mean over the joints, radians."""
    return np.mean(np.maximum(wrong_bend(run.body, segment.rotation) - FREE_BEND, 0.0), 1)
