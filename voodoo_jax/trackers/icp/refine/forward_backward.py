"""Two passes over the same frames, forwards and backwards in time, made one. Host side.

A limb that one pass loses in a fast movement the other one meets before the trouble; and where both agree, their mean
is nearer to the truth than either, for each lags behind in its own direction of time.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rotations import _axis, _half_turn, limb_ends, rotations
from voodoo_jax.records.segment import Segment
from voodoo_jax.trackers.icp.initialise import fresh
from voodoo_jax.trackers.icp.runner import Session
from voodoo_jax.trackers.icp.segment import Pass, backwards, pass_of

AGREE = 0.12  # metres between the passes' places of a limb's ends, below which they are averaged
WINDOW = 7  # frames over which costs are compared: single frames decide by noise
BETTER = 0.97  # the backward pass is taken where it costs less than this share of the forward one


class Combined(NamedTuple):
    """One pass made of two."""

    rotation: Float32[np.ndarray, "frame limb 4"]
    translation: Float32[np.ndarray, "frame limb 3"]
    backward: Bool[np.ndarray, " frame"]  # where the backward pass was the better one
    apart: Float32[np.ndarray, "frame limb"]  # metres between the passes' places of a limb's ends, the larger one


def backward_is_better(
    forward: Float[np.ndarray, " frame"], backward: Float[np.ndarray, " frame"]
) -> Bool[np.ndarray, " frame"]:
    """In which frames the backward pass explains the measurements better, by the mean cost around the frame."""
    if not len(forward):
        return np.zeros(0, bool)
    return smoothed(backward) < BETTER * smoothed(forward)


def smoothed(cost: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " frame"]:
    """Mean over WINDOW frames around each, or fewer if there are not so many."""
    width = min(WINDOW, len(cost) - 1 + len(cost) % 2)  # odd, and not longer than the recording
    return np.convolve(np.pad(cost, width // 2, mode="edge"), np.ones(width) / width, "valid")


def combined(forward: Pass, backward: Pass, lengths: Float[np.ndarray, " limb"]) -> Combined:
    """Poses made of both passes: of each frame the better one, limbs on which they agree moved halfway to the other.

    Halfway: the place of the limb's origin, and the direction of its axis; how it is turned about its axis is left as
    it is, for of a round limb nobody knows that.

    **Arguments:** `lengths` of the limbs, metres.
    """
    taken = backward_is_better(forward.cost, backward.cost)
    pick = lambda a, b: np.where(taken[:, None, None], a, b)  # noqa: E731
    rotation, other_rotation = pick(backward.rotation, forward.rotation), pick(forward.rotation, backward.rotation)
    place, other = pick(backward.translation, forward.translation), pick(forward.translation, backward.translation)
    axis, other_axis = _axis(rotation), _axis(other_rotation)
    ends = limb_ends(rotation, place, lengths) - limb_ends(other_rotation, other, lengths)
    apart = np.max(np.linalg.norm(ends, axis=-1), 0)
    agree = apart < AGREE  # NaN does not agree
    half = _half_turn(axis, other_axis)
    turned = (Rotation.from_quat(half.reshape(-1, 4)) * rotations(rotation)).as_quat(scalar_first=True)
    turned = turned.reshape(rotation.shape)
    rotation = np.where(agree[..., None], turned, rotation).astype(np.float32)
    translation = np.where(agree[..., None], (place + other) / 2, place).astype(np.float32)
    return Combined(rotation, translation, taken, apart.astype(np.float32))


def there_and_back(run: Session, forward: Segment) -> Segment:
    """A segment that was tracked forwards, made one with a pass back from its last good frame."""
    good = np.flatnonzero(forward.tracked)
    if not len(good):
        return forward
    count = int(good[-1]) + 1
    forth = forward[:count]
    poses = fresh(run, forth.first, forth.cost, forth.rotation)
    if poses is None:
        poses = forth.pose_at(-1)
    back = backwards(run, poses, forth.first, forth.end)
    both = combined(pass_of(run, forth), pass_of(run, back), np.asarray(run.body.sizes)[:, 4])
    found = forth.picked(back, both.backward)
    found = replace(found, rotation=both.rotation, translation=both.translation, passes_apart=both.apart)
    return found.joined(forward[count:])
