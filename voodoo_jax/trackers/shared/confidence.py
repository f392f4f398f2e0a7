"""Confidence: the probability that a joint centre is within 10 cm of the true one. Host side.

A logistic function of clues in a frame, fitted to recordings with ground truth, unchanged and degraded (fewer frames,
noise, coarse distances, late start), by experiments/trust. There, fitted to one half of the people, it is calibrated
for the other half.

All these recordings show people without objects near them. A body that was fitted to a table or a coat, or that faces
the wrong way, is as smooth and as near to its points. So there are two more factors. One is whether the body fits
(misfits: points beside limbs, limbs without points, limbs inside others, joints bent too far, passes that differed,
limbs whose points another limb explains as well). The other is whether it faces the right way, with the odds of the
learned eye as they are: of 102 logs, of whole people and of trunks alone, they are calibrated (a factor of 1 to 1.2 on
their mean is best). Six of 26 trunks were back to front, with mean odds of 2 at most.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.special import expit

from voodoo_jax.geometry.rigid import apply, cross_matrix, on_host
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.records.tracks import Status, Tracks

CLOSE = 0.10  # metres
# metres from a limb's surface up to which it explains a point: real people are no cylinders. Fitted, see
# experiments/numbers: loss of the confidence against 0.05 -0.006 +- 0.002 (163 logs, 21 better, 5 worse), 0.075 -0.008,
# 0.033 +0.028
EXPLAINED = 0.06
BATCH = 4096  # frames of a recording that are looked at at once, 1 to 5 kB each: any gives the same
CLUES = ("spread", "residual", "unexplained", "moved", "weight", "apart")
# of a joint whose limb has no measurements: a frame does not show how far off it is. Of knees and ankles in a walk
# on a treadmill 12 % were within 10 cm, of joints of a recording without its legs', arms' or shanks' markers 39 %
UNMARKED = 0.1
MISFITS = ("beside", "bare", "all distance", "size", "inside", "beyond", "apart", "shared")
# frames over which a limb's misfit is averaged, about a second. Measured: with 21 and 47 the log loss changes by 0.002
# and -0.005
AROUND = 31
# share of a limb's points, and metres: less is harmless. Of 3, 5, 6 and 9 mm the first separates right from wrong best
# in kinds of logs left out (0.952, 0.945, 0.941 and 0.937 with AT_LEAST 0, see experiments/trust)
LEAST_SHARE, LEAST_DISTANCE = 0.03, 0.003
# metres in another limb that count as one; harmless metres between the passes; weight of a limb's own points,
# those that no other limb explains, beyond which more add nothing. Measured: times or over 1.5 the log loss of the
# confidence changes by -0.003 and 0.007; -0.001 and 0.003; 0.0003 and -0.0006 (39 logs, experiments/numbers)
DEEP, TOGETHER, PLENTY = 0.01, 0.05, 20.0
# metres: a usual stature and its standard deviation, men and women together (ANSUR II, 2012); so many of these are
# harmless, and so many beyond count at most: of small people less, for children are people, too. Measured: each of the
# last three times or over 1.5 changes no loss by more than 0.014; where all is 1.3 times as far as it should be, joints
# are said to be right with 0.01 by them, with 0.31 by right_scale alone
STATURE, STATURES, USUAL, UNUSUAL, SMALL = 1.70, 0.095, 2.7, 2.0, 0.9
EVERY = slice(None)


class Trust(NamedTuple):
    """Coefficients of the logistic function, for a unit change of each clue, see `clues`."""

    constant: float
    slopes: tuple[float, ...]


# fitted together with FITS to tracks of 2026-11-26, see experiments/trust
THERE_AND_BACK = Trust(-12.173, (-3.734, -0.124, -0.047, -0.333, 0.522, -0.702))
# from experiments/trust
ONE_PASS = Trust(-11.546, (-2.840, -0.021, -0.607, -0.529, 0.173))

# of MISFITS; from experiments/trust/elsewhere.py. "shared" was fitted later, to 127 tracks of 13 kinds, the others as
# they were
FITS = Trust(-16.063, (-1.268, -4.100, -3.320, -1.441, -2.553, -0.254, -1.288, -0.356))

# the same where points are measured by matching images: of the choosing half of experiments/stereo, fitted likewise.
# Errors of neighbours are alike there: how far points are from limbs tells nothing
MATCHED_FITS = Trust(0.330, (-1.279, -5.902, 0.0, -0.240, -2.113, -0.239, -0.022, -0.848))


def clues(tracks: Tracks, ahead: bool = True) -> Float[np.ndarray, "frame joint clue"]:
    """Clues for errors of each joint centre: logarithms of its standard deviation by its limb's covariance, of the
    frame's residual and share of unexplained points, of its motion between frames and of the distance between the
    forward and the backward pass (all in metres), and log(1 + weight) of the measurements of its limb.

    **Arguments:** `ahead` whether the following frame may be used, too.

    The last clue is NaN if there was only one pass.
    """
    seen = tracks.evidence
    assert seen.passes_apart is not None
    joints, limbs = tracks.joints, np.array(tracks.body.topology.centre_limbs, int)
    step = np.linalg.norm(np.diff(joints, axis=0), axis=-1)
    still = np.zeros((1, joints.shape[1]))
    before, after = np.concatenate([still, step]), np.concatenate([step, still])
    moved = (np.fmax(before, after) if ahead else before)[: len(joints)]
    spread = _spread(tracks)
    log = lambda found, least, most: np.log(np.clip(found, least, most))  # noqa: E731
    each = lambda row: np.broadcast_to(row[:, None], moved.shape)  # noqa: E731
    found = (
        log(spread, 1e-3, 10.0),
        each(log(seen.residual, 0.003, 1.0)),
        each(log(1 - seen.explained, 0.003, 1.0)),
        log(moved, 0.003, 1.0),
        np.log1p(seen.limb_weight[:, limbs]),
        log(seen.passes_apart[:, limbs], 0.005, 1.0),
    )
    return np.stack(found, -1)


def _spread(tracks: Tracks) -> Float[np.ndarray, "frame joint"]:
    """Standard deviation of joint centres from the measurements of their limbs, metres, without the contributions of
    place_joints and the other pass, which are separate clues."""
    t = tracks.body.topology
    assert tracks.limb_covariance is not None
    twist = tracks.limb_covariance[:, np.array(t.centre_limbs, int)].astype(float)
    turned = -cross_matrix(np.asarray(tracks.body.centres, float))
    shift = np.concatenate([turned, np.broadcast_to(np.eye(3), turned.shape)], 2)  # of a joint, by its limb's twist
    return np.sqrt(np.einsum("jab,fjbc,jac->fj", shift, twist, shift))


def misfits(tracks: Tracks, averages: "Averages | None") -> Float[np.ndarray, "frame joint misfit"]:
    """Clues that the body is fitted to something else, of each joint centre, averaged over a second.

    The worst of three limbs counts: its own, the next one towards the trunk and the one that it meets there. The clues
    are: the logarithm of the share of unexplained points beside it; the share of its length without points (of the
    first two); log(1 + centimetres inside other limbs); violations of joint limits, in tens of degrees; and the
    logarithm of the largest distance between the passes. Of its own limb: the difference of log(1 + weight), of the
    points that no other limb explains, to that of PLENTY. Of the body: the logarithm of the points' distance from all
    limbs, metres (see misfit.py), and how unusual the size is.

    **Arguments:** `averages` of these tracks, see averages_of.

    NaN where it is not known.
    """
    t, count = tracks.body.topology, len(tracks.status)
    limbs = np.array(t.centre_limbs, int)
    if averages is None:
        return np.full((count, len(limbs), len(MISFITS)), np.nan)
    parent = np.arange(len(t.limbs))
    parent[np.array(t.children, int)] = np.array(t.parents, int)
    towards, meets = parent[limbs], meeting_limbs(tracks.body)
    worse = lambda found: np.fmax(found[:, limbs], found[:, towards])  # noqa: E731
    worst = lambda found: np.fmax(worse(found), found[:, meets])  # noqa: E731
    every = np.broadcast_to(averages.distance.mean(1, keepdims=True), (count, len(limbs)))
    size = np.broadcast_to(_unusual(tracks), every.shape)
    log = lambda found, least: np.log(np.clip(found, least, 1.0))  # noqa: E731
    found = (
        log(worst(averages.beside), LEAST_SHARE),
        worse(averages.bare),
        log(every, LEAST_DISTANCE),
        size,
        np.log1p(np.maximum(worst(averages.inside), 0.0) / DEEP),
        np.maximum(worst(averages.beyond), 0.0) / np.radians(10),
        np.log(np.maximum(worst(averages.apart) / TOGETHER, 1.0)),
        np.log1p(PLENTY) - np.log1p(np.clip(averages.own[:, limbs], 0.0, PLENTY)),
    )
    return np.stack(found, -1)


class Averages(NamedTuple):
    """Misfits of limbs, averaged over a second around each frame."""

    beside: Float32[np.ndarray, "frame limb"]  # means, see Tracks
    distance: Float32[np.ndarray, "frame limb"]
    bare: Float32[np.ndarray, "frame limb"]
    inside: Float32[np.ndarray, "frame limb"]  # in other limbs, metres, mean
    beyond: Float32[np.ndarray, "frame limb"]  # of the joint towards the trunk, beyond its limits, radians, mean
    apart: Float32[np.ndarray, "frame limb"]  # passes, metres, the most; 0 where there was one
    own: Float32[np.ndarray, "frame limb"]  # weight of points that no other limb explains, mean

    def some(self, span: slice) -> "Averages":
        """The averages of some frames."""
        return Averages(*(each[span] for each in self))


def averages_of(tracks: Tracks, ahead: bool = True) -> Averages | None:
    """Averages of tracks; None if misfits are unknown. `ahead` as for `clues`."""
    seen = tracks.evidence
    beside, distance, bare, own = seen.limb_beside, seen.limb_distance, seen.limb_bare, seen.limb_own
    if beside is None or distance is None or bare is None or own is None:
        return None
    nothing = np.zeros(beside.shape, np.float32)
    known = lambda found: nothing if found is None else np.nan_to_num(found)  # noqa: E731
    beyond, apart = nothing.copy(), known(seen.passes_apart)
    if seen.beyond_limits is not None:
        beyond[:, np.array(tracks.body.topology.children, int)] = np.nan_to_num(seen.beyond_limits)
    return Averages(
        averaged(beside, ahead),
        averaged(distance, ahead),
        averaged(bare, ahead),
        averaged(known(seen.depth_inside), ahead),
        averaged(beyond, ahead),
        maximum_filter1d(apart, AROUND, 0) if len(apart) else apart,
        averaged(seen.limb_weight * np.nan_to_num(own), ahead),
    )


def meeting_limbs(body: Body) -> Int[np.ndarray, " joint"]:
    """The other limb of the joint nearest to each joint centre in the rest pose."""
    t, body = body.topology, on_host(body)
    limbs, parents = np.array(t.centre_limbs, int), np.array(t.parents, int)
    if not len(parents):
        return limbs
    at = joint_centres(body, body.rest)
    joints = apply(body.rest[parents], body.parent_anchor.translation)
    near = np.linalg.norm(at[:, None] - joints[None], axis=-1).argmin(1)
    children = np.array(t.children, int)[near]
    return np.where(parents[near] == limbs, children, parents[near])


def averaged(found: Float[np.ndarray, "frame limb"], ahead: bool) -> Float32[np.ndarray, "frame limb"]:
    """Mean over the known values of the AROUND frames around each, or of those before if not `ahead`."""
    origin = 0 if ahead else AROUND // 2  # the window ends with the frame
    mean = lambda x: uniform_filter1d(x.astype(float), AROUND, 0, mode="constant", origin=origin)  # noqa: E731
    out = np.full(found.shape, np.nan, np.float32)
    # one by one, if they are long: all at once take several times their memory
    columns = [EVERY] if len(found) <= BATCH else [slice(k, k + 1) for k in range(found.shape[1])]
    for some in columns:
        known = np.isfinite(found[:, some])
        total, count = mean(np.where(known, found[:, some], 0.0)), mean(known)
        out[:, some][known] = (total / np.maximum(count, 1e-9))[known]
    return out


def _unusual(tracks: Tracks) -> float:
    """Unusualness of the body's size: the squared number of standard deviations beyond USUAL."""
    if tracks.body.scale_name != "stature":
        return 0.0
    off = (float(tracks.body.scale) - STATURE) / STATURES
    return min(max(abs(off) - USUAL, 0.0), UNUSUAL if off > 0 else SMALL) ** 2


