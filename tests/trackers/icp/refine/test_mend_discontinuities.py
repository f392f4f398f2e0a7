"""Jumps of a passage: found, and one side carried on over the other one where that explains more."""

import numpy as np
import pytest

from tests.support.in_front import error, in_front
from tests.support.segments import tracked_segment
from voodoo_jax.geometry.rigid import Poses, compose, on_host
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.model.pose_library import HIPS, exchanged
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Status
from voodoo_jax.trackers.icp.refine import restart_limbs
from voodoo_jax.trackers.icp.refine.forward_backward import ForwardBackward
from voodoo_jax.trackers.icp.refine.mend_discontinuities import MendDiscontinuities
from voodoo_jax.trackers.icp.refine.restart_limbs import RestartLimbs
from voodoo_jax.trackers.icp.segment import forwards
from voodoo_jax.trackers.icp.trials import turns_about

BODY, COUNT = scaled(human(), 1.75), 30


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Somebody who stands with feet apart and sways a little: what is so, the session, what is tracked from there,
    and that with the legs exchanged."""
    sway = 0.1 * np.sin(6 * np.arange(COUNT) / 30)[:, None] * np.array([0.0, 1.0, 0.0])
    apart = np.array([0.12, 0.0, 0.0])
    log = tmp_path_factory.mktemp("jumps") / "log.mcap"
    sim, run = in_front(log, BODY, {"l_hip": sway + apart, "r_hip": -sway - apart})
    start = Poses(sim.rotation, sim.translation)[0]
    tracked = lambda poses: forwards(run, poses, 0, COUNT)  # noqa: E731
    good, wrong = tracked(start), tracked(exchanged(on_host(BODY), start, HIPS))
    assert error(sim, good).max() < 0.03 and error(sim, wrong).min() > 0.06
    return sim, run, good, wrong


def put_together(first, second, at):
    return first[:at].joined(second[at:])


def moving(places) -> Segment:
    """A body that is at these places along x."""
    rest = on_host(BODY.rest)
    shift = np.asarray(places, np.float32)[:, None, None] * np.array([1, 0, 0], np.float32)
    return tracked_segment(Poses(np.tile(rest.rotation, (len(places), 1, 1)), rest.translation + shift))


def test_what_goes_much_farther_than_before_and_after_jumps():
    still = np.zeros(10)
    assert MendDiscontinuities().jumps(BODY, moving(still)) == []
    stepped = np.where(np.arange(10) < 4, 0.0, 0.3)
    stepped[7:] += 0.5
    assert MendDiscontinuities().jumps(BODY, moving(stepped)) == [7, 4]  # the farthest first
    assert MendDiscontinuities().jumps(BODY, moving(0.4 * np.arange(10))) == []  # fast all the time
    started = np.cumsum([0, 0, 0.1, 0.25, 0.35, 0.25, 0.1, 0, 0])
    assert MendDiscontinuities().jumps(BODY, moving(started)) == []
    gone = moving(stepped)
    gone.status[4] = Status.LOST
    assert MendDiscontinuities().jumps(BODY, gone) == [7]
    assert MendDiscontinuities().jumps(BODY, moving(still[:1])) == []
    foot = moving(still)
    foot.translation[5:, BODY.topology.limbs.index("l_foot")] += np.float32(0.4)
    assert MendDiscontinuities().jumps(BODY, foot) == []


def test_nobody_is_turned_round_from_one_frame_to_the_next(seen):
    """Then the other side is carried on though it explains no more; of exchanged legs it is not."""
    sim, run, good, wrong = seen
    about, middle = np.array([0, 0, 0, 1], np.float32), np.asarray(sim.translation[0, 0]) * [1, 1, 0]
    back = compose(Poses(about, (2 * middle).astype(np.float32)), Poses(sim.rotation, sim.translation)[0])
    turned = forwards(run, on_host(back), 0, COUNT)
    mend = MendDiscontinuities(better=0.0)
    found = mend(run, put_together(good, turned, 17))
    assert error(sim, found).max() < 0.03 and mend.jumps(BODY, found) == []
    segment = put_together(good, wrong, 17)
    assert mend(run, segment) is segment


class Middle(ForwardBackward):
    """All that is tracked anew is better, but for the ends."""

    def is_better(self, cost, other):
        return (np.arange(len(cost)) > 5) & (np.arange(len(cost)) < len(cost) - 5)


def test_a_stretch_that_is_tracked_anew_does_not_turn_the_body_round(seen, monkeypatch):
    sim, run, good, wrong = seen
    about, middle = np.array([0, 0, 0, 1], np.float32), np.asarray(sim.translation[0, 0]) * [1, 1, 0]
    back = compose(Poses(about, (2 * middle).astype(np.float32)), Poses(sim.rotation, sim.translation)[0])
    turned = forwards(run, on_host(back), 0, COUNT)
    restart = RestartLimbs(better=np.inf, passes=Middle())
    for anew, taken in ((good, True), (turned, False)):
        monkeypatch.setattr(restart_limbs, "tracked_anew", lambda run, poses, first, at, end, x=anew: x[first:end])
        found = restart._looked(run, wrong, 10, 20)
        assert (found is not wrong) == taken
        assert not turns_about(run.body, found.rotation, run.people).any()
    both = put_together(good, turned, 10)
    assert np.flatnonzero(turns_about(run.body, both.rotation, run.people)).tolist() == [9]


@pytest.mark.parametrize("good_first", [True, False])
def test_the_side_that_explains_more_is_carried_on(seen, good_first):
    sim, run, good, wrong = seen
    segment = put_together(good, wrong, 17) if good_first else put_together(wrong, good, 13)
    assert MendDiscontinuities().jumps(BODY, segment)
    found = MendDiscontinuities()(run, segment)
    assert error(sim, found).max() < 0.03 and MendDiscontinuities().jumps(BODY, found) == []
    assert (found.first, found.end) == (segment.first, segment.end)


def test_a_stretch_between_two_jumps(seen):
    sim, run, good, wrong = seen
    segment = put_together(put_together(good, wrong, 10), good, 20)
    assert len(MendDiscontinuities().jumps(BODY, segment)) == 2
    found = MendDiscontinuities()(run, segment)
    assert error(sim, found).max() < 0.03
    # what the sides agree on stays as it was, to the last digit
    np.testing.assert_array_equal(found.rotation[:10], good.rotation[:10])


def test_what_does_not_jump_stays_as_it_is(seen):
    _, run, good, wrong = seen
    assert MendDiscontinuities()(run, good) is good
    assert MendDiscontinuities()(run, wrong) is wrong
