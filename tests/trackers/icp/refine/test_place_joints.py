"""Joint centres by bend, view and bands."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.segments import blank_tracks
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.frames import placed_by
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.model.body import joint_centres, scaled, segment_lengths, with_proportions
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Status, Tracks
from voodoo_jax.solve.scan import options_from
from voodoo_jax.trackers.icp.refine.place_joints import (
    LEGS,
    LIMBS,
    UPPER,
    WAVES,
    PlaceJoints,
    band_gaps,
    learned,
    measured_segments,
    persons_body,
    sensor_places,
    waves,
)
from voodoo_jax.trackers.icp.runner import Runner

BODY = on_host(scaled(human(), 1.8))
COUNT = 60
EYES = np.tile([3.0, 0.0, 1.0], (COUNT, 1))
STAGE = PlaceJoints()
FIRST_AND_LAST = [0.5292157038, 0.06719926044, 3.728282766, 5.530199098]


def placed(body, tracks: Tracks, eyes: np.ndarray) -> Tracks:
    """All joints moved, by the bands of all frames."""
    return STAGE.placed(body, tracks, eyes, band_gaps(body, tracks))


def standing(lower_shanks: float = 0.0, body=BODY) -> Tracks:
    """The rest pose; shanks and feet lower by so many metres."""
    place = np.array(body.rest.translation)
    for name in ("l_shank", "r_shank", "l_foot", "r_foot"):
        if name in body.topology.limbs:
            place[body.topology.limbs.index(name), 2] -= lower_shanks
    poses = Poses(body.rest.rotation, place)
    tile = lambda x: np.tile(np.asarray(x, np.float32), (COUNT, 1, 1))  # noqa: E731
    return blank_tracks(
        body, COUNT, rotation=tile(body.rest.rotation), translation=tile(place),
        joints=tile(joint_centres(body, poses)), status=np.full(COUNT, Status.TRACKED, np.int8),
        limb_weight=np.ones((COUNT, body.limb_count), np.float32),
    )  # fmt: skip


def test_segments_are_as_long_as_from_joint_to_joint_where_they_are_seen():
    """The knees of a standing person lower by 3 cm; not so in frames in which nothing is seen of the thighs, which are
    fewer than half, nor where the person is lost. The other lengths are the body's."""
    tracks = standing()
    knees = [BODY.topology.centres.index(f"{side}_knee") for side in "lr"]
    joints, weight, status = tracks.joints.copy(), tracks.evidence.limb_weight.copy(), tracks.status.copy()
    joints[:40, knees, 2] -= 0.03
    weight[40:50, [BODY.topology.limbs.index(f"{side}_thigh") for side in "lr"]] = 0
    status[50:] = Status.LOST
    found = measured_segments(replace(tracks, joints=joints, status=status).having(limb_weight=weight))
    usual, hips = segment_lengths(BODY), [BODY.topology.centres.index(f"{side}_hip") for side in "lr"]
    expected = np.linalg.norm(joints[0, hips] - joints[0, knees], axis=-1).mean()
    assert set(found) == {"thigh", "forearm"} and found["thigh"] == pytest.approx(expected, abs=1e-6)
    assert found["forearm"] == pytest.approx(usual["forearm"], abs=0.01)
    assert expected > np.linalg.norm(tracks.joints[0, hips] - tracks.joints[0, knees], axis=-1).mean() + 0.025
    assert replace(tracks, segments=found).segment_lengths() == usual | found
    assert measured_segments(replace(tracks, status=np.full(COUNT, Status.LOST, np.int8))) == {}


def turned(tracks: Tracks, turn: Rotation) -> Tracks:
    q = (turn * Rotation.from_quat(tracks.rotation.reshape(-1, 4), scalar_first=True)).as_quat(scalar_first=True)
    place, joints = (turn.apply(x.reshape(-1, 3)).reshape(x.shape) for x in (tracks.translation, tracks.joints))
    turns = q.reshape(tracks.rotation.shape).astype(np.float32)
    return replace(tracks, rotation=turns, translation=place, joints=joints)


def test_what_is_learned_fits_the_features():
    for name in LIMBS:
        told, gaps = learned()[name], 3 * len(LEGS if name in ("hip", "knee", "talocrural") else UPPER)
        assert told.weights.shape == (70 + WAVES + gaps, 3) and told.usual.shape == told.spread.shape == (gaps,)
        assert np.isfinite(told.weights).all() and (told.spread >= 0).all()


def test_waves_are_the_same_everywhere():
    """What was learned is for these frequencies and phases: other ones would move joints anywhere."""
    frequencies, phases = waves(48)
    np.testing.assert_allclose([frequencies[0, 0], frequencies[47, 199], phases[0], phases[199]], FIRST_AND_LAST)


def test_left_and_right_are_mirror_images():
    tracks = standing(0.01)
    found = placed(BODY, tracks, EYES)
    names, shift = BODY.topology.centres, (found.joints - tracks.joints)[0]
    for name in (n[2:] for n in names if n.startswith("l_")):
        left, right = (shift[names.index(f"{side}_{name}")] for side in "lr")
        np.testing.assert_allclose(left, right * [1, -1, 1], atol=1e-6)
        assert 1e-5 < np.linalg.norm(left) <= 1.8 * STAGE.farthest + 1e-6
    np.testing.assert_array_equal(found.rotation, tracks.rotation)
    assert found.body is tracks.body


