"""Tracks segments again from other poses, and computes their costs. Host side."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Float32

from voodoo_jax.compile.executable import program
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.kernels.joint_limits import check
from voodoo_jax.model.body import Body
from voodoo_jax.model.joint_bend import wrong_bend
from voodoo_jax.records.segment import Segment
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.shared.segment import Followed, segment_of


class Pass(NamedTuple):
    """Poses of consecutive frames, and their costs."""

    rotation: Float32[np.ndarray, "frame limb 4"]  # unit quaternions wxyz
    translation: Float32[np.ndarray, "frame limb 3"]  # metres
    cost: Float[np.ndarray, " frame"]  # square metres, see kernels


FREE_BEND = 0.17  # radians beyond a joint's limits that say nothing: people differ
WRONG_WAY = 0.1  # radians beyond, mean of all joints and frames, that count as much as costs e times higher


def forwards(run: Runner, poses: Poses, first: int, end: int) -> Followed:
    """Frames `first` to `end` - 1 of the recording, tracked from `poses` in the first of them."""
    return segment_of(run, run.forwards(poses, first, end)[1], first, end - first)


def backwards(run: Runner, poses: Poses, first: int, end: int) -> Followed:
    """Frames `first` to `end` - 1 of the recording, tracked back in time from `poses` in the last of them."""
    return segment_of(run, run.backwards(poses, first, end), first, end - first)


def tracked_anew(run: Runner, poses: Poses, first: int, at: int, end: int) -> Followed:
    """Frames `first` to `end` - 1 of the recording, tracked both ways from `poses` in frame `at`."""
    return backwards(run, poses, first, at + 1)[:-1].joined(forwards(run, poses, at, end))


# metres in another limb that say nothing (frusta are no flesh), and metres farther in, sum over pairs of limbs, that
# count as much as costs e times higher; measured: the best of five choices on the 18 recordings and the six of people.
# At 0.03 and 0.05 a deep bow is taken apart.
FREE_DEPTH, IN_ANOTHER = 0.04, 0.2


def pass_of(run: Runner, segment: Segment) -> Pass:
    """Poses of some frames, and their costs, which are higher for implausible poses."""
    odds = implausible(run.body, segment.rotation, segment.translation, run.settings.track.chunk)
    return Pass(segment.rotation, segment.translation, segment.cost * odds)


def implausible(
    body: Body,
    rotation: Float32[np.ndarray, "frame limb 4"],
    translation: Float32[np.ndarray, "frame limb 3"],
    chunk: int,
) -> Float[np.ndarray, " frame"]:
    """Factor on the cost of poses, at least 1, for joints bent the wrong way and limbs inside others: points pull an
    invisible limb into a visible one, and it explains them as well.

    **Arguments:** `chunk` number of frames per call.
    """
    depth = np.concatenate([np.zeros((0, rotation.shape[1])), *_depths(body, rotation, translation, chunk)])
    deep = np.sum(np.maximum(np.nan_to_num(depth) - FREE_DEPTH, 0.0), 1) / 2
    return np.exp(bent(body, rotation) / WRONG_WAY + deep / IN_ANOTHER)


def _depths(body: Body, rotation: np.ndarray, translation: np.ndarray, chunk: int) -> list[np.ndarray]:
    """Depths of limbs inside others, `chunk` frames at a time."""
    found = []
    for at in range(0, len(rotation), chunk):
        some = rotation[at : at + chunk], translation[at : at + chunk]
        pad = ((0, chunk - len(some[0])), (0, 0), (0, 0))
        found.append(np.asarray(depths(body, Poses(*(np.pad(each, pad) for each in some))))[: len(some[0])])
    return found


@program
def depths(body: Body, poses: Poses) -> Float[Array, "frame limb"]:
    """Depth of limbs inside others, beyond that of the rest pose, metres."""
    return jax.vmap(lambda some: check(body, some).depth)(poses)


def bent(body: Body, rotation: Float32[np.ndarray, "frame limb 4"]) -> Float[np.ndarray, " frame"]:
    """Angle by which joints are bent the wrong way, mean over the joints, radians."""
    return np.mean(np.maximum(wrong_bend(body, rotation) - FREE_BEND, 0.0), 1)
