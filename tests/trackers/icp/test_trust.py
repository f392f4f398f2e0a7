"""How far tracks can be trusted: falls with every sign of trouble, is silent where nothing was measured."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from tests.support.segments import blank_tracks
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.records.tracks import Status, Tracks, expected_share
from voodoo_jax.trackers.icp.confidence import confirmed, mark_lost, rate_joints
from voodoo_jax.trackers.markers.tracker import marker_confidence
from voodoo_jax.trackers.shared.confidence import (
    BATCH,
    ONE_PASS,
    THERE_AND_BACK,
    UNMARKED,
    averaged,
    clues,
    facing_right,
    joint_confidence,
    probability,
)

BODY = human()
TOPOLOGY = BODY.topology
CENTRES, LIMBS = len(TOPOLOGY.centres), len(TOPOLOGY.limbs)


def good_tracks(frames: int = 6, scale: float = 1.0, step: float = 0.01) -> Tracks:
    """A good track; larger `scale`: everything is so much worse. `step` metres that joints move from frame to frame."""
    variance = ((0.02 * scale) ** 2 * np.diag([0, 0, 0, 1, 1, 1])).astype(np.float32)
    moved = step * np.arange(frames)[:, None, None] * np.array([1.0, 0, 0])
    return blank_tracks(
        BODY,
        frames,
        joints=np.broadcast_to(moved, (frames, CENTRES, 3)).astype(np.float32),
        limb_covariance=np.broadcast_to(variance, (frames, LIMBS, 6, 6)),
        residual=np.full(frames, 0.015 * scale, np.float32),
        explained=np.full(frames, 1 - 0.02 * scale, np.float32),
        limb_weight=np.full((frames, LIMBS), 40.0, np.float32),
        passes_apart=np.full((frames, LIMBS), 0.02 * scale, np.float32),
        status=np.full(frames, Status.TRACKED, np.int8),
    )


def test_long_tracks_are_rated_in_batches():
    """The same as all at once, and little more memory than what is returned."""
    rng, count = np.random.default_rng(3), 2 * BATCH + 50
    found = replace(fitting(count), joints=rng.normal(size=(count, CENTRES, 3)).astype(np.float32).cumsum(0) / 100)
    at = BATCH - 40
    part = np.s_[at : at + 80]
    said = joint_confidence(found)
    np.testing.assert_array_equal(joint_confidence(found.only(part))[20:60], said[part][20:60])
    peaks = []
    for frames in (count, 2 * count):
        tracks = fitting(frames)
        tracemalloc.start()
        joint_confidence(tracks)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / count < 700


def test_a_good_track_is_trusted_and_a_bad_one_is_not():
    good, bad = (joint_confidence(good_tracks(scale=s)) for s in (1.0, 8.0))
    assert good.shape == (6, CENTRES) and good.dtype == np.float32
    assert good.min() > 0.95 and bad.max() < 0.2


@pytest.mark.parametrize("worse", ["limb_covariance", "residual", "explained", "passes_apart", "limb_weight", "moved"])
def test_every_sign_of_trouble_counts(worse):
    fine = joint_confidence(good_tracks())
    if worse == "moved":
        changed = good_tracks(step=0.1)
    elif worse == "limb_weight":
        changed = good_tracks().having(limb_weight=np.zeros((6, LIMBS), np.float32))
    else:
        changed = good_tracks().having(**{worse: good_tracks(scale=3.0).rows()[worse]})
    assert (joint_confidence(changed) < fine).all()


def test_one_pass_is_enough_and_nothing_measured_says_nothing():
    found = good_tracks().having(passes_apart=np.full((6, LIMBS), np.nan, np.float32))
    once = joint_confidence(found)
    expected = probability(ONE_PASS, clues(found))
    np.testing.assert_allclose(once, expected, rtol=1e-6)
    assert len(ONE_PASS.slopes) == len(THERE_AND_BACK.slopes) - 1
    found.status[2:4] = Status.NO_DATA, Status.FEATURES
    found.evidence.residual[2] = np.nan
    some = joint_confidence(found)
    assert np.isnan(some[2:4]).all() and np.isfinite(some[[0, 1, 4, 5]]).all()
    assert np.isnan(expected_share(some)[2:4]).all()


def test_little_is_said_of_joints_on_limbs_without_a_marker():
    bare = TOPOLOGY.limbs.index("l_shank")
    found = good_tracks().having(limb_weight=np.full((6, LIMBS), 2.0, np.float32))
    found.evidence.limb_weight[3:, bare] = 0.0
    found.status[5] = Status.NO_DATA
    plain, said = joint_confidence(found), marker_confidence(found)
    on = np.array(TOPOLOGY.centre_limbs) == bare
    assert on.any() and (plain[3:5] > UNMARKED).all() and said.dtype == np.float32
    np.testing.assert_array_equal(said[3:5][:, on], np.float32(UNMARKED))
    np.testing.assert_array_equal(said[3:][:, ~on], plain[3:][:, ~on])
    np.testing.assert_array_equal(said[:3], plain[:3])
    assert np.isnan(said[5]).all()


def fitting(frames: int = 6, scale: float = 1.0) -> Tracks:
    """A good track of which it is known how well limbs fit; larger `scale`: so much worse."""
    shape = (frames, LIMBS)
    known = {"limb_beside": 0.02, "limb_distance": 0.008, "limb_bare": 0.03}
    fit = {name: np.full(shape, scale * value, np.float32) for name, value in known.items()}
    return good_tracks(frames).having(limb_own=np.ones(shape, np.float32), **fit)


@pytest.mark.parametrize("worse", ["limb_beside", "limb_distance", "limb_bare", "size"])
def test_what_does_not_fit_is_not_trusted(worse):
    fine, bad = fitting(), fitting(scale=15.0)
    plain, said = joint_confidence(good_tracks()), joint_confidence(fine)
    assert (said > plain - 0.02).all() and (said <= plain).all()  # at home it makes no difference
    if worse == "size":
        changed = replace(fine, body=scaled(BODY, 1.25))
    else:
        changed = fine.having(**{worse: bad.rows()[worse]})
    assert (joint_confidence(changed) < said - 0.005).all()
    assert joint_confidence(bad).max() < 0.1


def test_a_child_is_no_misfit_and_a_giant_is():
    said = joint_confidence(fitting())
    child, giant = (joint_confidence(replace(fitting(), body=scaled(BODY, s))) for s in (1.15, 2.25))
    assert (child < said).all() and child.min() > 0.9 and giant.max() < 0.4


@pytest.mark.parametrize("worse", ["limb_beside", "depth_inside", "passes_apart"])
def test_what_is_wrong_with_a_thigh_is_said_of_the_joints_where_it_ends(worse):
    """Of its hip, too, whose centre is the pelvis'; points apart are so for half a second before and after."""
    found = fitting(40).having(depth_inside=np.zeros((40, LIMBS), np.float32))
    said = joint_confidence(found)
    changed = found.rows()[worse].copy()
    changed[:4, TOPOLOGY.limbs.index("l_thigh")] = 0.9
    lower = joint_confidence(found.having(**{worse: changed})) < said - 0.01
    first = dict(zip(TOPOLOGY.centres, lower[:4].all(0)))
    assert first["l_hip"] and first["l_knee"] and not first["r_hip"] and not first["l_elbow"]
    assert not lower[20:].any()


