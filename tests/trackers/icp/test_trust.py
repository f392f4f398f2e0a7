"""How far tracks can be trusted: falls with every sign of trouble, is silent where nothing was measured."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.segments import blank_tracks
from voodoo_jax.model.body_file import human
from voodoo_jax.records.tracks import Status, Tracks, expected_share
from voodoo_jax.trackers.icp.confidence import (
    ONE_PASS,
    THERE_AND_BACK,
    UNMARKED,
    clues,
    doubted,
    joint_confidence,
    marker_confidence,
    probability,
)

BODY = human()
TOPOLOGY = BODY.topology
CENTRES, LIMBS = len(TOPOLOGY.centres), len(TOPOLOGY.limbs)


def good_tracks(frames: int = 6, scale: float = 1.0, step: float = 0.01) -> Tracks:
    """A good track; larger `scale`: everything is so much worse. `step` metres that joints move from frame to frame."""
    variance = ((0.02 * scale) ** 2 * np.eye(3)).astype(np.float32)
    moved = step * np.arange(frames)[:, None, None] * np.array([1.0, 0, 0])
    return blank_tracks(
        BODY,
        frames,
        joints=np.broadcast_to(moved, (frames, CENTRES, 3)).astype(np.float32),
        joint_covariance=np.broadcast_to(variance, (frames, CENTRES, 3, 3)),
        residual=np.full(frames, 0.015 * scale, np.float32),
        explained=np.full(frames, 1 - 0.02 * scale, np.float32),
        limb_weight=np.full((frames, LIMBS), 40.0, np.float32),
        passes_apart=np.full((frames, LIMBS), 0.02 * scale, np.float32),
        status=np.full(frames, Status.TRACKED, np.int8),
    )


def test_a_good_track_is_trusted_and_a_bad_one_is_not():
    good, bad = (joint_confidence(good_tracks(scale=s)) for s in (1.0, 8.0))
    assert good.shape == (6, CENTRES) and good.dtype == np.float32
    assert good.min() > 0.95 and bad.max() < 0.2


@pytest.mark.parametrize("worse", ["joint_covariance", "residual", "explained", "passes_apart", "limb_weight", "moved"])
def test_every_sign_of_trouble_counts(worse):
    fine = joint_confidence(good_tracks())
    if worse == "moved":
        changed = good_tracks(step=0.1)
    elif worse == "limb_weight":
        changed = replace(good_tracks(), limb_weight=np.zeros((6, LIMBS), np.float32))
    else:
        changed = replace(good_tracks(), **{worse: getattr(good_tracks(scale=3.0), worse)})
    assert (joint_confidence(changed) < fine).all()


def test_one_pass_is_enough_and_nothing_measured_says_nothing():
    found = replace(good_tracks(), passes_apart=np.full((6, LIMBS), np.nan, np.float32))
    once = joint_confidence(found)
    expected = probability(ONE_PASS, clues(found))
    np.testing.assert_allclose(once, expected, rtol=1e-6)
    assert len(ONE_PASS.slopes) == len(THERE_AND_BACK.slopes) - 1
    found.status[2:4] = Status.NO_DATA, Status.FEATURES
    found.residual[2] = np.nan
    some = joint_confidence(found)
    assert np.isnan(some[2:4]).all() and np.isfinite(some[[0, 1, 4, 5]]).all()
    assert np.isnan(expected_share(some)[2:4]).all()


def test_little_is_said_of_joints_on_limbs_without_a_marker():
    bare = TOPOLOGY.limbs.index("l_shank")
    found = replace(good_tracks(), limb_weight=np.full((6, LIMBS), 2.0, np.float32))
    found.limb_weight[3:, bare] = 0.0
    found.status[5] = Status.NO_DATA
    plain, said = joint_confidence(found), marker_confidence(found)
    on = np.array(TOPOLOGY.centre_limbs) == bare
    assert on.any() and (plain[3:5] > UNMARKED).all() and said.dtype == np.float32
    np.testing.assert_array_equal(said[3:5][:, on], np.float32(UNMARKED))
    np.testing.assert_array_equal(said[3:][:, ~on], plain[3:][:, ~on])
    np.testing.assert_array_equal(said[:3], plain[:3])
    assert np.isnan(said[5]).all()


@pytest.mark.parametrize("frames", [0, 1])
def test_hardly_any_frames(frames):
    assert joint_confidence(good_tracks(frames)).shape == (frames, CENTRES)


def test_joints_without_a_word_do_not_count():
    np.testing.assert_allclose(expected_share(np.array([[0.5, np.nan, 1.0]], np.float32)), [0.75])


def test_where_hardly_a_joint_is_right_the_body_is_lost():
    status = np.array([Status.TRACKED, Status.TRACKED, Status.LOST, Status.NO_DATA], np.int8)
    confidence = np.array([[0.9, 0.8], [0.3, 0.2], [0.9, 0.9], [np.nan, np.nan]], np.float32)
    expected = [Status.TRACKED, Status.LOST, Status.LOST, Status.NO_DATA]
    assert doubted(status, confidence, 0.4).tolist() == expected
    assert doubted(status, confidence, 0.0).tolist() == status.tolist()
