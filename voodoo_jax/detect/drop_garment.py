"""Removes skirts, long coats and other garments that hide the legs: at the height of thighs and knees a body is two
narrow columns, and a single wide piece there is not a limb. Host side, NumPy; looks ahead.

If it were left in, the legs would spread to fit its rim, and the trunk would follow them.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from voodoo_jax.detect.body_likelihood import LOOKED_AT, TELLING
from voodoo_jax.detect.stage import Target, WindowStage, shows_lying_person
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.point_cloud import point_spacing
from voodoo_jax.records.observation import BodyObservation, assigned


class Pieces(NamedTuple):
    """Slices of a frame: values of each point, as shares of the stature."""

    height: Float[np.ndarray, " point"]
    across: Float[np.ndarray, " point"]  # level, across the line of sight to the body
    along: Float[np.ndarray, " point"]  # level, along it
    width: Float[np.ndarray, " point"]  # across, of the piece that it belongs to in its slice
    middle: Float[np.ndarray, " point"]  # across, of that piece


@dataclass(frozen=True)
class DropGarment(WindowStage):
    """Removes a single wide piece below the hips of a person who stands or walks, if most frames show it.

    Numbers were chosen by hand, on ten recordings of people without garments (pieces at most 0.17 wide in nine of ten
    frames) and six of them in skirts and a coat (at least 0.24 in half of the frames); all lengths are shares of the
    stature.
    """

    name: ClassVar = "drop_garment"

    frames: int = 8  # of an upright person, at least, for a decision
    upright: float = 0.85  # height of the top of a standing person
    mostly: float = 0.6  # of the frames of an upright person show it
    wide: float = 0.2  # no leg is so wide, nor are both of them
    aside: float = 0.25  # of its width: its middle is so near to that of the trunk; a box beside the body is not
    ahead: float = 0.2  # likewise along the line of sight, at most: knees of a sitting person are farther
    low: float = 0.3  # from here ...
    hands: float = 0.4  # ... to here there is such a piece at most heights; hands hang above
    heights: float = 0.7  # of these heights: a chair is below a sitting person, not wide up to the hips
    hips: float = 0.55  # all is taken out up to here that is so wide
    slab: float = 0.02  # height of the slices
    link: float = 3.0  # times the distance of neighbouring points: points so near in a slice are of one piece

    def change(self, window: list[BodyObservation], target: Target) -> list[BodyObservation]:
        if shows_lying_person(window, target) or any(frame.matched for frame in window):
            return window  # between two legs matched images have points, too, as wide as the block that is matched
        return self.without(window, target.finder.scene.floor)

    def without(self, frames: list[BodyObservation], floor: Plane) -> list[BodyObservation]:
        """The frames without such a piece; the same frames if there is none."""
        seen = [k for k, f in enumerate(frames) if len(f.points) >= TELLING]
        tops = np.array([floor.top(frames[k].points) for k in seen])
        if len(seen) < self.frames:
            return frames
        stature = float(np.percentile(tops, 75))
        upright = np.array(seen)[tops > self.upright * stature]
        if stature <= 0 or len(upright) < self.frames:
            return frames
        densest = frames[max(seen, key=lambda k: len(frames[k].points))]
        spacing = point_spacing(densest.points, _origin(densest))
        looked = (self.pieces(frames[k], floor, stature, spacing) for k in upright[:: len(upright) // LOOKED_AT + 1])
        if np.mean([self.shows(some) for some in looked]) < self.mostly:
            return frames
        out = list(frames)
        for k in seen:
            some = self.pieces(frames[k], floor, stature, spacing)
            worn = (some.height < self.hips) & (some.width > self.wide)
            out[k] = frames[k].only(~worn | assigned(frames[k]))
        return out

    def shows(self, some: Pieces) -> bool:
        """Whether a frame shows a wide piece, below the trunk, at most heights between knees and hands."""
        mine, trunk = (some.height > self.low) & (some.height < self.hands), some.height > self.hips
        if not trunk.any():
            return False
        below = np.abs(some.middle - np.median(some.across[trunk])) < self.aside * some.width
        wide = mine & below & (some.width > self.wide)
        heights = np.unique((some.height[wide] / self.slab).astype(int))
        if len(heights) < self.heights * (self.hands - self.low) / self.slab:
            return False
        return bool(abs(np.median(some.along[wide]) - np.median(some.along[trunk])) < self.ahead)

    def pieces(self, frame: BodyObservation, floor: Plane, stature: float, spacing: float) -> Pieces:
        """The pieces of a frame, slice by slice; `spacing` is the angle between neighbouring points, radians."""
        sight = frame.points.astype(float).mean(0) - _origin(frame)
        side = np.cross(floor.normal, sight)
        side /= max(float(np.linalg.norm(side)), 1e-9)
        across, along = (frame.points @ axis / stature for axis in (side, np.cross(side, floor.normal)))
        height = floor.height(frame.points).astype(float) / stature
        gap = self.link * spacing * float(np.linalg.norm(sight)) / stature
        slab = np.floor(height / self.slab)
        order = np.lexsort((across, slab))
        a = across[order]
        begins = np.r_[True, (np.diff(a) > gap) | (np.diff(slab[order]) > 0)]
        first = np.flatnonzero(begins)
        last = np.r_[first[1:], len(a)] - 1
        piece = np.empty(len(a), int)
        piece[order] = np.cumsum(begins) - 1
        return Pieces(height, across, along, (a[last] - a[first])[piece], ((a[last] + a[first]) / 2)[piece])


def _origin(frame: BodyObservation) -> Float32[np.ndarray, "3"]:
    """Position of the sensor that sees most points."""
    return frame.origins[int(np.bincount(frame.sensor).argmax())]