def facing_right(tracks: Tracks) -> Float[np.ndarray, "frame joint"]:
    """Probability that a joint is not wrong because of the body's facing: 1 for joints on the midline.

    Frames without odds get those of the last frame before, or of the next one.
    """
    sides = np.array([name.startswith(("l_", "r_")) for name in tracks.body.topology.centres])
    out = np.ones((len(tracks.status), len(sides)))
    facing = tracks.evidence.facing_odds
    if facing is None or not np.isfinite(facing).any():
        return out
    known = np.flatnonzero(np.isfinite(facing))
    at = known[np.maximum(np.searchsorted(known, np.arange(len(out)), "right") - 1, 0)]
    out[:, sides] = expit(facing[at].astype(float))[:, None]
    return out


def probability(trust: Trust, found: Float[np.ndarray, "... clue"]) -> Float[np.ndarray, "..."]:
    """The logistic function of some clues."""
    return expit(trust.constant + found[..., : len(trust.slopes)] @ np.array(trust.slopes))


def joint_confidence(tracks: Tracks, ahead: bool = True) -> Float32[np.ndarray, "frame joint"]:
    """Probability that a joint centre is within CLOSE of the true one; NaN in frames without points.

    **Arguments:** `ahead` as for `clues`.
    """
    averages, shape = averages_of(tracks, ahead), (len(tracks.status), len(tracks.body.topology.centres))
    sure = np.full(shape, np.nan)
    for at in range(0, shape[0], BATCH):
        span = slice(at, min(at + BATCH, shape[0]))
        around = slice(max(at - 1, 0), min(at + BATCH + 1, shape[0]))  # clues look at the frames beside each
        inner = slice(at - around.start, span.stop - around.start)
        found = clues(tracks.only(around), ahead)[inner]
        twice, once = probability(THERE_AND_BACK, found), probability(ONE_PASS, found)
        misfit = misfits(tracks.only(span), averages and averages.some(span))
        fits = probability(MATCHED_FITS if tracks.evidence.matched else FITS, misfit)
        sure[span] = np.where(np.isfinite(twice), twice, once) * np.where(np.isfinite(fits), fits, 1.0)
    answered = np.isin(tracks.status, (Status.TRACKED, Status.LOST))
    return np.where(answered[:, None], sure * facing_right(tracks), np.nan).astype(np.float32)
