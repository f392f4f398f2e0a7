"""Joint limits and limbs that pass through each other: found, and put right by artificial pairs when asked for."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.helpers import all_finite, frame_points, frustum_mesh, icp_options, scipy_rotation, seen_points
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.kernels.joint_limits import apart, check, contact_links, contacts, joint_angles, limit_links
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.simulate.motion import pose_body
from voodoo_jax.solve.frame import solve_frame
from voodoo_jax.solve.pulls import Problem

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")


def bent(body, **turns):
    """Rest pose with joints turned: rotation vectors in degrees, in the joints' frames."""
    rotations = np.zeros((len(body.topology.joints), 3))
    for name, vector in turns.items():
        rotations[body.topology.joints.index(name)] = np.radians(vector)
    return pose_body(body, body.rest[0], rotations)


def test_the_rest_pose_is_plausible():
    for name in ("human", "human10", "arm", "dog"):
        body = load_body(name)
        found = eqx.filter_jit(check)(body, body.rest)
        assert float(found.beyond.max()) == 0 and float(found.depth.max()) < 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_swing_and_twist_give_the_rotation_back(seed):
    """Oracle: scipy. Twist about z first, then a swing about an axis in the x-y plane."""
    rng = np.random.default_rng(seed)
    body = human()
    rotations = Rotation.random(len(body.topology.joints), rng=rng).as_rotvec()
    poses = pose_body(body, body.rest[0], rotations)
    angles = np.asarray(joint_angles(body, poses).angles, float)
    swing, twist = angles * [1, 1, 0], angles * [0, 0, 1]
    again = Rotation.from_rotvec(swing) * Rotation.from_rotvec(twist)
    assert (again * Rotation.from_rotvec(rotations).inv()).magnitude().max() < 1e-3
    assert np.abs(angles[:, 2]).max() <= np.pi + 1e-5


@pytest.mark.parametrize(
    "joint,turn,beyond",
    [("l_elbow", (0, 40, 0), 30), ("l_elbow", (0, -120, 0), 0), ("r_knee", (0, -60, 0), 50), ("r_knee", (0, 90, 0), 0),
     ("neck", (0, 0, 100), 15), ("l_hip", (0, -90, 0), 0), ("r_shoulder", (80, 0, 0), 30)],
)  # fmt: skip
def test_how_far_a_joint_is_beyond_its_limits(joint, turn, beyond):
    body = human()
    found = np.degrees(eqx.filter_jit(check)(body, bent(body, **{joint: turn})).beyond)
    others = np.delete(found, body.topology.joints.index(joint))
    assert abs(found[body.topology.joints.index(joint)] - beyond) < 0.1 and others.max() < 0.01


def test_limits_appear_only_beyond_the_limit():
    body = human()
    assert float(limit_links(body, body.rest, jnp.ones(())).weights.sum()) == 0
    links = limit_links(body, bent(body, l_knee=(0, -60, 0)), jnp.ones(()))
    used = np.asarray(links.weights.sum(1))
    assert used[body.topology.joints.index("l_knee")] == 1 and used.sum() == 1


@pytest.mark.parametrize("seed", range(6))
def test_overlap_of_round_limbs_side_by_side(seed):
    """Oracle: nearest points of dense meshes (trimesh), for limbs beside each other."""
    import trimesh

    rng = np.random.default_rng(seed)
    body = load_body("human")
    sizes = body.sizes.at[:, :4].set(0.04)
    body = eqx.tree_at(lambda b: b.sizes, body, sizes.at[:, 4].set(0.3))
    one, two = 3, 6  # both upper arms
    gap = rng.uniform(-0.02, 0.05)
    tilt = Rotation.from_euler("x", rng.uniform(-60, 60), degrees=True).as_quat(scalar_first=True)
    poses = Poses(body.rest.rotation.at[one].set(jnp.array([1.0, 0, 0, 0])).at[two].set(jnp.asarray(tilt, jnp.float32)),
                  body.rest.translation.at[one].set(jnp.zeros(3)).at[two].set(0.0))  # fmt: skip
    middle = np.array([0, 0, 0.15])
    at = np.array([0.08 + gap, 0, 0]) + middle - scipy_rotation(tilt).apply(middle)
    poses = Poses(poses.rotation, poses.translation.at[two].set(jnp.asarray(at, jnp.float32)))
    pair = [k for k, ends in enumerate(zip(*apart(body.topology))) if set(ends) == {one, two}][0]
    found = float(contacts(body, poses).overlap[pair])
    meshes = []
    for limb in (one, two):
        transform = np.eye(4)
        transform[:3, :3] = scipy_rotation(poses.rotation[limb]).as_matrix()
        transform[:3, 3] = np.asarray(poses.translation[limb])
        meshes.append(frustum_mesh(np.asarray(body.sizes[limb]), around=128, along=60).apply_transform(transform))
    # the deepest vertex is among those near the first one's axis (z)
    near = np.argsort(np.linalg.norm(meshes[1].vertices[:, :2], axis=1))[:300]
    signed = trimesh.proximity.signed_distance(meshes[0], meshes[1].vertices[near])
    assert abs(found - signed.max()) < 0.002  # trimesh: positive inside


