"""Arms that lie on the trunk without points of their own: they hang, where that hides them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.helpers import seen_points
from tests.support.segments import blank_tracks
from voodoo_jax.geometry.rigid import Poses, apply, on_host
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.model.pose_library import Stance, rest_in_stance
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.icp.misfit import misfit
from voodoo_jax.trackers.icp.refine.hang_arms import with_hung_arms

BODY = on_host(scaled(human(), 1.8))
T, REST = BODY.topology, BODY.rest
ARM = [T.limbs.index(f"r_{name}") for name in ("upper_arm", "forearm", "hand")]
SENSOR = np.array([[4.0, 0.0, 1.2]], np.float32)
FRAMES = 101  # at 20 Hz


@pytest.fixture
def across(rng) -> tuple[Tracks, np.ndarray]:
    """Tracks of a right arm across the trunk, without its points; and the points of all other limbs."""
    stance = rest_in_stance(BODY, Stance((("r_shoulder", "y", -20.0), ("r_elbow", "x", -75.0)), (1.0,)))
    assert stance is not None
    away = np.array(REST.translation)
    away[ARM] -= [9.0, 0.0, 0.0]
    seen = seen_points(rng, BODY, Poses(REST.rotation, away), SENSOR[0], 1500).astype(np.float32)
    seen = seen[seen[:, 0] > -2.0]
    rotation, translation = np.array(REST.rotation), np.array(REST.translation)
    rotation[ARM], translation[ARM] = stance.rotation[ARM], stance.translation[ARM]
    each = lambda values: np.repeat(np.asarray(values, np.float32)[None], FRAMES, 0)  # noqa: E731
    poses = Poses(each(rotation), each(translation))
    joints = np.asarray(apply(poses[:, np.array(T.centre_limbs, int)], np.asarray(BODY.centres)), np.float32)
    own = np.ones((FRAMES, len(T.limbs)), np.float32)
    own[:, ARM] = 0.0
    tracks = blank_tracks(BODY, FRAMES).having(
        rotation=poses.rotation, translation=poses.translation, joints=joints,
        limb_weight=np.full((FRAMES, len(T.limbs)), 20.0, np.float32), limb_own=own,
        time_ns=10**18 + 50_000_000 * np.arange(FRAMES),
    )  # fmt: skip
    return tracks, seen


def looked_at(rng, seen: np.ndarray, hidden: bool) -> list[BodyObservation]:
    """Frames with these points, of which a board hides where the arm hangs, or nothing does."""
    side = REST.translation[ARM].mean(0)
    board = rng.uniform([0.0, -0.35, -0.8], [0.0, 0.35, 0.8], (3000, 3)) + side + [0.6, 0.0, 0.0]
    before = board.astype(np.float32)[:: 1 if hidden else 3000]
    frame = BodyObservation(
        0, seen, np.zeros(len(seen), np.int32), SENSOR, before=before, before_sensor=np.zeros(len(before), np.int8)
    )
    return [frame] * FRAMES


def wrist(tracks: Tracks, frame: int) -> np.ndarray:
    return tracks.joints[frame, T.centres.index("r_radiocarpal")]


def test_an_arm_that_lies_on_the_trunk_hangs_where_a_thing_hides_it(rng, across):
    tracks, seen = across
    hung = with_hung_arms(tracks, looked_at(rng, seen, hidden=True))
    true = apply(Poses(REST.rotation, REST.translation)[ARM[1]], BODY.centres[T.centres.index("r_radiocarpal")])
    assert np.linalg.norm(wrist(tracks, 50) - true) > 0.25 and np.linalg.norm(wrist(hung, 50) - true) < 0.02
    fit = misfit(BODY, hung.rotation[:1], hung.translation[:1], looked_at(rng, seen, hidden=True)[:1])
    assert fit.bare[0, ARM].max() < 0.1
    others = [k for k in range(len(T.limbs)) if k not in ARM]
    np.testing.assert_array_equal(hung.rotation[:, others], tracks.rotation[:, others])
    assert (hung.evidence.limb_weight[:, ARM] == 0).all() and (hung.evidence.limb_weight[:, others] == 20).all()
    top = hung.joints[50, T.centres.index("r_shoulder")]
    np.testing.assert_allclose(top, tracks.joints[50, T.centres.index("r_shoulder")], atol=0.02)


def test_it_stays_where_it_would_be_seen_if_it_hung(rng, across):
    """Of the side on which it would hang nothing is seen, though nothing hides it."""
    tracks, seen = across
    left = seen[seen[:, 1] > -0.05]
    assert with_hung_arms(tracks, looked_at(rng, left, hidden=False)) is tracks
    assert with_hung_arms(tracks, looked_at(rng, left, hidden=True)) is not tracks


def test_it_stays_near_frames_in_which_it_has_points_of_its_own(rng, across):
    tracks, seen = across
    own = tracks.evidence.limb_own.copy()
    own[:20, ARM] = 1.0
    hung = with_hung_arms(tracks.having(limb_own=own), looked_at(rng, seen, hidden=True))
    moved = np.linalg.norm(hung.joints - tracks.joints, axis=-1).max(1)
    assert (moved[:45] == 0).all() and (moved[90:] > 0.25).all() and 0.01 < moved[71] < 0.6
    assert (np.diff(moved) > -1e-3).all() and np.diff(moved).max() < 0.2  # in half a second


@pytest.mark.parametrize("missing", ["limb_own", "arms"])
def test_without_what_it_needs_nothing_changes(rng, across, missing):
    tracks, seen = across
    if missing == "limb_own":
        tracks = tracks.having(limb_own=None)
    else:
        limbs = tuple(name.replace("forearm", "wing") for name in T.limbs)
        tracks = replace(tracks, body=replace(BODY, topology=T._replace(limbs=limbs)))
    assert with_hung_arms(tracks, looked_at(rng, seen, hidden=True)) is tracks


def test_it_stays_where_it_hangs_already(rng, across):
    """Turned by 10 degrees out of where it would hang: that may be what was seen of it."""
    tracks, seen = across
    turn = Rotation.from_euler("y", 10, degrees=True)
    top = np.asarray(apply(Poses(REST.rotation, REST.translation)[ARM[0]], BODY.child_anchor.translation[_joint()]))
    rotation, translation = tracks.rotation.copy(), tracks.translation.copy()
    for limb in ARM:
        own = turn * Rotation.from_quat(REST.rotation[limb], scalar_first=True)
        rotation[:, limb] = own.as_quat(scalar_first=True)
        translation[:, limb] = top + turn.apply(REST.translation[limb] - top)
    near = replace(tracks, rotation=rotation, translation=translation)
    assert with_hung_arms(near, looked_at(rng, seen, hidden=True)) is near


def _joint() -> int:
    return list(T.children).index(ARM[0])
