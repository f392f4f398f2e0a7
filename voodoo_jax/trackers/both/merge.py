"""Tracks of the ICP and of the flexible tracker of one person made one, limb by limb. Host side.

One fits cylinders to points, the other weighs particles on images: they err independently, so that where both agree
their mean is nearer to the truth than either. Where they do not, a limb is the one's whose confidence is clearly
higher, whole and hung on the merged trunk; else the ICP tracker's.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32
from scipy.ndimage import correlate1d
from scipy.spatial.transform import Rotation
from scipy.special import expit, logit

from voodoo_jax.geometry.rotations import axis_of, rotations, shortest_turns, unit
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.flexible.flexible_body import CENTRES, LIMBS, POINTS
from voodoo_jax.trackers.icp.confidence import mark_lost
from voodoo_jax.trackers.icp.misfit import misfit
from voodoo_jax.trackers.shared.report import derived_from

# joint centres of each arm and leg, from the trunk on, and the limbs that begin at them
CHAINS = tuple(tuple(CENTRES[POINTS[point]] for point in row) for row in LIMBS.tolist())
PARTS = tuple(
    tuple(f"{side}_{part}" for part in parts)
    for parts in (("upper_arm", "forearm", "hand"), ("thigh", "shank", "foot"))
    for side in "lr"
)
# metres between both up to which their mean is taken (none from twice that on), and by how much the flexible tracker's
# joint confidence has to be higher; chosen on five of nine rendered stereo logs and on simulated ones (see
# experiments/flexible)
AGREE, SURER = 0.1, 0.2
STEADY = 0.13  # seconds, standard deviation of the frames over which both are compared; by hand: 0 to 0.26 are alike
# numbers of the merged confidence: a constant, for the logarithm of the odds of who is taken, and for the logarithm of
# how far both are apart, metres, at least NEAR; measured: fitted to the same logs and one of somebody who sits down
TRUST, NEAR, LEAST = (-6.75, 0.79, -3.41), 0.05, 1e-3
# metres: of a joint by the flexible tracker alone, and what a metre that both are apart counts for, standard deviations
# along each axis; measured: 95 % of the truth of those five is inside
SPREAD, APART = 0.01, 0.25
STUB = 0.1  # metres: limbs that are shorter turn as if they were so long; by hand


class Choice(NamedTuple):
    """What is taken of whom."""

    share: Float[np.ndarray, "frame joint"]  # of the flexible tracker's, 0 to 1
    apart: Float[np.ndarray, "frame joint"]  # metres between both, of an arm or leg its farthest joint


# 6 parameters: both tracks, and what decides about a frame
def merged(
    icp: Tracks, flexible: Tracks, people: list[BodyObservation], least: float, chunk: int, ahead: bool = True
) -> Tracks:
    """The ICP tracker's tracks with limbs moved to where both are, or the flexible tracker is, see above.

    Confidence, covariances, misfits and what is not plausible are of the merged poses; residual, explained and
    limb_weight remain of the ICP tracker's fit.

    **Arguments:** `people` points of the person in each frame; `least` share of the joints that must be expected to be
    right, or the frame is LOST; `chunk` so many frames are looked at at once; `ahead` whether later frames may be
    looked at.
    """
    choice = chosen(icp, flexible, ahead)
    seconds = icp.seconds + flexible.seconds, icp.compile_seconds + flexible.compile_seconds
    out = replace(icp, seconds=seconds[0], compile_seconds=seconds[1])
    if not choice.share.any():
        return out
    joints = hung(icp, flexible, choice.share)
    rotation, translation = posed(icp, flexible, choice.share, joints)
    limb_covariance, joint_covariance = _spread(icp, choice)
    fit = misfit(icp.body, rotation, translation, people)
    beyond, depth = _implausible(icp.body, rotation, translation, chunk)
    sure = confidence(icp, flexible, choice)
    return replace(
        out, joints=joints, rotation=rotation, translation=translation, limb_covariance=limb_covariance,
        joint_covariance=joint_covariance, joint_confidence=sure, limb_beside=fit.beside,
        limb_distance=fit.distance, limb_bare=fit.bare, limb_own=fit.own, beyond_limits=beyond, depth_inside=depth,
        status=_status(icp, flexible, choice, sure, least),
    )  # fmt: skip


def chosen(icp: Tracks, flexible: Tracks, ahead: bool = True) -> Choice:
    """What is taken of whom; arguments as for `merged`."""
    names = icp.body.topology.centres
    steady = _Steady(icp.time_ns, ahead)
    known = np.isfinite(icp.joints).all(-1) & np.isfinite(flexible.joints).all(-1)
    usable = known.sum(1) == known.sum(1).max(initial=0)  # frames in which both have all that they ever have
    gap = np.where(known, np.linalg.norm(np.nan_to_num(icp.joints - flexible.joints), axis=-1), 0.0)
    sure = [_said(each) for each in (icp, flexible)]
    chains = [[names.index(name) for name in chain] for chain in CHAINS]
    moved = [row for chain in chains for row in chain[1:]]
    trunk = [row for row in range(len(names)) if row not in moved]

    def compared(rows: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """How near both are, 1: their mean is taken, 0: one of both is; and how much of the flexible tracker's then."""
        apart, gain = gap[:, rows].max(1), sure[1][:, rows].min(1) - sure[0][:, rows].min(1)
        near = np.clip(2 - np.maximum(apart, steady(apart)) / AGREE, 0.0, 1.0)
        return near, steady((steady(gain) > SURER).astype(float))

    def share(near: np.ndarray, surer: np.ndarray) -> np.ndarray:
        return near / 2 + (1 - near) * surer

    out, apart = np.zeros(gap.shape), gap.copy()
    roots = [chain[0] for chain in chains]
    near, surer = compared(roots)
    whole = share(near, surer)  # of a trunk that is elsewhere, or faces the other way, all of the body
    for row in trunk:
        out[:, row] = near * share(*compared([row])) + (1 - near) * whole
    for chain in chains:
        out[:, chain[1:]] = (near * share(*compared(chain[1:])) + (1 - near) * whole)[:, None]
        apart[:, chain[1:]] = gap[:, chain[1:]].max(1, keepdims=True)
    return Choice(np.where(known & usable[:, None], out, 0.0), apart)


