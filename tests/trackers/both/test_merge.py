"""Merging tracks of both trackers: properties that hold whatever the two say."""

from dataclasses import replace

import numpy as np
import pytest

import voodoo_jax as vj
from voodoo_jax.geometry.rotations import rotations
from voodoo_jax.model.body import joint_centres, scaled
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.tracks import Evidence, Status, Tracks
from voodoo_jax.trackers.both.merge import CHAINS, ERRS, THEIRS, chosen, hung, merged, posed

FRAMES = 40


def tracks_at_rest(sure: float = 0.9) -> Tracks:
    """A person who stands there."""
    body = scaled(vj.human(), 1.75)
    rest, limbs, centres = body.rest, body.limb_count, len(body.topology.centres)
    each = lambda a: np.repeat(np.asarray(a, np.float32)[None], FRAMES, 0)  # noqa: E731
    return Tracks(
        "", "world", body, np.arange(FRAMES) * 66_666_667, each(rest.rotation), each(rest.translation),
        each(joint_centres(body, rest)), np.full(FRAMES, Status.TRACKED, np.int8),
        Evidence.blank(FRAMES, limbs),
        limb_covariance=each(np.broadcast_to(1e-4 * np.eye(6), (limbs, 6, 6))),
        joint_covariance=each(np.broadcast_to(1e-4 * np.eye(3), (centres, 3, 3))),
        joint_confidence=np.full((FRAMES, centres), sure, np.float32),
    )  # fmt: skip


def rows(tracks: Tracks, chain: int) -> list[int]:
    return [tracks.body.topology.centres.index(name) for name in CHAINS[chain]]


def moved(tracks: Tracks, chain: int, angle: float, frames: slice = slice(None), sure: float = 0.9) -> Tracks:
    """With an arm or leg turned about its root (radians, about the x axis), and with another confidence there."""
    turn = rotations(np.array([np.cos(angle / 2), np.sin(angle / 2), 0, 0]))
    at, joints, said = rows(tracks, chain), tracks.joints.copy(), tracks.joint_confidence.copy()
    root = joints[frames, at[0]]
    for row in at[1:]:
        joints[frames, row] = root + turn.apply(joints[frames, row] - root)
        said[frames, row] = sure
    rotation, translation = tracks.rotation.copy(), tracks.translation.copy()
    parts = ("upper_arm", "forearm", "hand") if chain < 2 else ("thigh", "shank", "foot")
    for part in parts:
        n = tracks.body.topology.limbs.index(f"{'lr'[chain % 2]}_{part}")
        rotation[frames, n] = (turn * rotations(rotation[frames, n])).as_quat(scalar_first=True)
        translation[frames, n] = root + turn.apply(translation[frames, n] - root)
    return replace(tracks, joints=joints, joint_confidence=said, rotation=rotation, translation=translation)


def lengths(tracks: Tracks, joints: np.ndarray) -> np.ndarray:
    """Of the bones of all arms and legs."""
    bones = [(rows(tracks, k)[i], rows(tracks, k)[i + 1]) for k in range(4) for i in range(2)]
    return np.stack([np.linalg.norm(joints[:, b] - joints[:, a], axis=-1) for a, b in bones], 1)


def test_of_two_that_are_the_same_nothing_changes():
    one = tracks_at_rest()
    choice = chosen(one, one)
    np.testing.assert_allclose(choice.share, THEIRS, atol=1e-3)
    joints = hung(one, one, choice.share)
    np.testing.assert_allclose(joints, one.joints, atol=1e-6)
    rotation, translation = posed(one, one, choice.share, joints)
    np.testing.assert_allclose(np.abs(np.sum(rotation * one.rotation, -1)), 1, atol=1e-6)
    np.testing.assert_allclose(translation, one.translation, atol=1e-5)


@pytest.mark.parametrize("chain", range(4))
@pytest.mark.parametrize("angle", (0.05, 0.15, 0.4, 1.0, 2.0))
@pytest.mark.parametrize("sure", (0.3, 0.9, 0.99))
def test_bones_keep_their_lengths_and_joints_stay_on_their_limbs(chain, angle, sure):
    one, limbs = tracks_at_rest(), moved(tracks_at_rest(), chain, angle, sure=sure)
    for icp, flexible in ((one, limbs), (limbs, one)):
        share = chosen(icp, flexible).share
        joints = hung(icp, flexible, share)
        np.testing.assert_allclose(lengths(icp, joints), lengths(icp, icp.joints), rtol=1e-4)
        rotation, translation = posed(icp, flexible, share, joints)
        t = icp.body.topology
        for row, limb in enumerate(t.centre_limbs):
            place = rotations(rotation[:, limb]).apply(np.asarray(icp.body.centres)[row]) + translation[:, limb]
            np.testing.assert_allclose(place, joints[:, row], atol=2e-3)


