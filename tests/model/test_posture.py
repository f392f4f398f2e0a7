"""Which way a posture says that somebody faces: poses by forward kinematics, and the same turned back to front."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.model.posture import faces_ahead
from voodoo_jax.simulate.motion import motion_of_turns, placed, pose_body

UP, COUNT = np.array([0, 0, 1], np.float32), 4


def posed(way: float, yaw: float = 0.0) -> Poses:
    """Somebody who leans, bends knees and elbows and holds the hands ahead (`way` 1), or all that to the back (-1)."""
    body = scaled(human(), 1.75)
    turns = {"knee": 0.4, "hip": -0.4, "shoulder": -0.3, "elbow": -0.8}
    bent = {f"{side}_{name}": np.tile([0, way * by, 0], (COUNT, 1)) for side in "lr" for name, by in turns.items()}
    lean = np.tile([0, way * 0.3, 0], (COUNT, 1))
    moved = placed(motion_of_turns(body, np.arange(COUNT) / 30, bent, lean=lean), 3.0, 1.0, yaw)
    return on_host(pose_body(body, moved.root, moved.rotations))


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_who_leans_and_bends_to_where_they_face_faces_ahead(yaw):
    body = scaled(human(), 1.75)
    ahead, turned = faces_ahead(body, posed(1.0, yaw), UP), faces_ahead(body, posed(-1.0, yaw), UP)
    assert ahead > 0.5 and turned < -0.5
    assert ahead == pytest.approx(faces_ahead(body, posed(1.0), UP), abs=1e-3)  # wherever they stand


def test_lost_frames_do_not_count_and_who_lies_tells_nothing():
    body, poses = scaled(human(), 1.75), posed(1.0)
    some = Poses(poses.rotation.copy(), poses.translation.copy())
    some.translation[:2] = np.nan
    assert faces_ahead(body, some, UP) == pytest.approx(faces_ahead(body, poses, UP), abs=1e-5)
    over = Rotation.from_euler("y", np.pi / 2 - 0.3)  # the trunk is level then
    laid = (over * Rotation.from_quat(poses.rotation.reshape(-1, 4), scalar_first=True)).as_quat(scalar_first=True)
    lies = Poses(laid.reshape(poses.rotation.shape), over.apply(poses.translation.reshape(-1, 3)).reshape(COUNT, -1, 3))
    assert abs(faces_ahead(body, lies, UP)) < 0.05


def test_of_bodies_without_such_joints_and_without_poses_nothing_is_known():
    arm = load_body("arm")
    rest = on_host(arm.rest)
    assert np.isnan(faces_ahead(arm, Poses(rest.rotation[None], rest.translation[None]), UP))
    poses = posed(1.0)
    nobody = Poses(poses.rotation, np.full_like(poses.translation, np.nan))
    assert np.isnan(faces_ahead(human(), nobody, UP))