class _Steady:
    """A mean over the frames around each, or those before it alone."""

    def __init__(self, time_ns: np.ndarray, ahead: bool):
        between = float(np.median(np.diff(time_ns))) / 1e9 if len(time_ns) > 1 else STEADY
        sigma = STEADY / max(between, 1e-3)
        reach = int(np.ceil(3 * sigma))
        weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
        weight[reach + 1 :] *= ahead
        self._weight = weight / weight.sum()

    def __call__(self, values: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " frame"]:
        return correlate1d(values.astype(float), self._weight, axis=0, mode="nearest")


def hung(icp: Tracks, flexible: Tracks, share: Float[np.ndarray, "frame joint"]) -> Float[np.ndarray, "frame joint 3"]:
    """Joint centres: of the trunk between both; limbs hang on these, each bone in a direction and of a length between
    both."""
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
    """Poses of the limbs that go with merged joint centres.

    A bone of an arm or leg is as in the tracks of which more is taken, turned the shortest way; hand and foot go with
    the bone before them. Limbs of the trunk have places and axes between both.
    """
    t = icp.body.topology
    rotation, translation = icp.rotation.copy(), icp.translation.copy()

    def put(limb: int, turn: Rotation, q: np.ndarray, place: np.ndarray, much: np.ndarray) -> None:
        here = (much > 0) & np.isfinite(q).all(1) & np.isfinite(place).all(1)
        rotation[here, limb] = (turn * rotations(q)).as_quat(scalar_first=True)[here]
        translation[here, limb] = place[here]

    rest = set(range(len(t.limbs)))
    for parts, chain in zip(PARTS, CHAINS):
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
            put(limb, turn, q, joints[:, rows[k]] + turn.apply(np.nan_to_num(place - base[:, k])), much)
            rest.discard(limb)
    much = share[:, [t.centres.index(chain[0]) for chain in CHAINS]].mean(1)
    for limb in rest:
        a, b = (tracks.rotation[:, limb] for tracks in (icp, flexible))
        q = np.where((much > 0.5)[:, None], b, a)
        turn = shortest_turns(axis_of(q), _between(axis_of(a), axis_of(b), much))
        put(limb, turn, q, _between(icp.translation[:, limb], flexible.translation[:, limb], much), much)
    return rotation, translation


def _between(a: Float[np.ndarray, "frame 3"], b: Float[np.ndarray, "frame 3"], much: Float[np.ndarray, " frame"]):
    return (1 - much[:, None]) * a + much[:, None] * b


def confidence(icp: Tracks, flexible: Tracks, choice: Choice) -> Float32[np.ndarray, "frame joint"]:
    """Probability that a merged joint centre is within 10 cm of the true one; the ICP tracker's where nothing is taken
    of the other."""
    odds = [logit(np.clip(_said(each), LEAST, 1 - LEAST)) for each in (icp, flexible)]
    taken = (1 - choice.share) * odds[0] + choice.share * odds[1]
    constant, by_odds, by_gap = TRUST
    found = expit(constant + by_odds * taken + by_gap * np.log(np.maximum(choice.apart, NEAR)))
    return np.where(choice.share > 0, found, _said(icp)).astype(np.float32)


def _said(tracks: Tracks) -> Float32[np.ndarray, "frame joint"]:
    """Confidence of the joints, 0 where there is none."""
    assert tracks.joint_confidence is not None
    return np.nan_to_num(tracks.joint_confidence)


def _spread(
    icp: Tracks, choice: Choice
) -> tuple[Float32[np.ndarray, "frame limb 6 6"] | None, Float32[np.ndarray, "frame joint 3 3"] | None]:
    """Covariances of limbs and joint centres: of the ICP tracker's as far as they are taken, and wider by how far both
    are apart."""
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
            far = max(float(icp.body.sizes[n, 4]), STUB) / 2
            limb[:, n] += more[:, None, None] * np.diag([far**-2] * 3 + [1.0] * 3)
    return limb, joint


def _implausible(
    body: Body, rotation: np.ndarray, translation: np.ndarray, chunk: int
) -> tuple[Float32[np.ndarray, "frame bodyjoint"], Float32[np.ndarray, "frame limb"]]:
    """How far joints are beyond their limits, radians, and limbs in each other, metres."""
    segment = replace(
        Segment.blank(len(rotation), body.limb_count), rotation=rotation, translation=translation,
    )  # fmt: skip
    found = [derived_from(body, segment[at : at + chunk], chunk) for at in range(0, len(rotation), chunk)]
    return np.concatenate([f.beyond_limits for f in found]), np.concatenate([f.depth_inside for f in found])


def _status(
    icp: Tracks, flexible: Tracks, choice: Choice, sure: Float32[np.ndarray, "frame joint"], least: float
) -> np.ndarray:
    """Status of the tracker of which most is taken; LOST where too few joints are expected to be right."""
    status = np.where(np.mean(choice.share, 1) > 0.5, flexible.status, icp.status)
    return mark_lost(status.astype(np.int8), sure, least)
