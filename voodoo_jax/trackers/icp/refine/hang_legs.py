"""Places legs without measurements as people stand and sit, not in line with a leaning trunk or thigh.

A limb without measurements returns to its rest pose, in line with the limb that carries it. If a person bows behind a
table, or the feet are below the image, legs would leave the floor. So thighs hang down from a person who is not lying,
and shanks lean backwards, the more the farther the thigh is forwards; below the thigh of a sitting person they hang
again.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from voodoo_jax.config.options import TrackSettings
from voodoo_jax.geometry.rigid import Poses, apply, inverse
from voodoo_jax.geometry.rotations import unit
from voodoo_jax.model.body import Body
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.icp.runner import Runner

HIDDEN = 0.05  # share to which a limb is seen, below which nothing tells of it; measured: 0.033 and 0.075 are alike
# what a shank's direction is ahead of the trunk: less by so much, and by so much of the thigh's; measured on the 18
# recordings, whose thighs go ahead by 0.13 on average
BACK, MORE, AHEAD = 0.15, 0.4, 0.13
UPRIGHT = 0.5  # cosine of the pelvis' lean, from which on all hangs; measured: 0.4, 0.6, 0.9 and 1 are alike
LEG = ("thigh", "shank", "foot")


@dataclass(frozen=True)
class HangLegs:
    """Hidden legs of people who are not lying are placed as they mostly are; joints and poses change with them."""

    name: ClassVar = "hang_legs"
    looks_ahead: ClassVar = True  # how long a limb stays hidden
    needs: ClassVar = frozenset({"points", "one body", "l_knee", "r_knee"})

    def __call__(self, run: Runner, tracks: Tracks) -> Tracks:
        return with_hung_legs(tracks, run.settings.track)


def with_hung_legs(tracks: Tracks, settings: TrackSettings) -> Tracks:
    """Tracks with hidden legs placed as they mostly are, for a body with a person's legs."""
    t, rest = tracks.body.topology, settings.hidden_rest
    there = {f"{side}_{name}" for side in "lr" for name in LEG} <= {*t.limbs} and {"l_knee", "r_knee"} <= {*t.joints}
    if tracks.up is None or rest <= 0 or not there:
        return tracks
    share = tracks.evidence.limb_weight.astype(float) ** 2
    shown = share / (share + settings.hidden_weight**2)
    poses = Poses(tracks.rotation.astype(float), tracks.translation.astype(float))
    known = np.isfinite(np.concatenate([poses.rotation, poses.translation], 2)).all((1, 2))
    moved = np.zeros(len(tracks.time_ns), bool)
    for side in "lr":
        leg = [t.limbs.index(f"{side}_{name}") for name in LEG]
        thigh, shank = (long_hidden(shown[:, k], tracks.time_ns, rest) * known for k in leg[:2])
        shank = shank * (shown[:, leg[2]] < HIDDEN)  # a foot that is seen tells of the shank
        poses = _hung(tracks.body, poses, leg, (thigh * (shank > 0), shank), tracks.up)
        moved |= shank > 0
    legs = [t.limbs.index(f"{side}_{name}") for side in "lr" for name in LEG]
    return with_limbs(tracks, poses, np.flatnonzero(moved), legs) if moved.any() else tracks


def long_hidden(shown: Float[np.ndarray, " frame"], time_ns: np.ndarray, rest: float) -> Float[np.ndarray, " frame"]:
    """0 in frames in which a limb is visible, and nearer to 1 the farther such frames are, in units of `rest`
    seconds."""
    return 1 - np.exp(-seconds_from(shown >= HIDDEN, time_ns) / rest)


def seconds_from(seen: Bool[np.ndarray, " frame"], time_ns: np.ndarray) -> Float[np.ndarray, " frame"]:
    """Time to the nearest frame, before or after, that is `seen`; infinite without one."""
    time = time_ns / 1e9
    if not seen.any():
        return np.full(len(seen), np.inf)
    after = np.clip(np.searchsorted(time[seen], time), 0, seen.sum() - 1)
    before = np.maximum(after - 1, 0)
    return np.minimum(np.abs(time[seen][after] - time), np.abs(time[seen][before] - time))


