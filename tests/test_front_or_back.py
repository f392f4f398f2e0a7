"""Somebody who may face the camera or turn their back to it: both are tracked, and the likelier one is kept."""

import numpy as np
import pytest
from in_front import error, in_front

from voodoo_jax.beginning import Beginning
from voodoo_jax.body import scaled
from voodoo_jax.front_or_back import likelier_way
from voodoo_jax.io.body_file import human
from voodoo_jax.passage import rows_of
from voodoo_jax.pose import Poses, compose, on_host
from voodoo_jax.stances import HIPS, exchanged

BODY, COUNT = scaled(human(), 1.75), 30


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Somebody with feet apart who swings the arms in front of them."""
    apart, swing = np.tile([0.12, 0.0, 0.0], (COUNT, 1)), np.zeros((COUNT, 3))
    swing[:, 1] = -0.5 - 0.4 * np.sin(6 * np.arange(COUNT) / 30)
    turns = {"l_hip": apart, "r_hip": -apart, "l_shoulder": swing, "r_shoulder": swing}
    sim, run = in_front(tmp_path_factory.mktemp("seen") / "log.mcap", BODY, turns)
    truth = Poses(sim.rotation, sim.translation)[0]
    return sim, run, truth, turned_round(truth)


def turned_round(poses):
    """The poses after half a turn about the vertical through the first limb."""
    about = np.array([0.0, 0.0, 0.0, 1.0], np.float32)
    middle = np.asarray(poses.translation[0]) * [1, 1, 0]
    return on_host(compose(Poses(about, (2 * middle).astype(np.float32)), poses))


def way(run, first, second):
    """What becomes of a start in the first poses with a rival in the second ones."""
    start = Beginning(0, BODY, first, 1.0, rival=Beginning(0, BODY, second, 1.0))
    return likelier_way(run, start, rows_of(run, run.forwards(first, 0, COUNT)[1], 0, COUNT))


@pytest.mark.parametrize("legs", ["own", "exchanged"])
def test_the_right_way_is_kept_whichever_is_first_even_with_the_legs_exchanged(seen, legs):
    sim, run, truth, turned = seen
    right = truth if legs == "own" else exchanged(on_host(BODY), truth, HIPS)
    found, end = way(run, right, turned)
    assert end is None and error(sim, found).mean() < 0.03
    found, end = way(run, turned, right)
    assert end is not None and error(sim, found).mean() < 0.03
