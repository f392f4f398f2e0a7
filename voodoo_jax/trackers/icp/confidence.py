"""Decides whether a tracked body is a person, and rates the confidence of its joints. Host side, NumPy.

It uses the probabilities of shared/confidence.py to mark frames as LOST.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float32, Int8, Int64

from voodoo_jax.records.tracks import Status, Tracks, expected_share
from voodoo_jax.trackers.shared.confidence import UNMARKED, averaged, joint_confidence

# somebody is there if once, for so many seconds on end, this was expected of the better half of the joints (of who is
# cut off or behind something the others are hidden): measured, 0.60 at most for curtains, doors, robots and trolleys
# that move, 0.66 at least for people who are less than 10 cm off. A dummy on a trolley had 0.70
CONFIRMED, LONG = 0.63, 1.0
# metres between hips and ankles above them, over a second: with a knee below the hip and an upright trunk nobody holds
# both legs so. Of 235 logs of all kinds one did: its legs were on the back of a chair, behind a desk; by hand
HEELS_UP = 0.05


def legs_folded_up(tracks: Tracks, ahead: bool = True) -> Bool[np.ndarray, "frame joint"]:
    """Knees and ankles of legs in an impossible pose: upright, with both ankles above the hips (HEELS_UP) and the knees
    below.

    They are fitted to furniture that hides the true ones.

    **Arguments:** `ahead` as for `clues`.
    """
    names = tracks.body.topology.centres
    out = np.zeros((len(tracks.status), len(names)), bool)
    wanted = ["vc7", *(f"{side}_{joint}" for side in "lr" for joint in ("hip", "knee", "talocrural"))]
    if tracks.up is None or not {*wanted} <= {*names}:
        return out
    at = [names.index(name) for name in wanted]
    neck, *legs = averaged(tracks.joints[:, at].astype(float) @ tracks.up, ahead).T
    (hip, knee, ankle), (hip2, knee2, ankle2) = legs[:3], legs[3:]
    high = np.minimum(ankle, ankle2) - np.maximum(hip, hip2) > HEELS_UP
    out[np.ix_(high & (knee < hip) & (knee2 < hip2) & (neck > ankle) & (neck > ankle2), at[2:4] + at[5:7])] = True
    return out


def rate_joints(tracks: Tracks, least: float, ahead: bool = True) -> Tracks:
    """The tracks with the confidence of their joints; LOST in frames with less than the share `least` of right joints,
    and in all frames without certainty of a person (see confirmed; only if `ahead`).

    **Arguments:** `ahead` as for `clues`.
    """
    confidence = joint_confidence(tracks, ahead)
    confidence = np.where(legs_folded_up(tracks, ahead), np.minimum(confidence, np.float32(UNMARKED)), confidence)
    never = ahead and least > 0 and not confirmed(tracks.time_ns, confidence)
    status = mark_lost(tracks.status, confidence, np.inf if never else least)
    return replace(tracks, joint_confidence=confidence, status=status)


def confirmed(time_ns: Int64[np.ndarray, " frame"], confidence: Float32[np.ndarray, "frame joint"]) -> bool:
    """Whether it was ever certain that a person is tracked: for LONG successive seconds, or the whole recording if it
    is shorter, the better half of the joints had a confidence of at least CONFIRMED."""
    joints = np.sort(np.nan_to_num(confidence), 1)
    share = joints[:, joints.shape[1] // 2 :].mean(1, dtype=float)
    if not len(share):
        return False
    frames = round(LONG * 1e9 / max(float(np.median(np.diff(time_ns))), 1.0)) if len(share) > 1 else 1
    frames = min(max(frames, 1), len(share))
    total = np.concatenate([[0.0], np.cumsum(share)])
    return bool(np.max(total[frames:] - total[:-frames]) >= CONFIRMED * frames)


def mark_lost(
    status: Int8[np.ndarray, " frame"], confidence: Float32[np.ndarray, "frame joint"], least: float
) -> Int8[np.ndarray, " frame"]:
    """Status, LOST in frames in which less than the share `least` of the joints is expected to be right."""
    lost = (status == Status.TRACKED) & (expected_share(confidence) < least)
    return np.where(lost, Status.LOST, status).astype(np.int8)
