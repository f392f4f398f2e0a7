"""Joint angles: known turns are found again, and postures have the signs that the ISB gives them, on both sides."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.truth import truth_tracks
from voodoo_jax.model.body_file import load_body
from voodoo_jax.model.isb_angles import CONVENTIONS, joint_angles
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import Camera

MIRROR = np.diag([1.0, -1, 1])
HEADING = Rotation.from_euler("ZYX", [40, 10, -5], degrees=True)  # how the person stands in the laboratory


def posed(body, turns: dict[str, Rotation]) -> np.ndarray:
    """[1, limb, 4] T_fixed_limb; each limb turned in the body frame by its own and all its parents' turns."""
    t, rest = body.topology, Rotation.from_quat(np.asarray(body.rest.rotation, float), scalar_first=True)
    above = {c: p for p, c in zip(t.parents, t.children)}

    def whole(limb: int) -> Rotation:
        own = turns.get(t.limbs[limb], Rotation.identity())
        return whole(above[limb]) * own if limb in above else own

    return np.array([[(HEADING * whole(i) * rest[i]).as_quat(scalar_first=True) for i in range(body.limb_count)]])


def angles_of(body, turns, **more):
    rotation = posed(body, turns)
    return joint_angles(body, rotation, np.ones(rotation.shape[:2], bool), **more)


def about(axis: str, degrees: float) -> Rotation:
    """A turn about x (forwards), y (to the left) or z (up) of the body frame."""
    return Rotation.from_euler(axis, degrees, degrees=True)


def test_the_rest_pose_is_zero_but_for_pronation():
    for name in ("human", "human10"):
        found = angles_of(load_body(name), {})
        for column, value in zip(found.columns, found.table[0]):
            if "shoulder" in column and not column.endswith("elevation"):
                assert np.isnan(value)  # a hanging arm is at gimbal lock
            else:
                expected = 90 if column.endswith("elbow_pronation") else 0
                assert np.degrees(value) == pytest.approx(expected, abs=1e-3), column


# what a person does, for the right side where there are two; then what is expected, degrees
POSTURES = [
    ({"thigh": about("y", -50)}, {"hip_flexion": 50}),  # knee lifted forwards
    ({"thigh": about("x", -20)}, {"hip_adduction": -20}),  # right leg to its side
    ({"thigh": about("z", 30)}, {"hip_rotation": 30}),  # toes of the right foot inwards
    ({"shank": about("y", 70)}, {"knee_flexion": 70}),  # heel to the bottom
    ({"shank": about("x", 8)}, {"knee_adduction": 8}),  # bow leg: the foot towards the middle
    ({"foot": about("y", -25)}, {"ankle_dorsiflexion": 25}),  # toes up
    ({"foot": about("x", 15)}, {"ankle_inversion": 15}),  # sole to the middle
    ({"upper_arm": about("y", -90)}, {"shoulder_elevation": 90, "shoulder_plane": 90}),  # arm forwards
    ({"upper_arm": about("x", -60)}, {"shoulder_elevation": 60, "shoulder_plane": 0}),  # arm to its side
    ({"forearm": about("y", -100)}, {"elbow_flexion": 100, "elbow_pronation": 90}),  # hand to the shoulder
    ({"forearm": about("z", -90)}, {"elbow_flexion": 0, "elbow_pronation": 0}),  # palm forwards
    ({"hand": about("x", 40)}, {"wrist_flexion": 40}),  # fingers to the forearm's palm side
    ({"hand": about("y", 20)}, {"wrist_deviation": 20}),  # little finger's side, which is behind
]
MIDDLE = [
    ({"chest": about("y", 35)}, {"trunk_flexion": 35, "neck_flexion": 0}),  # bows
    ({"chest": about("x", 20)}, {"trunk_bending": 20}),  # to the right
    ({"chest": about("z", 25)}, {"trunk_rotation": 25}),  # turns to the left
    ({"head": about("y", 30)}, {"neck_flexion": 30, "trunk_flexion": 0}),  # looks down
]


@pytest.mark.parametrize("side", ["r_", "l_"])
def test_postures_have_the_signs_of_the_isb_on_both_sides(side):
    body = load_body("human")
    for turns, expected in POSTURES:
        own = {side + limb: turn for limb, turn in turns.items()}
        if side == "l_":  # the mirrored posture
            own = {limb: Rotation.from_matrix(MIRROR @ r.as_matrix() @ MIRROR) for limb, r in own.items()}
        found = angles_of(body, own)
        for name, degrees in expected.items():
            assert np.degrees(found[side + name][0]) == pytest.approx(degrees, abs=1e-3), (turns, name)


