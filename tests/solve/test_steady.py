"""What stands still is held still, and what moves is not held."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.helpers import cast, icp_options, two_limbs
from voodoo_jax.config.options import Settings, SolveSettings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.kernels.bands import prior_moments
from voodoo_jax.kernels.points import Points
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.solve.pulls import Problem, pull_to_prediction
from voodoo_jax.trackers.front import track


def nothing_seen() -> Points:
    return Points(jnp.zeros((1, 3)), jnp.zeros(1), jnp.zeros(1, int), jnp.zeros((1, 3)))


@pytest.mark.parametrize("away, share", [(0.0, 1.0), (0.004, 0.25), (0.04, 1 / 101**2)])
def test_the_hold_of_a_limb_weakens_with_the_way_it_has_gone(x64, away, share):
    body = cast(two_limbs(), jnp.float64)
    options = icp_options(jnp.float64, prior=0.0, steady=8.0, steady_distance=0.004)
    there = Poses(body.rest.rotation, body.rest.translation + jnp.array([[away, 0, 0], [0, 0, 0]]))
    problem = Problem.build(body, nothing_seen(), body.rest, options)
    pull, _ = pull_to_prediction(there, problem, jnp.array([10.0, 5.0]))
    np.testing.assert_allclose(np.asarray(pull)[:, 0, 0], [80 * share, 40.0], rtol=1e-6)
    # and pulls to where prior pairs of that weight do
    middle = jnp.array([0.0, 0, body.sizes[0, 4] / 2])
    alone, _ = prior_moments(middle, there[0], body.rest[0], jnp.array(80 * share), jnp.array(0.0))
    np.testing.assert_allclose(np.asarray(pull)[0, 0], np.asarray(alone)[0], atol=1e-9)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    body = scaled(human(), 1.75)
    simulation = simulate(body, placed(make_motion(body, "stand", 2.0), 3.0, 0.0, np.pi), camera=tof_camera())
    path = tmp_path_factory.mktemp("still") / "still.mcap"
    write_simulation(simulation, path)
    return read_log(path), simulation.joints


def jitter(joints: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square distance of joints from where they are on average, metres."""
    off = (joints - truth)[8:-4]
    return float(np.sqrt(np.mean(np.sum((off - off.mean(0)) ** 2, -1))))


def test_who_stands_still_does_not_tremble(log):
    recording, truth = log
    loose = replace(Settings(), solve=replace(SolveSettings(), steady=0.0))
    held, free = (jitter(track(human(), recording, s).joints, truth) for s in (Settings(), loose))
    assert held < 0.002 and held < free / 2, (held, free)
