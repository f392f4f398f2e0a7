"""Removes furniture that the body touches all the time and that is not flat: points at rest that the body never
explains where it is well tracked. Host side, NumPy; looks ahead."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from voodoo_jax.detect.disk_buffer import spilled
from voodoo_jax.detect.stage import WINDOW
from voodoo_jax.detect.stillness import resting
from voodoo_jax.geometry.rotations import rotations
from voodoo_jax.model.body import Body
from voodoo_jax.records.notes import remark
from voodoo_jax.records.observation import BodyObservation, assigned
from voodoo_jax.records.segment import Segment
from voodoo_jax.trackers.icp.misfit import signed_distance
from voodoo_jax.trackers.icp.sequence import Whole
from voodoo_jax.trackers.icp.stage import Stage
from voodoo_jax.trackers.shared.confidence import EXPLAINED
from voodoo_jax.trackers.shared.runner import spans

FURNITURE_NOTE = remark("Things at rest that touch the body are furniture: the log was tracked without them.")


@dataclass(frozen=True)
class DropUnexplained:
    """Tracks the recording again without points at rest that the body does not explain, as long as there are any.
    Numbers were chosen by hand, on experiments/people."""

    name: ClassVar = "drop_unexplained"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body"})

    among: tuple[Stage, ...]  # stages that segments go through when they are tracked anew
    most: int = 4  # times that a recording is tracked anew
    well: float = 0.99  # of the points explained, mean of all frames: nothing is left over
    every: int = 3  # of the frames in which things at rest are seen, one of so many is looked at
    off: float = EXPLAINED  # metres outside of all limbs: not explained
    mostly: float = 0.7  # of the frames in which it is seen something is not explained, if it is furniture
    seen: int = 4  # frames in which it must be seen
    fewest: int = 20  # points at rest that are furniture, or there is none
    around: float = 0.05  # metres around them

    def __call__(self, whole: Whole) -> Whole:
        for _ in range(self.most):
            left = self.without(whole.run.people, whole.run.bodies, whole.segment)
            if left is None:
                break
            whole = replace(whole.tracked_anew(self.among, spilled(left)), notes=(*whole.notes, FURNITURE_NOTE))
        return whole

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
