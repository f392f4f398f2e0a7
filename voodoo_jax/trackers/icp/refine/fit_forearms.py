"""Estimates the length of the forearms from a tracked recording. Host side.

If a limb is longer than the body's, the next limb is measured farther out: the bands between them are stretched along
the limb, but by less than the difference in length, since the measurements give way too. The ratio was measured on
people of known lengths, see experiments/forearms. It is accurate enough for forearms only: hands are visible, detectors
name them, and no other limb hangs on them.
"""

from dataclasses import dataclass
from functools import cache
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from voodoo_jax.geometry.rigid import Poses, apply, on_host, unrotate
from voodoo_jax.model.body import Body, scaled, with_proportions
from voodoo_jax.model.body_file import load_on_host
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.solve.names import FeatureNames
from voodoo_jax.trackers.icp.sequence import Whole

Some = TypeVar("Some", float, np.ndarray)


class Stretch(NamedTuple):
    """The stretch of the wrists' bands in a recording."""

    gap: float  # of the wrists' bands along the forearms, median, share of the body's scale
    named: float  # share of the frames in which a detector names the hand
    count: int  # frames of one arm in which the hand is seen


@dataclass(frozen=True)
class FitForearms:
    """Sets the length of the forearms by the stretch of the wrists' bands. Only for the package's own body in its usual
    proportions, for which it was measured. Poses do not change: forearms begin at the elbows, and reach farther.

    The stretch of a wrist's bands is a share of the missing length (as people differ): one share for points alone, plus
    another one if a detector names the hand in every frame. Values from experiments/forearms; those that suit lengths
    best (0.113, 0.167, 0.0089) put wrists 0.1 cm farther off than these: people's hands are not cylinders.
    """

    name: ClassVar = "fit_forearms"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body"})

    by_points: float = 0.09  # share of what the forearm is too short by that a wrist's bands are stretched by
    by_names: float = 0.145  # the same, in addition, where a detector names the hand
    hand: float = 0.0083  # of the stature: people's hands reach so much farther than the body's
    farthest: float = 0.016  # of the stature: forearms of people differ by less (two standard deviations)
    few: int = 30  # frames of one arm with which it counts half

    def __call__(self, whole: Whole) -> Whole:
        run = whole.run
        run.body = self.fitted(run.body, run.people, run.names, whole.segment)
        run.bodies = [(0, run.body)]
        return whole

    def fitted(self, body: Body, people: list[BodyObservation], names: FeatureNames, segment: Segment) -> Body:
        """The body with the forearms estimated from its tracks, or the same one. **Arguments:** as for `stretch`."""
        found = stretch(body, people, names, segment) if in_usual_proportions(body) else None
        if found is None:
            return body
        length = np.asarray(body.sizes)[body.topology.limbs.index("l_forearm"), 4]
        longer = self.lengthened(found) * float(body.scale) / float(length)
        return with_proportions(body, dict.fromkeys(("l_forearm", "r_forearm"), 1.0 + longer))

    def lengthened(self, found: Stretch) -> float:
        """How much longer a forearm is than the body's, share of the body's scale."""
        longer = self.asked(found.gap, found.named)
        return float(np.clip(longer, -self.farthest, self.farthest)) * found.count / (found.count + self.few)

    def asked(self, gap: Some, named: Some) -> Some:
        """How much longer a forearm is than the body's by its wrist's gap, share of the body's scale; of one or of
        many."""
        return gap / (self.by_points + self.by_names * named) - self.hand


def stretch(
    body: Body, people: list[BodyObservation], names: FeatureNames, segment: Segment | Tracks
) -> Stretch | None:
    """The stretch of the wrists' bands in frames where the body is tracked and the hand is visible; None without any.

    **Arguments:** `people` and `segment` the frames and their tracks; `names` of features.
    """
    body, t = on_host(body), body.topology
    limbs = (*t.site_limbs, *t.centre_limbs)  # as in kernels.landmarks.named_points
    tracked, measured = np.flatnonzero(segment.tracked), segment.evidence if isinstance(segment, Tracks) else segment
    gaps, named = [], []
    for side in "lr":
        joint, hand = t.joints.index(f"{side}_wrist"), t.limbs.index(f"{side}_hand")
        frames = tracked[measured.limb_weight[tracked, hand] > 0]
        gaps.append(_gap(body, Poses(segment.rotation[frames], segment.translation[frames]), joint))
        # surely on the hand, that is
        on_hand = lambda name, hand=hand: {limbs[point] for point in names.look_up(name) or ()} == {hand}  # noqa: E731
        named += [any(map(on_hand, (*people[k].rays.names, *people[k].pairs.names))) for k in frames]
    gap = np.concatenate(gaps)
    return Stretch(float(np.median(gap)), float(np.mean(named)), len(gap)) if len(gap) else None


def _gap(body: Body, poses: Poses, joint: int) -> Float[np.ndarray, " frame"]:
    """How far the child of a joint is off along the joint's parent, share of the body's scale."""
    parent, child = body.topology.parents[joint], body.topology.children[joint]
    ends = [apply(poses[:, limb], anchor.translation[joint]) for limb, anchor in (
        (parent, body.parent_anchor), (child, body.child_anchor))]  # fmt: skip
    return unrotate(poses.rotation[:, parent], ends[1] - ends[0])[:, 2] / float(body.scale)


@cache
def usual_body() -> Body:
    """The default body, read once for all logs; on the host, for arrays of a traced call must not be kept."""
    return load_on_host("human")


def in_usual_proportions(body: Body) -> bool:
    """Whether a body is the package's own one in some scale, so that a person's proportions are not known."""
    return body.topology == usual_body().topology and np.allclose(
        body.sizes, scaled(usual_body(), float(body.scale)).sizes, rtol=1e-4, atol=0
    )
