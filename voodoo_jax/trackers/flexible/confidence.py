"""Confidence of the flexible tracker's joints: the probability that each is within 10 cm of the truth. Host side.

A logistic function of clues in neighbouring frames, fitted to rendered stereo recordings (experiments/stereo).
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.ndimage import uniform_filter1d
from scipy.special import expit

from voodoo_jax.records.tracks import Status, Tracks, expected_share
from voodoo_jax.trackers.flexible.filters import Seen
from voodoo_jax.trackers.flexible.flexible_body import CENTRES, LIMBS, POINTS

# logistic regression on the clues below, from experiments/stereo
CONSTANT, SLOPES = -19.709, (-1.134, -0.265, -0.825, 0.648, -1.073, -2.071, 2.948)
AROUND = 5  # frames over which clues are averaged; measured: single frames rank right above wrong joints less often
_FEW = 1e-3  # metres: smaller distances count as this, by hand


def clues(found: Seen, ahead: bool = True) -> Float[np.ndarray, "frame point clue"]:
    """Clues of each point of the body, averaged over some frames: logarithms of the particles' spread, of the distance
    of the points around it to the surface, and of the share of unexplained points; log(1 + number) of the points around
    it; logarithm of the hypotheses' standard deviation there, and its mean over the body; share of the limb at the
    measured depth.

    **Arguments:** `ahead` whether later frames may be used.
    """
    frames, depth = len(found.x), np.asarray(found.score.depth)
    spread, solid = np.empty((frames, 16)), np.empty((frames, 16))
    spread[:], solid[:] = np.asarray(found.spread)[:, :, 0].mean(1)[:, None], depth.mean(1)[:, None]
    spread[:, LIMBS.ravel()] = np.asarray(found.spread).reshape(frames, 12)
    solid[:, LIMBS.ravel()] = depth.repeat(3, 1)
    part = _assign_parts()
    off, support = np.asarray(found.off)[:, part], np.asarray(found.support)[:, part]
    unexplained = np.broadcast_to(1 - np.asarray(found.explained)[:, None], spread.shape)
    log = lambda a, least: np.log(np.maximum(a, least))  # noqa: E731
    wide = log(np.asarray(found.wide), _FEW)
    whole = np.broadcast_to(wide.mean(1, keepdims=True), wide.shape)
    each = [log(spread, _FEW), log(off, _FEW), log(unexplained, 0.01), np.log1p(support), wide, whole, solid]
    each = np.stack(each, -1)
    return uniform_filter1d(each, AROUND, 0, mode="nearest", origin=0 if ahead else AROUND // 2)


def _assign_parts() -> Int[np.ndarray, " point"]:
    """The part (see cylinders) whose measured points rate each point of the body."""
    out = np.full(16, 13)
    out[[0]], out[[8, 9, 10, 13]] = 12, 14
    for limb, (root, middle, end) in enumerate(LIMBS):
        out[middle], out[end] = 3 * limb + 1, 3 * limb + 1
        out[root] = 3 * limb
    return out


def rate_joints(tracks: Tracks, found: Seen, rows: Int[np.ndarray, " row"], least: float, ahead: bool = True) -> Tracks:
    """The tracks with the confidence of their joints, and LOST frames.

    **Arguments:** `found` results of the filters in the frames `rows` of the tracks; `least` expected share of correct
    joints below which a frame is LOST; `ahead` as for `clues`.
    """
    names = {centre: POINTS.index(name) for name, centre in CENTRES.items()}
    order = [names.get(name, -1) for name in tracks.body.topology.centres]
    each = expit(CONSTANT + clues(found, ahead) @ np.array(SLOPES)).astype(np.float32)
    each = np.where(np.array(order) >= 0, each[:, order], np.float32(np.nan))
    out: Float32[np.ndarray, "frame joint"] = np.full((len(tracks.time_ns), len(order)), np.nan, np.float32)
    out[rows] = each
    lost = (tracks.status == Status.TRACKED) & (expected_share(out) < least)
    return replace(tracks, joint_confidence=out, status=np.where(lost, Status.LOST, tracks.status).astype(np.int8))
