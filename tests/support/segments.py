"""Segments and tracks of which only some arrays matter."""

from dataclasses import replace

import numpy as np

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import Body
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Evidence, Status, Tracks


def tracked_segment(poses: Poses, **arrays: np.ndarray) -> Segment:
    """A segment from frame 0 on, tracked in these poses [frame, limb] at a cost of 1; other arrays as given."""
    count, limbs = np.shape(poses.translation)[:2]
    known = {"status": np.full(count, Status.TRACKED, np.int8), "cost": np.ones(count)}
    known |= {"limb_weight": np.ones((count, limbs), np.float32)}
    known |= {"rotation": np.array(poses.rotation), "translation": np.array(poses.translation)}
    return replace(Segment.blank(count, limbs), **known | arrays)


def blank_tracks(body: Body, count: int, **arrays: np.ndarray) -> Tracks:
    """Tracks of so many frames in which nothing is tracked; other arrays as given."""
    s, t, nan = Segment.blank(count, body.limb_count), body.topology, np.float32(np.nan)
    known = {
        "passes_apart": s.passes_apart,
        "joints": np.full((count, len(t.centres), 3), nan),
        "beyond_limits": np.full((count, len(t.joints)), nan),
        "depth_inside": np.full((count, body.limb_count), nan),
        "joint_covariance": np.full((count, len(t.centres), 3, 3), nan),
    }
    tracks = Tracks(
        "log.mcap", "base", body, np.arange(count), s.rotation, s.translation, known["joints"], s.status,
        Evidence.blank(count, body.limb_count),
    )  # fmt: skip
    return tracks.having(**known | arrays)