def test_joints_beyond_their_limits_are_doubted():
    beyond = np.zeros((6, len(TOPOLOGY.joints)), np.float32)
    found = fitting().having(beyond_limits=beyond)
    said = joint_confidence(found)[3]
    beyond[:, TOPOLOGY.joints.index("r_elbow")] = np.radians(40)
    lower = dict(zip(TOPOLOGY.centres, joint_confidence(found)[3] < said - 0.005))
    assert lower["r_elbow"] and lower["r_radiocarpal"] and not lower["l_elbow"] and not lower["r_knee"]


def test_a_limb_alone_that_is_bare_is_doubted_alone():
    found = fitting()
    found.evidence.limb_bare[:, TOPOLOGY.limbs.index("l_shank")] = 1.0
    said, fine = joint_confidence(found)[3], joint_confidence(fitting())[3]
    lower = dict(zip(TOPOLOGY.centres, said < fine - 0.05))
    assert lower["l_talocrural"] and not lower["r_talocrural"] and not lower["l_elbow"] and not lower["skullbase"]


def test_a_limb_whose_points_are_another_ones_is_doubted_alone():
    """As one that explains no points at all; nothing else tells of it."""
    forearm, fine = TOPOLOGY.limbs.index("r_forearm"), joint_confidence(fitting())[3]
    for own in (0.0, np.nan):
        found = fitting()
        found.evidence.limb_own[:, forearm] = own
        lower = dict(zip(TOPOLOGY.centres, joint_confidence(found)[3] < fine - 0.005))
        assert lower["r_elbow"] and lower["r_radiocarpal"] and sum(lower.values()) == 2


