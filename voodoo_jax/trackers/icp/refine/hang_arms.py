"""Lets hidden arms hang that were placed on the trunk: arms behind another person, an object or the trunk itself.

Such an arm is not corrected otherwise: the trunk's points hold it, and it explains them. But for a long time it has no
points of its own (`limb_own`). If it would be invisible hanging, it is moved to hang.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from voodoo_jax.detect.camera_motion import as_measured
from voodoo_jax.geometry.rigid import Poses, apply
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.icp.misfit import misfit
from voodoo_jax.trackers.icp.refine.hang_legs import seconds_from, turned, with_limbs
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.shared.confidence import averaged

ARM = ("upper_arm", "forearm", "hand")
# shares: of a forearm's and hand's weight, that of points that no other limb explains; of the body's weight, the same;
# of the hung arm's length, that would be seen. More than the first two: the arm is seen. Measured in 163 logs: 0.13
# and 0.3 for the first are 0.04 cm worse, the others times or over 1.5 are alike; without the first two an arm of
# two-follow is lost (2.95 -> 4.38 cm), without the last a child is 0.1 cm worse
OWN, SOME, BARE = 0.2, 0.003, 0.1
# seconds from frames in which an arm is seen: less, it stays; more, it hangs. Measured: some arms that are right lie on
# the trunk and are 1 s from such frames, none is 2 s
STAYS, HANGS = 1.5, 2.0
# metres, of the hand: one that is nearer to where it would hang hangs, and is seen or not. Measured: 0.1 and 0.225 are
# alike, without it five of 163 logs are worse by up to 0.4 cm, none better
APART = 0.15


@dataclass(frozen=True)
class HangArms:
    """Hidden arms that lie on the trunk hang down, as arms mostly do; joints and poses change with them."""

    name: ClassVar = "hang_arms"
    looks_ahead: ClassVar = True  # how long an arm has nothing of its own
    needs: ClassVar = frozenset({"points", "one body", "l_elbow", "r_elbow"})

    def __call__(self, run: Runner, tracks: Tracks) -> Tracks:
        return with_hung_arms(tracks, run.people)


def with_hung_arms(tracks: Tracks, people: list[BodyObservation]) -> Tracks:
    """Tracks with hanging arms where they were on the trunk for long and would be invisible when hanging.

    **Arguments:** `people` points of the person in each frame, and points in front of them.
    """
    t = tracks.body.topology
    there = {"chest", *(f"{side}_{name}" for side in "lr" for name in ARM)} <= {*t.limbs}
    if tracks.evidence.limb_own is None or not there:
        return tracks
    known = np.isfinite(np.concatenate([tracks.rotation, tracks.translation], 2)).all((1, 2))
    for side in "lr":
        arm = [t.limbs.index(f"{side}_{name}") for name in ARM]
        much = np.clip((seconds_from(_seen(tracks, arm), tracks.time_ns) - STAYS) / (HANGS - STAYS), 0, 1) * known
        if not much.any():
            continue
        some = np.flatnonzero(much)
        hung = _hung(tracks, arm, some, np.ones(len(some)))
        hides = _hidden(tracks, hung, arm, some, people)
        some = some[hides & _elsewhere(tracks, hung, arm[-1], some)]
        if len(some):
            tracks = with_limbs(tracks, _hung(tracks, arm, some, much[some]), some, arm)
            weight = tracks.evidence.limb_weight.copy()
            weight[some[:, None], arm] = 0.0  # their points were the trunk's
            tracks = tracks.having(limb_weight=weight)
    return tracks


def _seen(tracks: Tracks, arm: list[int]) -> Bool[np.ndarray, " frame"]:
    """Frames in which forearm or hand have points that no other limb explains, over a second."""
    weight, share = tracks.evidence.limb_weight, tracks.evidence.limb_own
    assert share is not None
    own = weight * np.nan_to_num(share)
    whole = averaged(weight.sum(1, keepdims=True), True)[:, 0]
    of_arm, of_own = (averaged(each[:, arm[1:]].sum(1, keepdims=True), True)[:, 0] for each in (weight, own))
    return (of_own > OWN * of_arm) & (of_arm > SOME * whole)


def _hung(tracks: Tracks, arm: list[int], some: np.ndarray, much: Float[np.ndarray, " some"]) -> Poses:
    """Poses [frame] with the arm of some frames moved to its rest pose against the chest by the share `much`; its
    shoulder stays in place."""
    body, t = tracks.body, tracks.body.topology
    poses = Poses(tracks.rotation[some].astype(float), tracks.translation[some].astype(float))
    ends, rest = np.asarray(body.child_anchor.translation), np.asarray(body.rest.rotation, float)
    turn_of = lambda quaternion: Rotation.from_quat(quaternion, scalar_first=True)  # noqa: E731
    for at, limb in enumerate(arm):
        joint = [*t.children].index(limb)
        parent = t.parents[joint]
        want = turn_of(poses.rotation[:, parent]) * turn_of(rest[parent]).inv() * turn_of(rest[limb])
        way = (want * turn_of(poses.rotation[:, limb]).inv()).as_rotvec()
        top = np.asarray(apply(poses[:, limb], ends[joint]))
        poses = turned(poses, arm[at:], top, Rotation.from_rotvec(way * much[:, None]))
    rotation, translation = tracks.rotation.astype(float), tracks.translation.astype(float)
    rotation[some], translation[some] = poses.rotation, poses.translation
    return Poses(rotation, translation)


def _elsewhere(tracks: Tracks, hung: Poses, hand: int, some: np.ndarray) -> Bool[np.ndarray, " some"]:
    """Frames in which a hand is not at its place when hanging, over a second."""
    away = np.linalg.norm(np.asarray(hung.translation)[:, hand] - tracks.translation[:, hand], axis=1)
    far = np.full((len(away), 1), np.nan)
    far[some, 0] = away[some]
    return averaged(far, True)[some, 0] > APART


def _hidden(
    tracks: Tracks, hung: Poses, arm: list[int], some: np.ndarray, people: list[BodyObservation]
) -> Bool[np.ndarray, " some"]:
    """Frames in which a hanging arm would be nearly invisible, over a second."""
    frames = [as_measured(people[k]) for k in some]
    bare = np.full((len(people), 1), np.nan)
    rotation, translation = np.asarray(hung.rotation)[some], np.asarray(hung.translation)[some]
    found = misfit(tracks.body, rotation, translation, frames)
    bare[some] = found.bare[:, arm].mean(1, keepdims=True)
    return averaged(bare, True)[some, 0] < BARE