def test_poses_are_fitted_to_joints_less_what_is_moved():
    """The truth that poses are fitted to: where joints are true after the stage, the body's own centres lie on it."""
    tracks = standing(0.01)
    found, at = placed(BODY, tracks, EYES), np.array([0, 7])
    np.testing.assert_allclose(found.joints[at] - placed_by(found, at), tracks.joints[at], atol=1e-6)
    np.testing.assert_allclose(placed_by(tracks, at), 0.0, atol=1e-6)


def test_shifts_turn_with_the_scene():
    tracks, turn = standing(0.01), Rotation.from_euler("zyx", [70, 20, -10], degrees=True)
    there = placed(BODY, turned(tracks, turn), turn.apply(EYES))
    here = placed(BODY, tracks, EYES)
    np.testing.assert_allclose(
        there.joints, turn.apply(here.joints.reshape(-1, 3)).reshape(here.joints.shape), atol=1e-5
    )
    other_side = placed(BODY, tracks, EYES * [-1, 1, 1])
    assert np.abs(other_side.joints - here.joints).max() > 1e-3  # the side that is seen matters


def test_bands_say_where_knees_are():
    usual, low = (band_gaps(BODY, standing(off))["legs"] for off in (0.0, 0.009))
    # a thigh's own axis points down: hundredths of the stature
    np.testing.assert_allclose((low.gap - usual.gap)[LEGS.index("knee")], [0, 0, 0.5], atol=0.02)
    np.testing.assert_allclose((low.gap - usual.gap)[LEGS.index("hip")], 0, atol=1e-4)
    knee = BODY.topology.centres.index("l_knee")
    moved = [placed(BODY, t, EYES).joints[0, knee] - t.joints[0, knee] for t in map(standing, (0.0, 0.002))]
    assert np.abs(moved[1] - moved[0]).max() > 3e-4


def test_what_nobody_saw_says_nothing():
    tracks, told = standing(0.01), learned()["knee"]
    tracks.evidence.limb_weight[
        :, [BODY.topology.limbs.index(f"{side}_{limb}") for side in "lr" for limb in ("thigh", "foot")]
    ] = 0
    gaps = band_gaps(BODY, tracks)["legs"]
    assert not gaps.count.any() and not STAGE.gap_features(gaps, told).any()
    lost = replace(tracks, rotation=tracks.rotation.copy())
    lost.rotation[5:8] = np.nan
    found = placed(BODY, lost, EYES)
    np.testing.assert_array_equal(found.joints[5:8], lost.joints[5:8])
    assert np.isfinite(found.joints).all()


def test_nothing_is_moved_far():
    wild = standing(0.3)
    assert np.linalg.norm(placed(BODY, wild, EYES).joints - wild.joints, axis=-1).max() <= 1.8 * 0.025 + 1e-5


@pytest.mark.parametrize("other", [with_proportions(BODY, {"l_thigh": 1.6}), load_body("human10"), load_body("dog")],
                         ids=["no person", "human10", "dog"])  # fmt: skip
def test_other_bodies_are_unknown(other):
    assert persons_body(other) is None
    fitted = with_proportions(BODY, {"l_thigh": 1.05, "r_thigh": 1.05})
    np.testing.assert_array_equal(persons_body(fitted).sizes, fitted.sizes)  # pyright: ignore
    longer = with_proportions(BODY, {"l_forearm": 1.05, "r_forearm": 1.05})  # as fit_forearms leaves them
    np.testing.assert_allclose(persons_body(longer).sizes, BODY.sizes, rtol=1e-5)  # pyright: ignore


def test_a_fitted_body_knows_its_own_lengths():
    """As measured for the package's own body, also with its forearms fitted to the log; a body in other proportions was
    fitted to the person before."""
    settings, none = Settings(), np.zeros((0, 3), np.float32)
    frames = [BodyObservation(k, none, np.zeros(0, np.int32), np.float32(EYES[:1])) for k in range(COUNT)]
    scene = Scene(Plane(np.array([0, 0, 1], np.float32), 0.0), (), False)
    options = options_from(settings.solve, settings.track, settings.features)
    for limb, measured in (("forearm", True), ("thigh", False)):
        body = with_proportions(BODY, {f"{side}_{limb}": 1.05 for side in "lr"})
        found = STAGE(Runner(body, options, frames, scene, settings), standing(body=body))
        assert (found.segments is not None) == measured
        assert measured or found.segment_lengths() == segment_lengths(body)


def test_one_sensor_wherever_it_goes():
    none, T = np.zeros((0, 3), np.float32), np.eye(4)
    T[:3, 3] = [1, 2, 3]
    frame = BodyObservation(0, none, np.zeros(0, np.int32), np.ones((1, 3), np.float32), T_fixed_steady=T)
    np.testing.assert_allclose(sensor_places([frame]), [[2, 3, 4]])  # pyright: ignore
    assert sensor_places([frame, replace(frame, origins=np.zeros((2, 3), np.float32))]) is None
