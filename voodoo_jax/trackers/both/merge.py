"""Merges the tracks of one person by the ICP and by the flexible tracker, limb by limb. Host side.

The ICP tracker fits cylinders to points, the flexible tracker weighs particles on images: their errors are
independent. Each gives a probability that a joint is correct. By Bayes' rule the distance between both tracks then says
whether both, one or none is correct. Each limb is placed where the expected error is least: between both tracks, or as
one tracker has it, attached to the merged trunk.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int64
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rotations import axis_of, rotations, shortest_turns, unit
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.flexible.flexible_body import CENTRES, LIMB_NAMES, LIMBS, POINTS
from voodoo_jax.trackers.icp.confidence import mark_lost
from voodoo_jax.trackers.icp.misfit import misfit
from voodoo_jax.trackers.shared.report import derived_from

# joint centres of each arm and leg, from the trunk outwards, and the limbs that begin at them
CHAINS = tuple(tuple(CENTRES[POINTS[point]] for point in row) for row in LIMBS.tolist())
CHAIN_LIMBS = np.reshape(LIMB_NAMES, LIMBS.shape).tolist()
# metres along each axis, standard deviations. ERRS: of joints that are correct by the ICP and by the flexible tracker,
# measured on the choosing half of experiments/stereo and four other rendered logs. ELSE: of the distance between both
# where one is wrong; of 0.2 and 0.3 the better one there
ERRS, ELSE = (0.021, 0.027), 0.2
THEIRS = ERRS[0] ** 2 / (ERRS[0] ** 2 + ERRS[1] ** 2)  # where both are correct, as measured
STEADY = 0.45  # seconds over which both are compared; measured: 0 to 0.9 give the same
# standard deviations along each axis: of a joint by the flexible tracker alone (metres), and per metre of distance
# between both tracks; measured: the 95 % region holds 95 % of the true joints of five rendered stereo logs
SPREAD, APART = 0.01, 0.25


class Choice(NamedTuple):
    """How much each joint takes from each tracker."""

    share: Float[np.ndarray, "frame joint"]  # of the flexible tracker, 0 to 1
    right: Float32[np.ndarray, "frame joint"]  # probability that the merged joint is within 10 cm
    apart: Float[np.ndarray, "frame joint"]  # metres between both tracks; for an arm or leg, of its farthest joint


# 6 parameters: both tracks, and how frames are merged
def merged(
    icp: Tracks, flexible: Tracks, people: list[BodyObservation], least: float, chunk: int, ahead: bool = True
) -> Tracks:
    """The ICP tracker's tracks with limbs moved to the merged positions (see the module's docstring).

    Confidence, covariances, misfits and implausibility are computed for the merged poses; residual, explained and
    limb_weight are those of the ICP tracker's fit.

    **Arguments:** `people` points of the person in each frame; if shorter than the tracks, only the last frames are
    merged; `least` expected share of correct joints below which a frame is LOST; `chunk` frames per compiled call;
    `ahead` whether later frames may be used.
    """
    last = slice(len(icp.time_ns) - len(people), None)
    choice = Choice(*(each[last] for each in chosen(icp, flexible, ahead)))
    icp, flexible = icp.only(last), flexible.only(last)
    waited = icp.compile_seconds + flexible.compile_seconds
    out = replace(icp, seconds=icp.seconds + flexible.seconds, compile_seconds=waited)
    if not choice.share.any():
        return out
    joints = hung(icp, flexible, choice.share)
    rotation, translation = posed(icp, flexible, choice.share, joints)
    limb_covariance, joint_covariance = _widen_covariances(icp, choice)
    fit = misfit(icp.body, rotation, translation, people)
    status = np.where(choice.share.mean(1) > 0.5, flexible.status, icp.status)  # of the tracker with the larger share
    beyond, depth = _measure_implausibility(icp.body, rotation, translation, chunk)
    return out.having(
        joints=joints, rotation=rotation, translation=translation, limb_covariance=limb_covariance,
        joint_covariance=joint_covariance, joint_confidence=choice.right, limb_beside=fit.beside,
        limb_distance=fit.distance, limb_bare=fit.bare, limb_own=fit.own, beyond_limits=beyond, depth_inside=depth,
        status=mark_lost(status.astype(np.int8), choice.right, least),
    )  # fmt: skip


def chosen(icp: Tracks, flexible: Tracks, ahead: bool = True) -> Choice:
    """The share of each tracker in every joint; arguments as for `merged`."""
    names = icp.body.topology.centres
    half = compared_frames(icp.time_ns) // 2
    steady = partial(uniform_filter1d, size=2 * half + 1, axis=-1, mode="nearest", origin=0 if ahead else half)
    known = np.isfinite(icp.joints).all(-1) & np.isfinite(flexible.joints).all(-1)
    usable = known.sum(1) == known.sum(1).max(initial=0)  # frames in which both have all joints that they ever have
    gap = np.where(known, np.linalg.norm(np.nan_to_num(icp.joints - flexible.joints), axis=-1), 0.0)
    said = [_read_confidence(each).astype(float) for each in (icp, flexible)]
    chains = [[names.index(name) for name in chain] for chain in CHAINS]
    moved = [row for chain in chains for row in chain[1:]]

    def weigh_cases(rows: list[int]) -> Float[np.ndarray, "4 frame"]:
        """Probabilities that a group of joints is correct in both tracks, in the ICP tracker's alone, in the flexible
        tracker's alone, and in none."""
        apart, (a, b) = np.minimum(gap[:, rows].max(1), 2 * ELSE), (each[:, rows].min(1) for each in said)
        near, far = (np.exp(-((apart / sigma) ** 2) / 2) / sigma**3 for sigma in (np.hypot(*ERRS), ELSE))
        found = np.stack([a * b * near, a * (1 - b) * far, (1 - a) * b * far, (1 - a) * (1 - b) * far])
        return found / found.sum(0)

    def share(p: Float[np.ndarray, "4 frame"]) -> Float[np.ndarray, " frame"]:
        """Share of the flexible tracker: by the variances where both are correct, else 1 where the flexible tracker is
        the likely one around that time. This is close to the least expected error."""
        both, one, other, _ = steady(p)
        return THEIRS * p[0] + (1 - p[0]) * steady((other > both + one).astype(float))

    out, right, apart = np.zeros(gap.shape), np.zeros(gap.shape), gap.copy()
    trunk = weigh_cases([chain[0] for chain in chains])
    near, whole = trunk[0], share(trunk)  # with trunks apart the whole body comes from one
    groups = [[row] for row in range(len(names)) if row not in moved] + [chain[1:] for chain in chains]
    for rows in groups:
        much = near * share(weigh_cases(rows)) + (1 - near) * whole
        apart[:, rows] = gap[:, rows].max(1, keepdims=True)
        for row in rows:
            p = weigh_cases([row])
            out[:, row], right[:, row] = much, p[0] + (1 - much) * p[1] + much * p[2]
    taken = known & usable[:, None]
    return Choice(np.where(taken, out, 0.0), np.where(taken, right, _read_confidence(icp)).astype(np.float32), apart)


