"""Tracks a recording again with a larger stature if the person is seen to stand taller later. Host side.

The start measures stature by the top of the body: within 0.4 cm for a standing person, but too small by any amount for
a bent one. In frames in which the tracked body stands upright on its feet, the top is measured again.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

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

    The costs of larger sizes are no measurement: statures of people who sit all the time were off by 20 cm with them,
    by 8 cm without (experiments/people)."""

    name: ClassVar = "fit_stature"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body"})

    among: tuple[Stage, ...] = ()  # stages of every segment
    passes: int = 2  # poses found in a wrong size hide a part of the error; by hand

    def __call__(self, whole: Whole) -> Whole:
        run = whole.run
        if run.known or run.settings.start.scale > 0 or run.body.scale_name != "stature" or len(run.bodies) > 1:
            return whole
        for _ in range(self.passes):
            run = whole.run
            stands = standing_height(run, whole.segment) / float(run.body.scale)
            if not np.log(stands) > BELIEVED:  # also where it never stands
                break
            whole = whole.tracked_anew(self.among, body=scaled(run.body, float(run.body.scale) * stands))
        return whole