def test_limbs_that_share_a_joint_are_no_contact():
    t = human().topology
    pairs = {frozenset(p) for p in zip(*(a.tolist() for a in apart(t)))}
    assert len(pairs) == 15 * 14 // 2 - 14
    assert frozenset((t.limbs.index("chest"), t.limbs.index("l_upper_arm"))) not in pairs


def test_a_forearm_through_the_chest_is_found_and_pushed_out():
    body = human()
    poses = bent(body, l_shoulder=(-45, -20, 0), l_elbow=(0, -90, 0))
    depth = check(body, poses).depth
    inside = dict(zip(body.topology.limbs, np.asarray(depth)))
    assert inside["l_forearm"] == inside["chest"] > 0.015 and inside["r_forearm"] < 1e-6
    links = contact_links(body, poses, jnp.ones(()), jnp.asarray(0.01))
    assert float(links.weights.max()) == 1


@pytest.mark.parametrize("solver", ["coupled", "per_limb"])
def test_limits_turn_a_knee_back(solver):
    """Nothing measured of the shank, which starts bent the wrong way: with the limits on it comes back."""
    body = human()
    wrong = bent(body, l_knee=(0, -50, 0))
    xyz = seen_points(np.random.default_rng(0), body, body.rest, (3.0, 0.3, 1.2), 600)
    xyz = xyz[xyz[:, 2] > 0.6]  # the upper body only
    seen = frame_points(xyz, [(3.0, 0.3, 1.2)])
    knee = body.topology.joints.index("l_knee")

    def after(limits):
        options = icp_options(solver=solver, prior=1e-5, max_steps=60, limits=limits, epsilon=0.0)
        found = eqx.filter_jit(solve_frame)(wrong, Problem.build(body, seen, wrong, options))
        assert all_finite(found)
        return float(np.degrees(check(body, found.poses).beyond[knee]))

    assert after(0.0) > 30 and after(1.0) < 8


@pytest.mark.parametrize("solver", ["coupled", "per_limb"])
def test_a_hand_is_pushed_out_of_the_other_thigh(solver):
    body = human()
    wrong = bent(body, l_shoulder=(-28, -12, 0))
    xyz = seen_points(np.random.default_rng(0), body, body.rest, (3.0, 0.3, 1.2), 600)
    left_arm = xyz[:, 1] > 0.13
    seen = frame_points(xyz[~left_arm], [(3.0, 0.3, 1.2)])

    def after(weight):
        options = icp_options(solver=solver, prior=1e-4, max_steps=40, collisions=weight, epsilon=0.0)
        found = eqx.filter_jit(solve_frame)(wrong, Problem.build(body, seen, wrong, options))
        assert all_finite(found)
        return float(check(body, found.poses).depth.max())

    assert after(0.0) > 0.04 and after(1.0) < 0.6 * after(0.0)


def test_finite_where_it_is_degenerate():
    """Axes that cross, joints turned by half a turn: values and gradients stay finite."""
    body = human()
    poses = bent(body, l_elbow=(0, 180, 0), r_elbow=(180, 0, 0), neck=(0, 0, 180))
    same = Poses(poses.rotation, poses.translation.at[4].set(poses.translation[7]))

    def total(p):
        found = check(body, p)
        links = (limit_links(body, p, jnp.ones(())), contact_links(body, p, jnp.ones(()), jnp.zeros(())))
        return jnp.sum(found.beyond) + jnp.sum(found.depth) + sum(jnp.sum(x.first_points) for x in links)

    for p in (poses, same, body.rest):
        value, gradient = jax.value_and_grad(total)(p)
        assert np.isfinite(float(value)) and all_finite(gradient)