def test_a_limb_is_whose_confidence_is_higher_and_a_mean_where_both_agree():
    icp = tracks_at_rest(0.7)
    end = rows(icp, 0)[-1]
    near, far = moved(icp, 0, 0.1, sure=0.7), moved(icp, 0, 1.5, sure=0.7)
    apart = lambda joints, other: np.linalg.norm(joints[:, end] - other.joints[:, end], axis=-1)  # noqa: E731
    assert (apart(near.joints, icp) < 2 * np.hypot(*ERRS)).all() and (apart(far.joints, icp) > 0.2).all()
    mean = hung(icp, near, chosen(icp, near).share)
    np.testing.assert_allclose((1 - THEIRS) * apart(mean, icp), THEIRS * apart(mean, near), rtol=0.05)
    for sure, taken in ((0.65, icp), (0.95, far)):
        other = moved(icp, 0, 1.5, sure=sure)
        np.testing.assert_allclose(apart(hung(icp, other, chosen(icp, other).share), taken), 0, atol=2e-3)
    # nor does one limb move another one
    rest = [row for row in range(icp.joints.shape[1]) if row not in rows(icp, 0)[1:]]
    np.testing.assert_allclose(hung(icp, far, chosen(icp, far).share)[:, rest], icp.joints[:, rest], atol=1e-3)


def test_one_frame_does_not_make_a_limb_jump_there_and_back():
    icp = tracks_at_rest(0.7)
    other = moved(icp, 0, 1.5, slice(20, 21), sure=0.99)
    np.testing.assert_allclose(hung(icp, other, chosen(icp, other).share), icp.joints, atol=0.03)


def test_who_may_not_look_ahead_does_not():
    icp = tracks_at_rest(0.7)
    late = moved(icp, 0, 1.5, slice(20, None), sure=0.99)
    early = chosen(icp, late, ahead=False).share[:20]
    np.testing.assert_allclose(early, chosen(icp, icp, ahead=False).share[:20])
    assert not np.allclose(early, chosen(icp, late).share[:20])


def test_a_body_that_faces_the_other_way_is_taken_whole_or_not_at_all():
    icp = tracks_at_rest(0.7)
    half = np.array([0.0, 0.0, 0.0, 1.0])
    turn = rotations(half)
    t, centre = icp.body.topology, icp.joints[0, [rows(icp, 2)[0], rows(icp, 3)[0]]].mean(0) * [1, 1, 0]
    about = lambda at: (turn.apply(at.reshape(-1, 3) - centre) + centre).reshape(at.shape)  # noqa: E731
    spun = (turn * rotations(icp.rotation)).as_quat(scalar_first=True).reshape(icp.rotation.shape).astype(np.float32)
    back = replace(icp, joints=about(icp.joints), translation=about(icp.translation), rotation=spun)
    for sure, taken in ((0.65, icp), (0.95, back)):
        other = replace(back, joint_confidence=np.full_like(icp.joint_confidence, sure))
        share = chosen(icp, other).share
        joints = hung(icp, other, share)
        sided = [k for k, name in enumerate(t.centres) if name.startswith(("l_", "r_"))]
        np.testing.assert_allclose(joints[:, sided], taken.joints[:, sided], atol=1e-3)


def test_confidence_is_less_the_farther_both_are_apart_and_covariances_are_covariances():
    icp = tracks_at_rest(0.9)
    end, said, wide = rows(icp, 0)[-1], [], []
    for angle in (0.05, 0.2, 0.3, 1.5):
        other = moved(icp, 0, angle, sure=0.9)
        choice = chosen(icp, other)
        said.append(choice.right[0, end])
        found = merged(icp, other, [seen_of(icp)] * FRAMES, 0.4, 128)
        assert found.joint_covariance is not None and found.limb_covariance is not None
        wide.append(np.trace(found.joint_covariance[0, end]))
        for each in (found.joint_covariance, found.limb_covariance):
            assert (np.linalg.eigvalsh(each.astype(float)) > 0).all()
    assert said[0] > said[1] > said[2] and wide[0] < wide[1] < wide[2]


def seen_of(tracks: Tracks) -> BodyObservation:
    points = tracks.translation[0].astype(np.float32)
    return BodyObservation(0, points, np.zeros(len(points), np.int32), np.array([[3.0, 0, 1]], np.float32))


def test_frames_that_one_of_both_does_not_know_are_the_icp_trackers():
    icp = tracks_at_rest(0.9)
    other = moved(icp, 0, 0.1)
    other.joints[10:] = np.nan
    share = chosen(icp, other).share
    assert (share[:10] > 0).any() and (share[10:] == 0).all()
    joints = hung(icp, other, share)
    assert np.isfinite(joints).all() and (joints[10:] == icp.joints[10:]).all()
