"""Somebody who may face the camera or turn their back to it: both are tracked, and the likelier one is kept."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.in_front import error, in_front
from voodoo_jax.geometry.rigid import Poses, compose, on_host
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.trackers.icp.pipeline import SETTLE
from voodoo_jax.trackers.icp.refine.choose_facing import ChooseFacing
from voodoo_jax.trackers.icp.segment import forwards
from voodoo_jax.trackers.icp.stage import refined
from voodoo_jax.trackers.icp.start.facing_odds import gone_ahead
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis
from voodoo_jax.trackers.shared.sequence import KnownStart

BODY, COUNT = scaled(human(), 1.75), 30


def swinging(path, nearer: float = 0.0):
    """Somebody with feet apart who swings the arms in front of them, and comes nearer."""
    apart, swing = np.tile([0.12, 0.0, 0.0], (COUNT, 1)), np.zeros((COUNT, 3))
    swing[:, 1] = -0.5 - 0.4 * np.sin(6 * np.arange(COUNT) / 30)
    turns = {"l_hip": apart, "r_hip": -apart, "l_shoulder": swing, "r_shoulder": swing}
    sim, run = in_front(path, BODY, turns, COUNT, nearer)
    truth = Poses(sim.rotation, sim.translation)[0]
    return sim, run, truth, turned_round(truth)


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    return swinging(tmp_path_factory.mktemp("seen") / "log.mcap")


def turned_round(poses):
    """The poses after half a turn about the vertical through the first limb."""
    about = np.array([0.0, 0.0, 0.0, 1.0], np.float32)
    middle = np.asarray(poses.translation[0]) * [1, 1, 0]
    return on_host(compose(Poses(about, (2 * middle).astype(np.float32)), poses))


BLIND = ChooseFacing(SETTLE, posture=0.0, doubtful=-np.inf)  # posture tells it nothing


def way(run, first, second, cost: float = 1.0, stage=BLIND):
    """What becomes of a start in the first poses with a rival in the second ones that costs so much more."""
    start = StartHypothesis(0, BODY, first, 1.0, rival=StartHypothesis(0, BODY, second, cost))
    settled = refined(run, replace(forwards(run, first, 0, COUNT), start=start), SETTLE)
    found = stage(run, settled)
    return found, found.state


def test_the_right_way_is_kept_whichever_is_first(seen):
    sim, run, truth, turned = seen
    found, end = way(run, truth, turned)
    assert end is None and error(sim, found).mean() < 0.03 and (found.facing_odds > 0.1).all()
    found, end = way(run, turned, truth)
    assert end is not None and error(sim, found).mean() < 0.03 and (found.facing_odds > 0.1).all()


def test_odds_are_known_of_a_start_without_a_rival_and_of_one_that_costs_far_more(seen):
    _, run, truth, turned = seen
    clear, _ = way(run, truth, turned, 2.0)
    np.testing.assert_allclose(clear.facing_odds, 2 * np.log(2.0), rtol=1e-6)
    start = StartHypothesis(0, BODY, truth, 1.0)
    alone = ChooseFacing(SETTLE)(run, replace(forwards(run, truth, 0, COUNT), start=start))
    assert (alone.facing_odds > clear.facing_odds).all()
    on = ChooseFacing(SETTLE)(run, replace(forwards(run, truth, 0, COUNT), start=KnownStart(0, truth)))
    assert np.isnan(on.facing_odds).all()  # it goes on from frames that were asked


@pytest.mark.parametrize("nearer", [0.0, 1.2])
def test_who_seems_to_go_backwards_is_looked_at_the_other_way_round_though_that_began_worse(tmp_path, nearer):
    sim, run, truth, turned = swinging(tmp_path / "log.mcap", nearer)
    found, end = way(run, turned, truth, 1.3)
    assert (end is not None) == (nearer > 0)
    assert (error(sim, found).mean() < 0.03) == (nearer > 0)
    found, end = way(run, truth, turned, 1.3)
    assert end is None and error(sim, found).mean() < 0.03


def test_whose_posture_is_that_of_one_turned_round_is_looked_at_the_other_way_round(seen):
    sim, run, truth, turned = seen
    for first, second, changes in ((turned, truth, True), (truth, turned, False)):
        found, end = way(run, first, second, 1.3, ChooseFacing(SETTLE))
        assert (end is not None) == changes and error(sim, found).mean() < 0.03 and (found.facing_odds > 0.1).all()


def test_whose_joints_bend_the_wrong_way_is_looked_at_the_other_way_round_though_that_began_worse(tmp_path):
    down = 0.5 - 0.5 * np.cos(np.arange(COUNT) / COUNT * 2 * np.pi)
    knee, hip, arm = (np.outer(down, [0.0, angle, 0.0]) for angle in (1.4, -1.0, -1.4))
    turns = {
        f"{side}_{joint}": turn for side in "lr" for joint, turn in zip(("knee", "hip", "shoulder"), (knee, hip, arm))
    }
    sim, run = in_front(tmp_path / "log.mcap", BODY, turns, COUNT)
    truth = Poses(sim.rotation, sim.translation)[0]
    turned = turned_round(truth)
    for cost, changes in ((1.3, True), (4.0, False)):
        found, end = way(run, turned, truth, cost)
        assert (end is not None) == changes and (error(sim, found).mean() < 0.03) == changes
    found, end = way(run, truth, turned, 1.3)
    assert end is None and error(sim, found).mean() < 0.03


@pytest.mark.parametrize("rate", [10, 30])
def test_going_ahead_is_counted_and_turning_is_not(rate):
    time = np.arange(0, 3, 1 / rate)
    place = np.zeros((len(time), BODY.limb_count, 3), np.float32)
    place[..., 0] = (0.5 * time)[:, None]

    def gone(yaw):
        rotation = np.zeros((len(time), BODY.limb_count, 4), np.float32)
        rotation[..., 0], rotation[..., 3] = np.cos(yaw / 2)[:, None], np.sin(yaw / 2)[:, None]
        return gone_ahead(BODY, time, Poses(rotation, place))

    assert gone(0 * time) == pytest.approx(1.35, abs=0.05)  # but for the last third of a second
    assert gone(0 * time + np.pi) == pytest.approx(-1.35, abs=0.05)
    assert gone(0 * time + np.pi / 2) == pytest.approx(0, abs=1e-5)
    assert gone(2 * np.pi * time) == 0
    place[len(time) // 2 :] = np.nan  # lost there
    assert 0.5 < gone(0 * time) < 0.75
