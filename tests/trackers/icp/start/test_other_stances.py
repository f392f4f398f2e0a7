"""Starts with arms raised or sitting."""

import numpy as np
import pytest
from jaxtyping import Float

from tests.support.in_front import in_front
from voodoo_jax.config.options import Settings
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import Body, joint_centres, scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.model.pose_library import STANCES
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import motion_of_turns, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.trackers.front import track
from voodoo_jax.trackers.icp.initialise import begin
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis

BODY = scaled(human(), 1.75)


def centre(body: Body, name: str) -> Float[np.ndarray, "3"]:
    return np.asarray(joint_centres(body, body.rest))[body.topology.centres.index(name)]


def test_somebody_with_raised_arms_is_found(tmp_path):
    """From the first frame on; the hands are what is highest."""
    time, up = np.arange(24) / 30, np.array([2.8, 0.0, 0.0])
    wave = 0.15 * np.sin(8 * time)[:, None] * np.array([1.0, 0, 0])
    moved = motion_of_turns(BODY, time, {"l_shoulder": up + wave, "r_shoulder": -up + wave})
    sim = simulate(BODY, placed(moved, 3.2, 0.0, np.pi), tof_camera(1.2, 0.0))
    tracks = track(human(), read_log(write_simulation(sim, tmp_path / "raised.mcap")), Settings())
    error = np.linalg.norm(tracks.joints - sim.joints, axis=-1)
    assert tracks.tracked.all() and error.mean() < 0.06
    assert float(tracks.body.scale) == pytest.approx(1.75, rel=0.08)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Somebody of 1.75 m who stands, before they are started."""
    _, run = in_front(tmp_path_factory.mktemp("stands") / "log.mcap", BODY, {}, 8)
    return lambda: run.anew(run.people)


def test_who_sat_before_the_chair_was_taken_away_sits(session, monkeypatch):
    """Where that costs hardly more than to stand or to raise an arm."""

    def trial(run, at, body, before=None, rest=None):
        if rest is None:
            return StartHypothesis(at, body, body.rest, 10e-4)
        sits = centre(rest, "l_knee")[0] > centre(rest, "l_hip")[0] + 0.2
        return StartHypothesis(at, body, rest.rest, 11e-4 if sits else 9e-4)

    for module in ("initialise", "start.other_stances"):
        monkeypatch.setattr(f"voodoo_jax.trackers.icp.{module}.trial", trial)
    run = session()
    run.stances = {}
    assert begin(run, 0).cost == 10e-4 and run.stances == {}
    run = session()
    run.stances, run.sized = {0: STANCES[-1]}, True  # else the size counts, too
    assert begin(run, 0).cost == 11e-4 and run.stances == {0: STANCES[-1]}


@pytest.mark.parametrize(("cost", "sits"), [(6e-4, False), (1e-4, True)])
def test_who_would_be_unusually_tall_if_they_sat_must_fit_well(session, monkeypatch, cost, sits):
    """Somebody in a skirt: none of the starts fits; and somebody who fits well where they sit."""

    def trial(run, at, body, before=None, rest=None):
        seated = rest is not None and centre(rest, "l_knee")[0] > centre(rest, "l_hip")[0] + 0.2
        return StartHypothesis(at, rest or body, (rest or body).rest, cost if seated else 10e-4)

    for module in ("initialise", "start.other_stances"):
        monkeypatch.setattr(f"voodoo_jax.trackers.icp.{module}.trial", trial)
    run = session()
    run.stances = {}
    assert (begin(run, 0).cost == cost) == sits and bool(run.stances) == sits
