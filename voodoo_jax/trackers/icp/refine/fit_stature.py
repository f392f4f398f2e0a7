"""Tracks a recording again with a larger stature if frames from the whole recording support it. Host side.

The start measures stature by the top of the body: within 0.4 cm for a standing person, but too small by any amount for
a bent one. In frames in which the tracked body stands upright on its feet, the top is measured again. Where there are
none, frames from the whole recording are solved again in larger sizes, each frame separately, and their costs are
compared: in a body of the wrong size the points are farther from the surface.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.geometry.rotations import limb_ends
from voodoo_jax.model.body import Body, places_from_joints, scaled
from voodoo_jax.model.pose_library import SHOULDERS, beyond
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.stretches import spread
from voodoo_jax.trackers.icp.body_size import tops
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.sequence import Whole
from voodoo_jax.trackers.icp.stage import Stage
from voodoo_jax.trackers.shared.runner import TRACKS

# logarithm: the cheapest body is larger than the person by this; measured in 19 tracks of simulated people
# (experiments/people) with the right stature at the start, deviation 0.010
LARGER = 0.003
# A body stands if it has at least this share of its height in the rest pose, and its lowest point is at most this far,
# metres, above that point's lowest tenth. Least logarithm of a larger stature, and fewest frames. Measured in 39 tracks
# of simulated people who bend, walk or jump at first (experiments/people): the stature that is found in 35 of them is
# 0.2 cm too small, standard deviation 2.4
STANDS, ON_FEET, BELIEVED, FEW = 0.96, 0.04, 0.025, 5
FRAMES = 120  # most frames that are used; measured: with 60 the statures of 36 logs change by 0.1 cm on average


def standing_height(run: Runner, segment: Segment) -> float:
    """Stature by the top of the head in the frames in which the body stands upright on its feet with no arm above it,
    metres: their upper quartile, for the top may be hidden; NaN where it hardly does so, or no floor is seen."""
    tracked = np.flatnonzero(segment.tracked)
    if len(tracked) < FEW or not run.scene.floor_seen:
        return float("nan")
    at = tracked[spread(len(tracked), FRAMES)]
    people, floor = [run.people[segment.first + k] for k in at], run.scene.floor
    rest, _ = reach(run.body, np.asarray(run.body.rest.rotation)[None], np.array([0.0, 0.0, 1.0]))
    extent, no_arm = reach(run.body, segment.rotation[at], floor.normal)
    lowest = np.array([np.partition(floor.height(f.points), 2)[2] if len(f.points) > 2 else np.inf for f in people])
    stands = no_arm & (extent > STANDS * rest) & (lowest < np.percentile(lowest, 10) + ON_FEET)
    found = tops(run.body, [f for f, it in zip(people, stands) if it], floor) * rest / extent[stands]
    found = found[np.isfinite(found)]
    return float(np.percentile(found, 75)) if len(found) >= FEW else float("nan")


def reach(
    body: Body, rotation: Float[np.ndarray, "frame limb 4"], up: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, " frame"], Bool[np.ndarray, " frame"]]:
    """How far all limbs but the arms extend along `up`, metres, and whether the arms are lower than the highest other
    limb. Limbs are joined at their joints first, for bands stretch."""
    body, joints = on_host(body), body.topology.joints
    places = places_from_joints(body, Poses(rotation, np.zeros((*rotation.shape[:-1], 3), np.float32)))
    arms = [limb for name in SHOULDERS if name in joints for limb in beyond(body, joints.index(name))]
    ends = limb_ends(rotation, places, np.asarray(body.sizes)[:, 4]) @ up  # [2, frame, limb]
    others = np.delete(ends, arms, 2)
    return np.ptp(others, (0, 2)), ends[:, :, arms].max((0, 2), initial=-np.inf) < others.max((0, 2))


@dataclass(frozen=True)
class FitStature:
    """Further passes with the stature measured in frames of the previous pass, for a person of unknown stature.

    Of the frames that are solved in larger sizes, half come first, and all of them only if these support a larger size.
    Poses found in a wrong size hide part of the error: so there may be two passes. Numbers were chosen by hand."""

    name: ClassVar = "fit_stature"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body"})

    among: tuple[Stage, ...] = ()  # stages of every segment
    step: float = 0.03  # logarithm of one size that is tried over the one before
    most: int = 6  # steps
    gain: float = 0.04  # logarithm of the body's cost over that of a larger one, from which on that is believed
    passes: int = 2

    def __call__(self, whole: Whole) -> Whole:
        run = whole.run
        if run.known or run.settings.start.scale > 0 or run.body.scale_name != "stature" or len(run.bodies) > 1:
            return whole
        for _ in range(self.passes):
            body, larger = whole.run.body, self.larger_by(whole.run, whole.segment)
            if not larger:
                break
            whole = whole.tracked_anew(self.among, body=scaled(body, float(body.scale) * float(np.exp(larger))))
        return whole

    def larger_by(self, run: Runner, segment: Segment) -> float:
        """Logarithm of the person's size over the body's; 0 where a larger size is not well supported."""
        stands = float(np.log(standing_height(run, segment) / float(run.body.scale)))
        if np.isfinite(stands):  # costs would also make a body larger whose legs alone are too short
            return stands if stands > BELIEVED else 0.0
        tracked, found = np.flatnonzero(segment.tracked), 0.0
        at = tracked[spread(len(tracked), TRACKS)]
        for some in filter(len, (at[::2], at)):
            found, gain = self.cheapest(run, segment, some)
            if gain < self.gain:
                return 0.0
        return found - LARGER

    def cheapest(self, run: Runner, segment: Segment, at: Int[np.ndarray, " frame"]) -> tuple[float, float]:
        """Logarithms of the size of least cost over the body's, and of the body's cost over the least cost, in some
        frames. Sizes grow until the cost rises; then the minimum of a parabola through the last three. 0 if the first
        larger size costs more."""
        cost = [self.cost(run, segment, at, steps) for steps in range(2)]
        while cost[-1] < cost[-2] and len(cost) <= self.most:
            cost.append(self.cost(run, segment, at, len(cost)))
        best, gain = int(np.argmin(cost)), cost[0] - min(cost)
        if not 0 < best < len(cost) - 1:
            return self.step * best, gain
        before, least, after = cost[best - 1 : best + 2]
        return self.step * (best + 0.5 * (before - after) / (before - 2 * least + after)), gain

    def cost(self, run: Runner, segment: Segment, at: Int[np.ndarray, " frame"], steps: int) -> float:
        """Logarithm of the mean cost of some frames in a body that is larger by so many steps."""
        larger, up = np.float32(np.exp(self.step * steps)), run.scene.floor.normal
        place = segment.translation[at]
        foot = place[:, :1] - run.scene.floor.height(place[:, 0])[:, None, None] * up
        starts = Poses(segment.rotation[at], (foot + larger * (place - foot)).astype(np.float32))
        return float(np.log(np.mean(run.alone(scaled(run.body, float(run.body.scale) * float(larger)), starts, at))))