def compared_frames(time_ns: Int64[np.ndarray, " frame"]) -> int:
    """Number of frames over which both are compared, odd."""
    between = float(np.median(np.diff(time_ns))) / 1e9 if len(time_ns) > 1 else STEADY
    return 2 * round(STEADY / max(between, 1e-3) / 2) + 1


def hung(icp: Tracks, flexible: Tracks, share: Float[np.ndarray, "frame joint"]) -> Float[np.ndarray, "frame joint 3"]:
    """Merged joint centres, metres: those of the trunk between both tracks; arms and legs are attached to them, each
    bone with a direction and a length between both."""
    names, b = icp.body.topology.centres, np.nan_to_num(flexible.joints)
    joints = icp.joints + share[..., None] * np.where(share[..., None] > 0, b - icp.joints, 0.0)
    for chain in ([names.index(name) for name in chain] for chain in CHAINS):
        for root, end in zip(chain, chain[1:]):
            much = share[:, end, None]
            bones = icp.joints[:, end] - icp.joints[:, root], b[:, end] - b[:, root]
            lengths = [np.linalg.norm(bone, axis=1, keepdims=True) for bone in bones]
            along = unit((1 - much) * unit(bones[0]) + much * unit(bones[1]))
            length = (1 - much) * lengths[0] + much * lengths[1]
            joints[:, end] = np.where(much > 0, joints[:, root] + length * along, icp.joints[:, end])
    return joints.astype(icp.joints.dtype)


