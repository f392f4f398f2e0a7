"""A person who may face the camera or not: what the learned eye sees decides, and costs without it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.in_front import error, in_front
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.trackers.icp.pipeline import SETTLE
from voodoo_jax.trackers.icp.refine.choose_facing import EVERY, ChooseFacing, turned_round
from voodoo_jax.trackers.icp.segment import forwards
from voodoo_jax.trackers.icp.stage import refined
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis, best_from
from voodoo_jax.trackers.icp.trials import facing
from voodoo_jax.trackers.shared.sequence import KnownStart

BODY, COUNT, UP = scaled(human(), 1.75), 3 * EVERY, np.array([0, 0, 1], np.float32)


def swinging(path, nearer: float = 0.0):
    """A person with feet apart who swings the arms in front of them, and comes nearer."""
    apart, swing = np.tile([0.12, 0.0, 0.0], (COUNT, 1)), np.zeros((COUNT, 3))
    swing[:, 1] = -0.5 - 0.4 * np.sin(6 * np.arange(COUNT) / 30)
    turns = {"l_hip": apart, "r_hip": -apart, "l_shoulder": swing, "r_shoulder": swing}
    sim, run = in_front(path, BODY, turns, COUNT, nearer)
    truth = Poses(sim.rotation, sim.translation)[0]
    return sim, run, truth, turned_round(truth, UP)


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    return swinging(tmp_path_factory.mktemp("seen") / "log.mcap")


def begun(run, poses):
    """The segment tracked from some poses in the first frame."""
    start = best_from(run, 0, BODY, [poses])._replace(poses=poses)
    return refined(run, replace(forwards(run, poses, 0, COUNT), start=start), SETTLE)


def test_a_body_that_began_back_to_front_is_turned_and_a_right_one_stays(seen):
    sim, run, truth, turned = seen
    right = begun(run, truth)
    kept = ChooseFacing()(run, right)
    assert error(sim, right).mean() < 0.03 and np.array_equal(kept.rotation, right.rotation)
    wrong = begun(run, turned)
    found = ChooseFacing()(run, wrong)
    assert error(sim, wrong).mean() > 0.1 and error(sim, found).mean() < 0.03
    assert (kept.facing_odds > 0.1).all() and (found.facing_odds > 0.1).all()


def test_without_later_frames_the_first_look_that_tells_turns_the_body(seen):
    sim, run, truth, turned = seen
    right, wrong = (forwards(run, poses, 0, COUNT) for poses in (truth, turned))
    kept, none = ChooseFacing().so_far(run, right)
    assert none is None and np.array_equal(kept.rotation, right.rotation) and (kept.facing_odds > 0.1).all()
    run.facing = 1.0  # of a look before: the next one is due in frame EVERY
    found, state = ChooseFacing().so_far(run, wrong[1:])
    assert state is not None and found.end == EVERY + 1 and (found.facing_odds > 0.1).all()
    np.testing.assert_array_equal(found.rotation[:-1], wrong.rotation[1:EVERY])
    other = forwards(run, state.poses, EVERY, COUNT)
    assert facing(BODY, other.rotation)[-1] @ facing(BODY, right.rotation)[-1] > 0.9


def test_only_the_stretch_that_is_back_to_front_is_tracked_again(seen):
    sim, run, truth, turned = seen
    right, later = begun(run, truth), np.arange(COUNT) >= 2 * EVERY
    wrong = right.spliced(0, begun(run, turned), later)
    found = ChooseFacing()(run, wrong)
    assert error(sim, found).mean() < 0.03
    np.testing.assert_array_equal(found.rotation[: EVERY // 2], right.rotation[: EVERY // 2])


def test_without_the_eye_both_ways_are_tracked(seen, monkeypatch):
    sim, run, truth, turned = seen
    monkeypatch.setattr(run, "person_in", lambda frame: None)
    for poses in (truth, turned):
        found = ChooseFacing()(run, begun(run, poses))
        assert error(sim, found).mean() < 0.03 and (found.facing_odds > 0.1).all()
        assert (found.state is not None) == (poses is turned)  # where the following frames begin
    on = replace(begun(run, turned), start=KnownStart(0, turned))
    assert ChooseFacing()(run, on) is on  # it goes on from frames that were asked


def test_without_the_eye_a_body_that_goes_is_taken_to_go_ahead(tmp_path):
    _, run, truth, turned = swinging(tmp_path / "log.mcap", 1.2)
    alike = begun(run, truth)
    ahead, back = (
        ChooseFacing()._rate(run, StartHypothesis(0, BODY, poses, 1.0), replace(alike, rotation=rotation))
        for poses, rotation in ((truth, alike.rotation), (turned, np.stack([turned.rotation] * COUNT)))
    )
    assert ahead - back > 0.5


def test_half_a_turn(seen):
    _, _, truth, turned = seen
    ahead, behind = (np.asarray(facing(BODY, poses.rotation)) for poses in (truth, turned))
    np.testing.assert_allclose(behind, ahead * [-1, -1, 1], atol=1e-5)
    np.testing.assert_allclose(turned.translation[0], truth.translation[0], atol=1e-5)
    np.testing.assert_allclose(turned.translation[:, 2], truth.translation[:, 2], atol=1e-5)
    again = turned_round(turned, UP)
    np.testing.assert_allclose(again.translation, truth.translation, atol=1e-5)