def _hung(
    body: Body, poses: Poses, leg: list[int], much: tuple[np.ndarray, np.ndarray], up: Float[np.ndarray, "3"]
) -> Poses:
    """Poses with one leg moved to hang: its thigh and its shank by the share `much`, frame by frame."""
    t = body.topology
    thigh, shank, _ = leg
    hip, knee, ankle = ([*t.children].index(limb) for limb in leg)
    pelvis = Rotation.from_quat(np.nan_to_num(poses.rotation[:, 0], nan=1.0), scalar_first=True)
    pelvis = pelvis * Rotation.from_quat(np.asarray(body.rest.rotation)[0], scalar_first=True).inv()
    # the less, the more it leans: legs of who lies do not hang
    stands = np.clip(pelvis.apply([0.0, 0, 1]) @ up / UPRIGHT, 0.0, 1.0)
    ahead = pelvis.apply([1.0, 0, 0])
    ahead = ahead - (ahead @ up)[:, None] * up
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-6)
    first, second = np.asarray(body.parent_anchor.translation), np.asarray(body.child_anchor.translation)
    for at, (limb, above, below) in enumerate(((thigh, hip, knee), (shank, knee, ankle))):
        top = np.asarray(apply(poses[:, limb], second[above]))
        along = unit(np.asarray(apply(poses[:, limb], first[below])) - top)
        if limb == shank:
            over = unit(top - np.asarray(apply(poses[:, thigh], second[hip])))
            forward = np.sum(over * ahead, 1)
            want = -BACK - MORE * np.maximum(forward, 0) * np.maximum(-over @ up, 0)
        else:
            want = np.full(len(top), AHEAD)
        side = np.cross(up, ahead)
        aside = np.sum(along * side, 1, keepdims=True) * side
        down = np.sqrt(np.clip(1 - want**2 - np.sum(aside**2, 1), 0, 1))[:, None]
        aim = unit(want[:, None] * ahead + aside - down * up)
        axis = np.cross(along, aim)
        angle = np.arctan2(np.linalg.norm(axis, axis=1), np.sum(along * aim, 1)) * much[at] * stands
        turn = Rotation.from_rotvec(np.nan_to_num(unit(axis) * angle[:, None]))
        poses = turned(poses, leg[at:], top, turn)
    return poses


def turned(poses: Poses, limbs: list[int], top: Float[np.ndarray, "frame 3"], turn: Rotation) -> Poses:
    """Poses with some limbs rotated about a point of each frame."""
    rotation, translation = poses.rotation.copy(), poses.translation.copy()
    for limb in limbs:
        there = np.isfinite(rotation[:, limb])
        own = Rotation.from_quat(np.where(there, rotation[:, limb], [1.0, 0, 0, 0]), scalar_first=True)
        rotation[:, limb] = np.where(there, (turn * own).as_quat(scalar_first=True), np.nan)
        translation[:, limb] = top + turn.apply(np.nan_to_num(translation[:, limb] - top))
    return Poses(rotation, translation)


def with_limbs(tracks: Tracks, poses: Poses, moved: Int[np.ndarray, " some"], limbs: list[int]) -> Tracks:
    """Tracks with other poses of some limbs in some frames; joints move with their limbs."""
    t, joints = tracks.body.topology, tracks.joints.copy()
    rotation, translation = tracks.rotation.copy(), tracks.translation.copy()
    for limb in limbs:
        before = Poses(tracks.rotation[moved, limb], tracks.translation[moved, limb])
        after = Poses(poses.rotation[moved, limb], poses.translation[moved, limb])
        rotation[moved, limb], translation[moved, limb] = after.rotation, after.translation
        for k in np.flatnonzero(np.array(t.centre_limbs) == limb):
            joints[moved, k] = apply(after, np.asarray(apply(inverse(before), joints[moved, k])))
    return replace(tracks, rotation=rotation, translation=translation, joints=joints)