def posed(
    icp: Tracks, flexible: Tracks, share: Float[np.ndarray, "frame joint"], joints: Float[np.ndarray, "frame joint 3"]
) -> tuple[Float32[np.ndarray, "frame limb 4"], Float[np.ndarray, "frame limb 3"]]:
    """Poses of the limbs at the merged joint centres: rotations wxyz, and translations, metres.

    A bone of an arm or leg comes from the tracker with the larger share, turned the shortest way; hand and foot follow
    the bone before them. Positions and axes of the trunk's limbs lie between both tracks.
    """
    t = icp.body.topology
    rotation, translation = icp.rotation.copy(), icp.translation.copy()

    def set_pose(limb: int, turn: Rotation, q: np.ndarray, place: np.ndarray, much: np.ndarray) -> None:
        here = (much > 0) & np.isfinite(q).all(1) & np.isfinite(place).all(1)
        rotation[here, limb] = (turn * rotations(q)).as_quat(scalar_first=True)[here]
        translation[here, limb] = place[here]

    rest = set(range(len(t.limbs)))
    for parts, chain in zip(CHAIN_LIMBS, CHAINS):
        rows = [t.centres.index(name) for name in chain]
        much = share[:, rows[-1]]
        theirs = (much > 0.5)[:, None]
        base = np.where(theirs[..., None], flexible.joints[:, rows], icp.joints[:, rows])
        for k, limb in enumerate(t.limbs.index(part) for part in parts):
            begin, end = (rows[k], rows[k + 1]) if k < 2 else (rows[1], rows[2])
            bones = base[:, min(k, 1) + 1] - base[:, min(k, 1)], joints[:, end] - joints[:, begin]
            turn = shortest_turns(*(unit(np.nan_to_num(bone)) for bone in bones))
            q = np.where(theirs, flexible.rotation[:, limb], icp.rotation[:, limb])
            place = np.where(theirs, flexible.translation[:, limb], icp.translation[:, limb])
            set_pose(limb, turn, q, joints[:, rows[k]] + turn.apply(np.nan_to_num(place - base[:, k])), much)
            rest.discard(limb)
    much = share[:, [t.centres.index(chain[0]) for chain in CHAINS]].mean(1)
    between = lambda a, b: (1 - much[:, None]) * a + much[:, None] * b  # noqa: E731
    for limb in rest:
        a, b = (tracks.rotation[:, limb] for tracks in (icp, flexible))
        q = np.where((much > 0.5)[:, None], b, a)
        turn = shortest_turns(axis_of(q), between(axis_of(a), axis_of(b)))
        set_pose(limb, turn, q, between(icp.translation[:, limb], flexible.translation[:, limb]), much)
    return rotation, translation


def _read_confidence(tracks: Tracks) -> Float32[np.ndarray, "frame joint"]:
    """Confidence of the joints, 0 where it is NaN."""
    assert tracks.joint_confidence is not None
    return np.nan_to_num(tracks.joint_confidence)


def _widen_covariances(
    icp: Tracks, choice: Choice
) -> tuple[Float32[np.ndarray, "frame limb 6 6"] | None, Float32[np.ndarray, "frame joint 3 3"] | None]:
    """Covariances of limbs and joint centres: those of the ICP tracker by its share, widened by the distance between
    both tracks."""
    wide = np.where(choice.share > 0, choice.share * SPREAD**2 + (APART * choice.apart) ** 2, 0.0)
    joint, limb = icp.joint_covariance, icp.limb_covariance
    if joint is not None:
        kept = (1 - choice.share)[..., None, None].astype(np.float32)
        joint = kept * joint + wide[..., None, None].astype(np.float32) * np.eye(3, dtype=np.float32)
    if limb is not None:
        owner = np.array(icp.body.topology.centre_limbs, int)
        limb = limb.copy()
        for n in np.unique(owner):
            more = wide[:, owner == n].max(1)
            far = float(icp.body.sizes[n, 4]) / 2
            limb[:, n] += more[:, None, None] * np.diag([far**-2] * 3 + [1.0] * 3)
    return limb, joint


def _measure_implausibility(
    body: Body, rotation: np.ndarray, translation: np.ndarray, chunk: int
) -> tuple[Float32[np.ndarray, "frame bodyjoint"], Float32[np.ndarray, "frame limb"]]:
    """Joint angles beyond their limits, radians, and depth of limbs inside each other, metres."""
    segment = replace(
        Segment.blank(len(rotation), body.limb_count), rotation=rotation, translation=translation,
    )  # fmt: skip
    found = [derived_from(body, segment[at : at + chunk], chunk) for at in range(0, len(rotation), chunk)]
    return np.concatenate([f.beyond_limits for f in found]), np.concatenate([f.depth_inside for f in found])
