"""Decides whether a tracked body is a person, and rates the confidence of its joints. Host side, NumPy.

It uses the probabilities of shared/confidence.py to mark frames as LOST.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Int8, Int64

from voodoo_jax.records.tracks import Status, Tracks, expected_share
from voodoo_jax.trackers.shared.confidence import joint_confidence

# a person is there if, for so many seconds in a row, this was expected of the better half of the joints (of those
# cut off or behind an object the others are hidden): measured, 0.60 at most for curtains, doors, robots and trolleys
# that move, 0.66 at least for people who are less than 10 cm off. A dummy on a trolley had 0.70
CONFIRMED, LONG = 0.63, 1.0


def rate_joints(tracks: Tracks, least: float, ahead: bool = True) -> Tracks:
    """The tracks with the confidence of their joints; LOST in frames with less than the share `least` of right joints,
    and in all frames without certainty of a person (see confirmed; only if `ahead`).

    **Arguments:** `ahead` as for `clues`.
    """
    confidence = joint_confidence(tracks, ahead)
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
