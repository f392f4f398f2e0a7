"""Furniture that the body touches all the time and that is not flat: points at rest that the body never explains where
it is well tracked. Host side, NumPy; looks ahead."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from voodoo_jax.detect.stage import WINDOW
from voodoo_jax.detect.stillness import resting
from voodoo_jax.geometry.rotations import rotations
from voodoo_jax.model.body import Body
from voodoo_jax.records.notes import remark
from voodoo_jax.records.observation import BodyObservation, assigned
from voodoo_jax.records.segment import Segment
from voodoo_jax.trackers.shared.confidence import EXPLAINED
from voodoo_jax.trackers.shared.runner import spans

FURNITURE_NOTE = remark("Things at rest that touch the body are furniture: the log was tracked without them.")


@dataclass(frozen=True)
class Leftovers:
    """Removes points at rest that the body does not explain. Numbers were chosen by hand, on experiments/people."""

    most: int = 4  # times that a recording is tracked anew
    well: float = 0.99  # of the points explained, mean of all frames: nothing is left over
    every: int = 3  # of the frames in which things at rest are seen, one of so many is looked at
    off: float = EXPLAINED  # metres outside of all limbs: not explained
    mostly: float = 0.7  # of the frames in which it is seen something is not explained, if it is furniture
    seen: int = 4  # frames in which it must be seen
    fewest: int = 20  # points at rest that are furniture, or there is none
    around: float = 0.05  # metres around them

    def without(
        self, people: list[BodyObservation], bodies: list[tuple[int, Body]], segment: Segment
    ) -> Iterator[BodyObservation] | None:
        """The frames without points at rest that the body, tracked as in `segment`, does not explain; None if there are
        hardly any. `bodies` [(first frame, body)] as they were tracked."""
        windows = [slice(at, min(at + WINDOW, len(people))) for at in range(0, len(people), WINDOW)]
        found = [self._leftovers(people, bodies, segment, window) for window in windows]
        if not any(map(len, found)):
            return None
        return (frame for window, points in zip(windows, found) for frame in self._dropped(people[window], points))

    def _dropped(
        self, frames: list[BodyObservation], points: Float[np.ndarray, "point 3"]
    ) -> Iterator[BodyObservation]:
        tree = KDTree(points) if len(points) else None
        for f in frames:
            if tree is not None and len(f.points):
                near = tree.query(f.points, distance_upper_bound=self.around)[0] < np.inf
                f = f.only(~near | assigned(f))
            yield f

    def _leftovers(
        self, people: list[BodyObservation], bodies: list[tuple[int, Body]], segment: Segment, window: slice
    ) -> Float[np.ndarray, "point 3"]:
        """Points at rest that are furniture; none if those are few."""
        nothing = np.zeros((0, 3))
        tracked = segment.tracked
        explained = segment.explained[window][tracked[window]]
        if not len(explained) or np.mean(explained) > self.well:
            return nothing
        rest = resting(people[window])
        sight = rest.frame + window.start
        looked = np.unique(sight)[:: self.every]
        asked = np.isin(sight, looked[tracked[looked]])
        frame, which = sight[asked], rest.which[asked]
        outside = np.zeros(len(frame))
        for first, end, body in spans(bodies, len(people)):
            mine = (frame >= first) & (frame < end)
            outside[mine] = distance_outside(body, rest.points[which[mine]], frame[mine], segment)
        count = np.bincount(which, minlength=len(rest.points))
        off = np.bincount(which, outside > self.off, len(rest.points))
        found = (count >= self.seen) & (off > self.mostly * count)
        return rest.points[found] if found.sum() >= self.fewest else nothing


def distance_outside(
    body: Body, points: Float[np.ndarray, "point 3"], frame: np.ndarray, segment: Segment
) -> Float[np.ndarray, " point"]:
    """How far each point is outside of the limbs as they were in its frame, metres; inside 0."""
    nearest = np.full(len(points), np.inf)
    for limb, size in enumerate(np.asarray(body.sizes, float)):
        rotation, place = segment.rotation[frame, limb], segment.translation[frame, limb]
        far = signed_distance(size, rotations(rotation).inv().apply(points - place))
        nearest = np.fmin(nearest, np.maximum(far, 0))  # NaN: the limb is not there
    return nearest


def signed_distance(
    size: Float[np.ndarray, "*limb 5"], points: Float[np.ndarray, "*point 3"]
) -> Float[np.ndarray, "*point"]:
    """Distances of points, in limb frames, from limbs with flat caps, metres; inside negative and to the side.

    Across the limb by the ratio of its ellipse: exact on its surface and for round limbs.

    **Arguments:** `size` of one limb, or of several, as can be broadcast to the points.
    """
    a0, b0, a1, b1, length = np.moveaxis(size, -1, 0)
    x, y, z = np.moveaxis(points, -1, 0)
    along = np.clip(z / np.maximum(length, 1e-6), 0, 1)
    a, b = a0 + (a1 - a0) * along, b0 + (b1 - b0) * along
    off, ratio = np.hypot(x, y), np.hypot(x / a, y / b)
    across = np.where(ratio > 0, off * (1 - 1 / np.maximum(ratio, 1e-6)), -np.minimum(a, b))
    beyond = np.maximum(np.maximum(-z, z - length), 0)
    return np.where(beyond > 0, np.hypot(np.maximum(across, 0), beyond), across)
