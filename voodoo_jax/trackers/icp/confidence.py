"""How far tracks can be trusted: the probability that a joint's centre is within 10 cm of the true one. Host side.

A logistic function of what a frame says of itself, fitted to recordings with known truth, as they are and made harder
(fewer frames, noise, coarse distances, begun midway), by experiments/trust. There, with the numbers of one half of the
people, the other half's joints are right as often as is said; what it does not see is a body that faces the wrong way.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int8
from scipy.special import expit

from voodoo_jax.records.tracks import Status, Tracks, expected_share

CLOSE = 0.10  # metres
CLUES = ("spread", "residual", "unexplained", "moved", "weight", "apart")
# of a joint whose limb no marker tells of: nothing of a frame shows how far it hangs off. Of knees and ankles in a walk
# on a treadmill 12 % were within 10 cm, of joints of a recording without its legs', arms' or shanks' markers 39 %
UNMARKED = 0.1


class Trust(NamedTuple):
    """Numbers of the logistic function: of a change of a clue by one, see `clues`."""

    constant: float
    slopes: tuple[float, ...]


# from experiments/trust
THERE_AND_BACK = Trust(-13.527, (-2.262, -1.144, -0.308, -0.269, 0.013, -1.162))
ONE_PASS = Trust(-11.546, (-2.840, -0.021, -0.607, -0.529, 0.173))


def clues(tracks: Tracks, ahead: bool = True) -> Float[np.ndarray, "frame joint clue"]:
    """What tells of trouble, of each joint centre: logarithms of how far off it may be by its covariance, of the
    frame's residual and share of unexplained points, of how far it moves between frames and of how far the passes there
    and back in time are apart (all in metres), and log(1 + weight) of what was measured of its limb.

    **Arguments:** `ahead` whether the frame after each may be looked at, too.

    The last clue is NaN where there was one pass only.
    """
    assert tracks.joint_covariance is not None and tracks.passes_apart is not None
    joints, limbs = tracks.joints, np.array(tracks.body.topology.centre_limbs, int)
    step = np.linalg.norm(np.diff(joints, axis=0), axis=-1)
    still = np.zeros((1, joints.shape[1]))
    before, after = np.concatenate([still, step]), np.concatenate([step, still])
    moved = (np.fmax(before, after) if ahead else before)[: len(joints)]
    spread = np.sqrt(np.trace(tracks.joint_covariance, axis1=2, axis2=3))
    log = lambda found, least, most: np.log(np.clip(found, least, most))  # noqa: E731
    each = lambda row: np.broadcast_to(row[:, None], moved.shape)  # noqa: E731
    found = (
        log(spread, 1e-3, 10.0),
        each(log(tracks.residual, 0.003, 1.0)),
        each(log(1 - tracks.explained, 0.003, 1.0)),
        log(moved, 0.003, 1.0),
        np.log1p(tracks.limb_weight[:, limbs]),
        log(tracks.passes_apart[:, limbs], 0.005, 1.0),
    )
    return np.stack(found, -1)


def probability(trust: Trust, found: Float[np.ndarray, "... clue"]) -> Float[np.ndarray, "..."]:
    """The logistic function of some clues."""
    return expit(trust.constant + found[..., : len(trust.slopes)] @ np.array(trust.slopes))


def joint_confidence(tracks: Tracks, ahead: bool = True) -> Float32[np.ndarray, "frame joint"]:
    """Probability that a joint centre is within CLOSE of the true one; NaN in frames without points.

    **Arguments:** `ahead` as for `clues`.
    """
    found = clues(tracks, ahead)
    twice, once = probability(THERE_AND_BACK, found), probability(ONE_PASS, found)
    told = np.isin(tracks.status, (Status.TRACKED, Status.LOST))
    return np.where(told[:, None], np.where(np.isfinite(twice), twice, once), np.nan).astype(np.float32)


def marker_confidence(tracks: Tracks, ahead: bool = True) -> Float32[np.ndarray, "frame joint"]:
    """As joint_confidence, for recordings of named points alone, whose `limb_weight` is the number of those near their
    places on each limb.

    The logistic function was fitted to depth and is too sure of limbs without any: at most UNMARKED is said of a joint
    whose own limb has none in the frame, even if a neighbour's markers hold it.
    """
    found = joint_confidence(tracks, ahead)
    unmarked = tracks.limb_weight[:, np.array(tracks.body.topology.centre_limbs, int)] <= 0
    # not np.fmin: where there is none, there is none
    return np.where(unmarked, np.minimum(found, np.float32(UNMARKED)), found)


def rated(tracks: Tracks, least: float, ahead: bool = True, by_markers: bool = False) -> Tracks:
    """The tracks with the confidence of their joints; LOST where fewer than the share `least` of them are expected to
    be right. By markers alone nothing is LOST for that: a set for legs alone is none to doubt as a whole.

    **Arguments:** `ahead` as for `clues`.
    """
    if by_markers:
        return replace(tracks, joint_confidence=marker_confidence(tracks, ahead))
    confidence = joint_confidence(tracks, ahead)
    return replace(tracks, joint_confidence=confidence, status=doubted(tracks.status, confidence, least))


def doubted(
    status: Int8[np.ndarray, " frame"], confidence: Float32[np.ndarray, "frame joint"], least: float
) -> Int8[np.ndarray, " frame"]:
    """Status, LOST where fewer than the share `least` of the joints are expected to be right."""
    lost = (status == Status.TRACKED) & (expected_share(confidence) < least)
    return np.where(lost, Status.LOST, status).astype(np.int8)
