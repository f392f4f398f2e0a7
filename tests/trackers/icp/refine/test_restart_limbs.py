"""Arms that were lost are found again where the passage explains too little."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.in_front import error, in_front
from voodoo_jax.geometry.rigid import Poses, apply, on_host
from voodoo_jax.model.body import joint_centres, scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.segment import Segment
from voodoo_jax.simulate.motion import motion_of_turns, placed, pose_body
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.trackers.icp.refine.restart_limbs import RestartLimbs, other_arms, other_legs
from voodoo_jax.trackers.icp.segment import forwards
from voodoo_jax.trackers.icp.trials import too_fast

BODY = scaled(human(), 1.75)


def frames(noise) -> list[BodyObservation]:
    nothing = np.zeros((0, 3), np.float32)
    return [BodyObservation(0, nothing, np.zeros(0, np.int32), nothing, noise=float(n)) for n in noise]


def doubted(people, cost, tracked=True):
    return RestartLimbs().in_doubt(people, np.asarray(cost, float), np.full(len(cost), tracked))


def test_what_costs_more_than_noise_and_the_rest_is_in_doubt():
    people = frames([0.01] * 60)
    cost = np.full(60, 4e-4)
    assert doubted(people, cost) == []
    cost[20:40] = 12e-4
    ((start, end),) = doubted(people, cost)
    assert 16 <= start <= 22 and 38 <= end <= 44
    assert doubted(people, cost, False) == []
    # the farther away, the noisier
    noise = np.linspace(0.01, 0.06, 60)
    far = frames(noise)
    assert doubted(far, np.maximum(noise, 0.018) ** 2) == []
    cost[:] = 4e-4
    cost[40] = 1e-3  # a single frame
    assert doubted(people, cost) == []
    assert doubted([], []) == []


@pytest.mark.parametrize(("rate", "turned", "found"), [(30, 2.6, 2), (30, 0.3, 0), (5, 2.6, 0)])
def test_an_arm_that_is_faster_than_people_is_noticed(rate, turned, found):
    """An arm is somewhere else for one of six frames."""
    turns = np.zeros((6, 3))
    turns[3, 0] = -turned
    moves = motion_of_turns(BODY, np.arange(6) / rate, {"l_shoulder": turns})
    moved = on_host(pose_body(BODY, moves.root, moves.rotations))
    people = [replace(frame, time_ns=round(k * 1e9 / rate)) for k, frame in enumerate(frames([0.01] * 6))]
    segment = replace(Segment.blank(6, BODY.limb_count), rotation=moved.rotation, translation=moved.translation)
    assert too_fast(BODY, segment, people) == found


def test_long_trouble_is_looked_at_in_parts():
    people = frames([0.01] * 200)
    cost = np.where(np.arange(200) < 100, 4e-4, 12e-4)
    found = doubted(people, cost)
    assert len(found) >= 3 and max(end - start for start, end in found) == RestartLimbs.longest
    assert [b for _, b in found[:-1]] == [a for a, _ in found[1:]]


def test_frames_that_cost_no_more_than_their_noise_are_plain_where_both_passes_agree():
    people, segment = frames([0.02] * 60), Segment.blank(60, 3)
    segment.cost[:], segment.passes_apart[:] = 0.018**2, 0.02
    segment.cost[20:40] = 0.025**2
    assert RestartLimbs().plain(people, segment).tolist() == [not 18 <= k < 42 for k in range(60)]
    segment.passes_apart[50, 1] = 0.3  # one limb is elsewhere in the other pass
    segment.passes_apart[55] = np.nan  # there was no other pass
    assert np.flatnonzero(~RestartLimbs().plain(people, segment)).tolist() == [*range(18, 42), 50, 55]
    assert not RestartLimbs().plain(frames([0.0] * 60), segment).any()  # nobody knows the noise
    cost, plain = np.where(np.arange(60) < 30, 0.010**2, 0.018**2), np.arange(60) < 60
    assert doubted(people, cost) and RestartLimbs().in_doubt(people, cost, plain, plain) == []


def test_other_arms_hang_on_the_same_shoulders():
    t, poses = BODY.topology, placed_poses()
    found = other_arms(BODY, poses)
    assert len(found) == 12
    arms = [t.limbs.index(f"{side}_{limb}") for side in "lr" for limb in ("upper_arm", "forearm", "hand")]
    parents, children = jnp.array(t.parents), jnp.array(t.children)
    wrists = []
    for other in found:
        first = apply(other[parents], BODY.parent_anchor.translation)
        second = apply(other[children], BODY.child_anchor.translation)
        np.testing.assert_allclose(first, second, atol=1e-4)
        rest = np.setdiff1d(np.arange(len(t.limbs)), arms)
        np.testing.assert_array_equal(other.rotation[rest], poses.rotation[rest])
        wrists.append(np.asarray(joint_centres(BODY, other))[[t.centres.index(f"{s}_radiocarpal") for s in "lr"]])
    heights = np.array(wrists)[..., 2].round(2)
    assert len(np.unique(heights, axis=0)) >= 9 and heights.max() > 1.8 and heights.min() < 0.9
    assert all(other_arms(load_body(name), load_body(name).rest) == [] for name in ("dog", "arm"))


def placed_poses() -> Poses:
    sim = simulate(BODY, placed(motion_of_turns(BODY, np.arange(1) / 30, {}), 3.2, 0.3, 2.8), tof_camera())
    return Poses(sim.rotation[0], sim.translation[0])


@pytest.fixture(scope="module")
def raised(tmp_path_factory):
    """Somebody who holds both arms up, and moves them a little."""
    time, up = np.arange(30) / 30, np.array([2.8, 0.0, 0.0])
    wave = 0.15 * np.sin(8 * time)[:, None] * np.array([1.0, 0, 0])
    turns = {"l_shoulder": up + wave, "r_shoulder": -up + wave}
    return in_front(tmp_path_factory.mktemp("up") / "up.mcap", BODY, turns)


def lost_on_the_way(sim, run, other):
    """A segment tracked from the truth, and the same with other poses from frame 12 on."""
    truth, count = Poses(sim.rotation, sim.translation), len(sim.time_ns)
    good = forwards(run, truth[0], 0, count)
    return good, good[:12].joined(forwards(run, other(truth[12]), 12, count))


def test_a_lost_arm_is_found_again(raised):
    sim, run = raised
    good, wrong = lost_on_the_way(sim, run, lambda poses: other_arms(BODY, poses)[0])
    assert error(sim, wrong)[16:].min() > 0.1  # it does not come back by itself
    found = RestartLimbs()(run, wrong)
    assert error(sim, found).max() < 0.06
    assert (found.first, found.end) == (wrong.first, wrong.end)
    # what is good stays as it is, to the last digit
    again = RestartLimbs()(run, good)
    np.testing.assert_array_equal(again.rotation, good.rotation)


def test_a_lost_leg_is_found_again(tmp_path):
    """One leg kicks towards the camera, and is tracked as if it were bent backwards."""
    kick = {"l_hip": np.tile([0.0, -1.4, 0.0], (22, 1))}
    sim, run = in_front(tmp_path / "leg.mcap", BODY, kick, 22)
    _, wrong = lost_on_the_way(sim, run, lambda poses: other_legs(BODY, poses)[8])
    assert error(sim, wrong)[16:].min() > 0.1  # it does not come back by itself
    assert error(sim, RestartLimbs()(run, wrong)).max() < 0.04