def test_postures_of_the_trunk_and_neck():
    for turns, expected in MIDDLE:
        found = angles_of(load_body("human"), turns)
        for name, degrees in expected.items():
            assert np.degrees(found[name][0]) == pytest.approx(degrees, abs=1e-3), name


@pytest.mark.parametrize("side", ["r_", "l_"])
@pytest.mark.parametrize("how", CONVENTIONS, ids=lambda how: how.joint)
def test_all_three_angles_at_once_are_found_again(how, side):
    """SciPy turns by known angles about the axes of the convention; they come back, and only they."""
    body, rng = load_body("human"), np.random.default_rng(3)
    side = side if how.paired else ""
    for _ in range(5):
        given = rng.uniform(-60, 60, 3)
        given[1] = rng.uniform(10, 150) if how.order == "YXY" else given[1]
        signed = given * how.signs * ((1, -1, 1) if how.order == "YXY" else (1, 1, 1))
        turn = Rotation.from_euler(how.order, signed, degrees=True).as_matrix()
        turn = how.parent_axes @ turn @ how.child_axes.T
        if side == "l_":
            turn = MIRROR @ turn @ MIRROR
        found = angles_of(body, {side + how.child: Rotation.from_matrix(turn)})
        row = found.values[0, found.joints.index(side + how.joint)]
        np.testing.assert_allclose(np.degrees(row), given, atol=1e-3)


def test_covariance_is_that_of_small_random_turns():
    body, rng, sd = load_body("human"), np.random.default_rng(0), np.radians([0.5, 1.0, 2.0])
    turns = {"r_thigh": about("y", -40) * about("z", 20), "r_shank": about("y", 60)}
    covariance = np.zeros((1, body.limb_count, 6, 6), np.float32)
    covariance[:, :, :3, :3] = np.diag(sd**2)
    told = angles_of(body, turns, covariance=covariance)
    exact = Rotation.from_quat(posed(body, turns)[0], scalar_first=True)
    count = 4000
    noisy = np.stack([
        (exact * Rotation.from_rotvec(rng.normal(0, sd, (body.limb_count, 3)))).as_quat(scalar_first=True)
        for _ in range(count)
    ])  # fmt: skip
    tried = joint_angles(body, noisy, np.ones(noisy.shape[:2], bool))
    for name in ("r_hip_flexion", "r_knee_flexion", "r_knee_adduction", "r_knee_rotation"):
        expected = float(np.std(tried[name]))
        assert told.deviation[0, told.columns.index(name)] == pytest.approx(expected, rel=0.06), name


def tracks_of(name: str):
    body = load_body(name)
    camera = Camera(8, 6, 9.1, 8.6, 3.5, 2.5, (0.0, 0.0, 1.0), 0.07)
    return truth_tracks(simulate(body, placed(make_motion(body, "swing", 0.8, 10.0), 2.5, 0.0, np.pi), camera))


def test_hidden_limbs_and_untracked_frames_are_nan():
    tracks = tracks_of("human")
    weight, status = tracks.evidence.limb_weight.copy(), tracks.status.copy()
    shank = tracks.body.topology.limbs.index("l_shank")
    weight[2, shank], status[5] = 0, 3
    tracks = tracks.having(limb_weight=weight, status=status)
    angles = tracks.angles()
    assert np.flatnonzero(np.isnan(angles["l_knee_flexion"])).tolist() == [2, 5]
    assert np.flatnonzero(np.isnan(angles["l_ankle_inversion"])).tolist() == [2, 5]
    assert np.flatnonzero(np.isnan(angles["r_knee_flexion"])).tolist() == [5]
    assert np.flatnonzero(np.isnan(tracks.angles(hidden=True)["l_knee_flexion"])).tolist() == [5]
    with pytest.raises(KeyError, match="did you mean 'l_knee_flexion'"):
        angles["l_knee_flexon"]


def test_angles_go_on_beyond_half_a_turn():
    body = load_body("human")
    turns = np.linspace(0, 300, 31)
    rotation = np.concatenate([posed(body, {"head": about("z", a)}) for a in turns])
    found = np.degrees(joint_angles(body, rotation, np.ones(rotation.shape[:2], bool))["neck_rotation"])
    np.testing.assert_allclose(np.diff(found), 10, atol=1e-3)


@pytest.mark.parametrize("name", ["dog", "arm"])
def test_other_bodies_have_the_angles_of_their_body_files(name):
    from voodoo_jax.geometry.rigid import Poses
    from voodoo_jax.kernels.joint_limits import joint_angles as limited

    tracks = tracks_of(name)
    angles = tracks.angles()
    assert angles.joints == tracks.body.topology.joints
    expected = limited(tracks.body, Poses(tracks.rotation[4], tracks.translation[4])).angles
    np.testing.assert_allclose(angles.values[4], expected, atol=2e-4)
