"""Covariances of limbs and joints: against NumPy's, against samples, and against a recording's truth."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.helpers import cast, scipy_rotation, two_limbs
from voodoo_jax.config.options import Settings
from voodoo_jax.exporters.npz import read_tracks_npz, write_tracks_npz
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.kernels.gauss_newton import coupled_normals, pair_normals, point_covariance, twist_covariance
from voodoo_jax.model.body import bands, scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.trackers.front import track


def moved(pose, twist):
    """Rotation and place of a limb after a turn and a shift in its own frame."""
    turn = scipy_rotation(pose.rotation)
    return turn * Rotation.from_rotvec(twist[:3]), np.asarray(pose.translation) + turn.apply(twist[3:])


def test_covariance_is_the_inverse_of_the_normal_matrix(x64, rng):
    """Two limbs with points of their own and a band between them; derivatives by differences, inverse by NumPy."""
    body = cast(two_limbs(), jnp.float64)
    points, weight = rng.normal(size=(2, 20, 3)), rng.uniform(0.5, 2.0, (2, 20))
    links, strength = bands(body), jnp.array([30.0, 50.0])

    def residuals(twists):
        placed_limbs = [moved(body.rest[k], twists[6 * k : 6 * k + 6]) for k in range(2)]
        own = [np.sqrt(weight[k])[:, None] * (r.apply(points[k]) + t) for k, (r, t) in enumerate(placed_limbs)]
        ends = [
            r.apply(np.array(x[0])) + t for (r, t), x in zip(placed_limbs, (links.first_points, links.second_points))
        ]
        gap = np.sqrt(40.0 * np.asarray(links.weights[0]))[:, None] * (ends[1] - ends[0])
        return np.concatenate([*(x.ravel() for x in own), gap.ravel()])

    step = 1e-6 * np.eye(12)
    slope = np.stack([(residuals(e) - residuals(-e)) / 2e-6 for e in step], 1)
    expected = np.linalg.inv(slope.T @ slope)

    rows = np.concatenate([np.ones((2, 20, 1)), points], -1)
    moments = np.einsum("kp,kpi,kpj->kij", weight, rows, rows)
    second = np.einsum("kp,kpi,kpj->kij", weight, points, points)
    own = [pair_normals(jnp.asarray(m), jnp.asarray(s)) for m, s in zip(moments, second)]
    normals, rhs = (jnp.stack(x) for x in zip(*own))
    full, _ = coupled_normals((links,), body.rest, normals, rhs, strength, jnp.asarray(0.0))
    found = np.asarray(twist_covariance(full))
    np.testing.assert_allclose(found, [expected[:6, :6], expected[6:, 6:]], rtol=1e-5, atol=1e-9)


def test_covariance_of_a_point_is_that_of_samples(x64, rng):
    root = 0.01 * rng.normal(size=(6, 6))
    twist, point = root @ root.T, rng.normal(size=3)
    pose = Poses(jnp.asarray(Rotation.random(rng=rng).as_quat(scalar_first=True)), jnp.asarray(rng.normal(size=3)))
    samples = []
    for sample in rng.multivariate_normal(np.zeros(6), twist, 20_000):
        turn, place = moved(pose, sample)
        samples.append(turn.apply(point) + place)
    expected = np.cov(np.array(samples).T)
    found = np.asarray(point_covariance(jnp.asarray(twist), pose, jnp.asarray(point)))
    np.testing.assert_allclose(found, expected, atol=0.05 * np.trace(expected))


@pytest.fixture(scope="module")
def sideways(tmp_path_factory):
    """A person who is seen from the right side: the left arm is hidden behind the trunk."""
    body = scaled(human(), 1.75)
    motion = placed(make_motion(body, "stand", 1.0, 15.0), 3.0, 0.0, np.radians(90))
    sim = simulate(body, motion, tof_camera(1.0, 0.07))
    log = write_simulation(sim, tmp_path_factory.mktemp("side") / "side.mcap")
    return sim, track(human(), read_log(log), Settings())


def test_what_is_hidden_is_less_sure(sideways):
    sim, tracks = sideways
    names, there = sim.body.topology.centres, tracks.tracked
    deviation = np.sqrt(np.trace(tracks.joint_covariance[there], axis1=-2, axis2=-1))
    seen, hidden = (deviation[:, names.index(name)].mean() for name in ("l_elbow", "r_elbow"))
    if sim.joints[0, names.index("l_elbow"), 0] > sim.joints[0, names.index("r_elbow"), 0]:
        seen, hidden = hidden, seen
    assert 0.01 < 1.05 * seen < hidden
    eigenvalues = np.linalg.eigvalsh(tracks.limb_covariance[there])
    assert (eigenvalues > 0).all()


def test_the_truth_lies_in_the_regions(sideways, tmp_path):
    sim, tracks = sideways
    error = (tracks.joints - sim.joints)[tracks.tracked]
    inverse = np.linalg.inv(tracks.joint_covariance[tracks.tracked])
    distance = np.einsum("fji,fjik,fjk->fj", error, inverse, error)
    assert (distance < 7.815).mean() > 0.9  # 95 % of a chi-squared distribution of three degrees of freedom
    write_tracks_npz(tracks, tmp_path / "t.npz")
    again = read_tracks_npz(tmp_path / "t.npz")
    np.testing.assert_array_equal(again.joint_covariance, tracks.joint_covariance)
    np.testing.assert_array_equal(again.limb_covariance, tracks.limb_covariance)
