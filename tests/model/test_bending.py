"""Joints bent the wrong way, told without the twist of round limbs."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.model.joint_bend import wrong_bend
from voodoo_jax.model.pose_library import STANCES, in_stance

BODY = scaled(human(), 1.75)
ROUND = [k for k, name in enumerate(BODY.topology.limbs) if name[2:] in ("upper_arm", "forearm", "thigh", "shank")]


def rotations(body=BODY) -> np.ndarray:
    return np.array(body.rest.rotation, np.float32)[None]


def moved(turns: dict[str, tuple[str, float]]) -> np.ndarray:
    """The rest pose with joints turned about the body's axes, degrees; what hangs on them goes along."""
    q = rotations()[0]
    for joint, (axis, degrees) in turns.items():
        limbs = [BODY.topology.children[BODY.topology.joints.index(joint)]]
        for parent, child in zip(BODY.topology.parents, BODY.topology.children):
            if parent in limbs:
                limbs.append(child)
        turn = Rotation.from_euler(axis, degrees, degrees=True)
        q[limbs] = (turn * Rotation.from_quat(q[limbs], scalar_first=True)).as_quat(scalar_first=True)
    return q[None]


def at(found: np.ndarray, joint: str) -> float:
    return float(np.degrees(found[0, BODY.topology.joints.index(joint)]))


def test_nothing_is_wrong_with_standing_sitting_and_raised_arms():
    assert wrong_bend(BODY, rotations()).max() < 0.02
    for stance in STANCES:
        posed = in_stance(BODY, stance)
        assert posed is not None
        assert wrong_bend(posed, rotations(posed)).max() < 0.02


@pytest.mark.parametrize("degrees", [30, 60, 90])
def test_a_knee_bent_forwards_is_wrong_by_what_exceeds_its_limits(degrees):
    forwards = wrong_bend(BODY, moved({"l_knee": ("y", -degrees)}))
    # 15 degrees sideways, 10 forwards, and a thigh that twists by 60
    twist = np.radians(np.linspace(-60, 60, 1001))
    side, front = degrees * np.abs(np.sin(twist)), degrees * np.cos(twist)
    beyond = np.hypot(np.maximum(side - 15, 0), np.maximum(front - 10, 0)).min()
    assert beyond > 10
    assert at(forwards, "l_knee") == pytest.approx(beyond, abs=0.5)
    assert wrong_bend(BODY, moved({"l_knee": ("y", degrees)})).max() < 0.02
    assert forwards[0].sum() == pytest.approx(np.radians(at(forwards, "l_knee")), abs=0.02)


def test_a_hip_bent_backwards_is_wrong_by_what_exceeds_its_limit():
    assert at(wrong_bend(BODY, moved({"r_hip": ("y", 85)})), "r_hip") == pytest.approx(45, abs=1)


@pytest.mark.parametrize("seed", range(4))
def test_how_round_limbs_are_turned_about_their_axes_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    q = moved({"l_knee": ("y", -70), "r_hip": ("y", -60), "l_elbow": ("y", -50)})
    turned = q.copy()
    about = Rotation.from_rotvec(np.array([0, 0, 1.0]) * rng.uniform(-3, 3, (len(ROUND), 1)))
    turned[0, ROUND] = (Rotation.from_quat(q[0, ROUND], scalar_first=True) * about).as_quat(scalar_first=True)
    hinges = [BODY.topology.joints.index(j) for j in ("l_knee", "r_knee", "l_elbow", "r_elbow", "l_hip", "r_hip")]
    # limbs' axes are a little off the lines from joint to joint, and that is turned, too
    axes = Rotation.from_quat(rotations()[0, ROUND], scalar_first=True).apply([0, 0, -1.0])
    tilt = float(np.arccos(axes[:, 2].min()))
    assert tilt < np.radians(3)
    both = wrong_bend(BODY, turned)[:, hinges], wrong_bend(BODY, q)[:, hinges]
    np.testing.assert_allclose(*both, atol=2 * tilt + 1e-5)


def test_the_whole_body_may_lie_or_face_anywhere_and_frames_without_poses_give_zero():
    q = moved({"l_knee": ("y", -70)})
    anywhere = Rotation.random(5, random_state=0)
    many = np.float32([(r * Rotation.from_quat(q[0], scalar_first=True)).as_quat(scalar_first=True) for r in anywhere])
    many[3] = np.nan
    found = wrong_bend(BODY, many)
    keep = np.array([0, 1, 2, 4])
    np.testing.assert_allclose(found[keep], np.repeat(wrong_bend(BODY, q), 4, 0), atol=1e-5)
    assert not found[3].any()


@pytest.mark.parametrize("name", ["human10", "arm", "dog"])
def test_other_bodies_rest_within_their_limits(name):
    body = load_body(name)
    found = wrong_bend(body, rotations(body))
    assert found.shape == (1, len(body.topology.joints)) and found.max() < 0.02
