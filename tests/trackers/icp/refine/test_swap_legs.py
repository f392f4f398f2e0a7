"""Legs that took each other's points are exchanged again; legs that are crossed stay so."""

import numpy as np
import pytest

from tests.support.in_front import error, in_front
from tests.support.segments import tracked_segment
from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.model.pose_library import HIPS, exchanged
from voodoo_jax.trackers.icp.refine.stage import refined
from voodoo_jax.trackers.icp.refine.swap_legs import SwapLegs, crossed
from voodoo_jax.trackers.icp.runner import Session
from voodoo_jax.trackers.icp.segment import Followed, forwards, tracked_anew

BODY, COUNT = scaled(human(), 1.75), 30


def tracked(run, poses):
    return forwards(run, poses, 0, COUNT)


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    """Somebody who stands with feet apart and sways a little."""
    sway = 0.1 * np.sin(6 * np.arange(COUNT) / 30)[:, None] * np.array([0.0, 1.0, 0.0])
    apart = np.array([0.12, 0.0, 0.0])
    return in_front(
        tmp_path_factory.mktemp("steps") / "log.mcap", BODY, {"l_hip": sway + apart, "r_hip": -sway - apart}
    )


def test_exchanged_legs_are_crossed():
    body = on_host(BODY)
    rest = Poses(np.asarray(body.rest.rotation), np.asarray(body.rest.translation))
    other = exchanged(body, rest, HIPS)
    both = Poses(np.stack([rest.rotation, other.rotation]), np.stack([rest.translation, other.translation]))
    assert crossed(body, tracked_segment(both)).tolist() == [False, True]
    np.testing.assert_array_equal(exchanged(body, other, HIPS).translation, rest.translation)
    legs = {f"{side}_{limb}" for side in "lr" for limb in ("thigh", "shank", "foot")}
    moved = np.any(other.translation != rest.translation, -1)
    assert {name for name, there in zip(body.topology.limbs, moved) if there} == legs


def test_legs_on_the_other_ones_points_are_exchanged(steps):
    sim, run = steps
    truth = Poses(sim.rotation, sim.translation)
    wrong = tracked(run, exchanged(on_host(BODY), truth[0], HIPS))
    assert crossed(on_host(BODY), wrong)[5:].all() and error(sim, wrong)[5:].min() > 0.06  # it does not end by itself
    found = SwapLegs()(run, wrong)
    assert not crossed(on_host(BODY), found).any() and error(sim, found).max() < 0.04
    assert (found.first, found.end) == (wrong.first, wrong.end)
    # what is good stays as it is, to the last digit
    good = tracked(run, truth[0])
    assert SwapLegs()(run, good) is good


def test_legs_are_exchanged_as_often_as_they_were(steps, monkeypatch):
    """Who is tracked anew loses the legs again after eight frames: what is left is looked at once more."""
    sim, run = steps
    wrong = tracked(run, exchanged(on_host(BODY), Poses(sim.rotation, sim.translation)[0], HIPS))

    def for_a_while(run, poses, first, at, end):
        near[max(0, at - 8) : at + 9] = True
        return wrong[first:end].picked(tracked_anew(run, poses, first, at, end), near[first:end])

    monkeypatch.setattr("voodoo_jax.trackers.icp.refine.swap_legs.tracked_anew", for_a_while)
    left = []
    for rounds in (1, 3):
        near = np.zeros(COUNT, bool)
        left.append(int(crossed(on_host(BODY), SwapLegs(most=rounds)(run, wrong)).sum()))
    assert left[0] >= 5 > left[1]  # fewer than five frames are not worth a look


def test_legs_that_are_crossed_stay_so(tmp_path):
    """One knee before the other, ankles crossed."""
    cross = np.tile([-0.45, 0.0, 0.0], (COUNT, 1))
    sim, run = in_front(
        tmp_path / "log.mcap", BODY, {"l_hip": cross + [0.0, -0.5, 0.0], "r_hip": -cross + [0.0, 0.15, 0.0]}
    )
    good = tracked(run, Poses(sim.rotation, sim.translation)[0])
    assert crossed(on_host(BODY), good).all() and error(sim, good).mean() < 0.05
    assert error(sim, SwapLegs()(run, good)).mean() < 0.05


def test_bodies_without_knees_are_left_alone():
    run = object.__new__(Session)
    run.body = load_body("arm")
    run.settings, run.by_markers = Settings(), False
    segment = Followed.blank(3, run.body.limb_count)
    assert refined(run, segment, [SwapLegs()]) is segment


def test_who_crosses_the_legs_has_them_exchanged_where_that_explains_much_more(tmp_path):
    """Feet apart at first, then one knee before the other: with the legs exchanged fewer frames are crossed."""
    share = np.clip((np.arange(COUNT) - 8) / 6, 0, 1)[:, None]
    mix = lambda first, then: (1 - share) * np.array(first) + share * np.array(then)  # noqa: E731
    hips = {"l_hip": mix([0.12, 0, 0], [-0.45, -0.5, 0]), "r_hip": mix([-0.12, 0, 0], [0.45, 0.15, 0])}
    sim, run = in_front(tmp_path / "log.mcap", BODY, hips)
    truth = Poses(sim.rotation, sim.translation)
    wrong, good = (tracked(run, poses) for poses in (exchanged(on_host(BODY), truth[0], HIPS), truth[0]))
    body = on_host(BODY)
    assert crossed(body, wrong)[:8].all() and crossed(body, wrong).sum() < crossed(body, good).sum()
    # the last frame is farther from the crossed ones than is looked at
    assert error(sim, wrong).min() > 0.06 and error(sim, SwapLegs()(run, wrong))[:-1].max() < 0.02