def test_misfit_is_averaged_over_a_second_and_online_over_what_was_before():
    late = np.zeros((60, LIMBS), np.float32)
    late[40:] = 0.5
    late[50] = np.nan
    both, before = averaged(late, True)[:, 0], averaged(late, False)[:, 0]
    assert both[30] > 0 and before[39] == 0 < before[41] and np.isnan([both[50], before[50]]).all()
    assert both[-1] == pytest.approx(0.5) and (np.diff(before[39:50]) > 0).all()


def test_who_may_face_the_other_way_is_not_trusted_but_for_joints_in_the_middle():
    odds = np.array([np.nan, 0.0, np.nan, 5.0, np.nan, np.nan], np.float32)
    right = facing_right(good_tracks().having(facing_odds=odds))
    sides = np.array([name[:2] in ("l_", "r_") for name in TOPOLOGY.centres])
    np.testing.assert_allclose(right[:3][:, sides], 0.5)  # the next answer, and the last one
    assert (right[3:][:, sides] > 0.99).all() and (right[:, ~sides] == 1).all() and (~sides).sum() == 2
    assert (facing_right(good_tracks()) == 1).all()
    doubtful = joint_confidence(fitting().having(facing_odds=odds))
    assert (doubtful[1, sides] < 0.51).all() and (doubtful[1, ~sides] > 0.9).all()


@pytest.mark.parametrize("frames", [0, 1])
def test_hardly_any_frames(frames):
    assert joint_confidence(good_tracks(frames)).shape == (frames, CENTRES)


def test_joints_without_a_word_do_not_count():
    np.testing.assert_allclose(expected_share(np.array([[0.5, np.nan, 1.0]], np.float32)), [0.75])


def test_where_hardly_a_joint_is_right_the_body_is_lost():
    status = np.array([Status.TRACKED, Status.TRACKED, Status.LOST, Status.NO_DATA], np.int8)
    confidence = np.array([[0.9, 0.8], [0.3, 0.2], [0.9, 0.9], [np.nan, np.nan]], np.float32)
    expected = [Status.TRACKED, Status.LOST, Status.LOST, Status.NO_DATA]
    assert mark_lost(status, confidence, 0.4).tolist() == expected
    assert mark_lost(status, confidence, 0.0).tolist() == status.tolist()


def test_who_was_never_surely_there_is_nobody():
    time = np.arange(90) * 33_333_333
    said = np.full((90, 14), 0.3, np.float32)
    assert not confirmed(time, said) and not confirmed(time[:0], said[:0])
    said[20:30, :7] = 0.99  # a third of a second
    assert not confirmed(time, said) and confirmed(time[20:30], said[20:30])  # or all that there is
    said[20:52, :7] = 0.99  # the upper body of who is cut off
    assert confirmed(time, said)
    said[30:42] = np.nan
    assert not confirmed(time, said)


def test_where_nobody_was_sure_nothing_is_tracked():
    unsure = good_tracks(60, 5.0, 0.0)
    share = expected_share(joint_confidence(unsure))
    assert 0.4 < share.min() and share.max() < 0.8
    assert (rate_joints(unsure, 0.4).status == Status.LOST).all()
    assert rate_joints(unsure, 0.4, ahead=False).tracked.all() and rate_joints(unsure, 0.0).tracked.all()
    assert rate_joints(good_tracks(60), 0.4).tracked.all()
