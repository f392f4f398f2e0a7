"""Two passes over the same frames, forwards and backwards in time, made one. Host side.

A limb that one pass loses in a fast movement the other one meets before the trouble; and where both agree, their mean
is nearer to the truth than either, for each lags behind in its own direction of time.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rotations import axis_of, half_turn, limb_ends, rotations
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.segment import Pass, backwards, pass_of
from voodoo_jax.trackers.shared.segment import Followed


class Combined(NamedTuple):
    """One pass made of two."""

    rotation: Float32[np.ndarray, "frame limb 4"]
    translation: Float32[np.ndarray, "frame limb 3"]
    apart: Float32[np.ndarray, "frame limb"]  # metres between the passes' places of a limb's ends, the larger one


@dataclass(frozen=True)
class ForwardBackward:
    """A pass back from a segment's last good frame, made one with the pass forwards. Numbers were chosen by hand."""

    name: ClassVar = "forward_backward"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body"})

    agree: float = 0.12  # metres between the passes' places of a limb's ends, below which they are averaged
    window: int = 7  # frames over which costs are compared: single frames decide by noise
    better: float = 0.97  # the backward pass is taken where it costs less than this share of the forward one

    def __call__(self, run: Runner, segment: Followed) -> Followed:
        good = np.flatnonzero(segment.tracked)
        if not len(good):
            return segment
        count = int(good[-1]) + 1
        forth = segment[:count]
        back = backwards(run, forth.pose_at(-1), forth.first, forth.end)
        passes = pass_of(run, forth), pass_of(run, back)
        taken = self.is_better(passes[1].cost, passes[0].cost)
        both = combined(*passes, taken, np.asarray(run.body.sizes)[:, 4], self.agree)
        found = forth.picked(back, taken)
        found = replace(found, rotation=both.rotation, translation=both.translation, passes_apart=both.apart)
        return found.joined(segment[count:])

    def is_better(
        self, other: Float[np.ndarray, " frame"], cost: Float[np.ndarray, " frame"]
    ) -> Bool[np.ndarray, " frame"]:
        """In which frames the other pass explains the measurements better, by the mean cost around the frame."""
        if not len(cost):
            return np.zeros(0, bool)
        return self.smoothed(other) < self.better * self.smoothed(cost)

    def smoothed(self, cost: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " frame"]:
        """Mean over `window` frames around each, or fewer if there are not so many."""
        width = min(self.window, len(cost) - 1 + len(cost) % 2)  # odd, and not longer than the recording
        return np.convolve(np.pad(cost, width // 2, mode="edge"), np.ones(width) / width, "valid")


def combined(
    forward: Pass,
    backward: Pass,
    taken: Bool[np.ndarray, " frame"],
    lengths: Float[np.ndarray, " limb"],
    agree: float = ForwardBackward.agree,
) -> Combined:
    """Poses from both passes: in each frame those of the better one; limbs on which both agree are moved halfway to the
    other.

    Halfway concerns the position of the limb's origin and the direction of its axis. The rotation about its axis is
    kept, since it is unknown for a round limb.

    **Arguments:** `taken` where the backward pass is the better one; `lengths` of the limbs, metres; `agree` see
    ForwardBackward.
    """
    pick = lambda a, b: np.where(taken[:, None, None], a, b)  # noqa: E731
    rotation, other_rotation = pick(backward.rotation, forward.rotation), pick(forward.rotation, backward.rotation)
    place, other = pick(backward.translation, forward.translation), pick(forward.translation, backward.translation)
    axis, other_axis = axis_of(rotation), axis_of(other_rotation)
    ends = limb_ends(rotation, place, lengths) - limb_ends(other_rotation, other, lengths)
    apart = np.max(np.linalg.norm(ends, axis=-1), 0)
    close = apart < agree  # NaN does not agree
    half = half_turn(axis, other_axis)
    turned = (Rotation.from_quat(half.reshape(-1, 4)) * rotations(rotation)).as_quat(scalar_first=True)
    turned = turned.reshape(rotation.shape)
    rotation = np.where(close[..., None], turned, rotation).astype(np.float32)
    translation = np.where(close[..., None], (place + other) / 2, place).astype(np.float32)
    return Combined(rotation, translation, apart.astype(np.float32))
