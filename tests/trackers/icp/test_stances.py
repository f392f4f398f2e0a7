"""Poses to start from beside the rest pose, and starts that might as well face the other way."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

from voodoo_jax.config.options import Settings
from voodoo_jax.detect.pipeline import find_person
from voodoo_jax.geometry.rigid import Poses, apply
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import Body, joint_centres, scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.model.pose_library import STANCES, in_stance
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import _motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.solve.scan import at_rest, options_from
from voodoo_jax.trackers.icp import initialise
from voodoo_jax.trackers.icp.body_size import unlikely
from voodoo_jax.trackers.icp.initialise import Beginning, begin
from voodoo_jax.trackers.icp.runner import Session
from voodoo_jax.trackers.icp.tracker import track
from voodoo_jax.trackers.icp.trials import Trial, opposite

BODY = scaled(human(), 1.75)


def centre(body: Body, name: str) -> Float[np.ndarray, "3"]:
    return np.asarray(joint_centres(body, body.rest))[body.topology.centres.index(name)]


@pytest.mark.parametrize("stance", STANCES)
def test_joints_hold_together_and_the_feet_stay_down(stance):
    posed = in_stance(BODY, stance)
    assert posed is not None
    t = posed.topology
    parents, children = jnp.array(t.parents), jnp.array(t.children)
    first = apply(posed.rest[parents], posed.parent_anchor.translation)
    second = apply(posed.rest[children], posed.child_anchor.translation)
    np.testing.assert_allclose(first, second, atol=1e-5)
    lowest = float(jnp.min(BODY.rest.translation[:, 2]))
    assert float(jnp.min(posed.rest.translation[:, 2])) == pytest.approx(lowest, abs=1e-5)


def test_arms_go_up_and_knees_forward():
    left, right, both, seated = (in_stance(BODY, s) for s in STANCES)
    assert left and right and both and seated
    head = centre(BODY, "skullbase")[2]
    for body, up, down in ((left, "l", "r"), (right, "r", "l")):
        assert centre(body, f"{up}_radiocarpal")[2] > head > centre(body, f"{down}_radiocarpal")[2]
    assert min(centre(both, f"{s}_radiocarpal")[2] for s in "lr") > head
    knee, hip = centre(seated, "l_knee"), centre(seated, "l_hip")
    assert knee[0] > hip[0] + 0.35 and abs(knee[2] - hip[2]) < 0.1
    assert centre(seated, "l_talocrural")[2] == pytest.approx(centre(BODY, "l_talocrural")[2], abs=0.05)


def test_who_is_no_person_has_none():
    assert all(in_stance(load_body(name), stance) is None for name in ("dog", "arm") for stance in STANCES)


def test_opposite_is_the_best_that_faces_away():
    turn = jnp.array([[1.0, 0, 0, 0], [0.9848, 0, 0, 0.1736], [0, 0, 0, 1.0], [0.1736, 0, 0, 0.9848]])
    rest = BODY.rest.rotation
    poses = Poses(jnp.repeat(turn[:, None], len(rest), 1), jnp.zeros((4, len(rest), 3)))
    body = eqx.tree_at(lambda b: b.rest.rotation, BODY, jnp.tile(jnp.array([1.0, 0, 0, 0]), (len(rest), 1)))
    trial = lambda *cost: Trial(at_rest(poses), jnp.array(cost))  # noqa: E731
    assert opposite(body, trial(1.0, 1.01, 1.08, 1.05), 1.1) == [0, 3]
    assert opposite(body, trial(1.0, 1.01, 1.3, 1.2), 1.1) == [0]
    assert opposite(body, trial(1.2, 1.21, 1.1, 1.3), 1.1) == [2, 0]


def test_somebody_with_raised_arms_is_found(tmp_path):
    """From the first frame on; the hands are what is highest."""
    time, up = np.arange(24) / 30, np.array([2.8, 0.0, 0.0])
    wave = 0.15 * np.sin(8 * time)[:, None] * np.array([1.0, 0, 0])
    moved = _motion(BODY, time, {"l_shoulder": up + wave, "r_shoulder": -up + wave})
    sim = simulate(BODY, placed(moved, 3.2, 0.0, np.pi), tof_camera(1.2, 0.0))
    tracks = track(human(), read_log(write_simulation(sim, tmp_path / "raised.mcap")), Settings())
    error = np.linalg.norm(tracks.joints - sim.joints, axis=-1)
    assert tracks.tracked.all() and error.mean() < 0.06
    assert float(tracks.body.scale) == pytest.approx(1.75, rel=0.08)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Somebody of 1.75 m who stands, before they are started."""
    sim = simulate(BODY, placed(_motion(BODY, np.arange(8) / 30, {}), 3.2, 0.0, np.pi), tof_camera(1.2, 0.0))
    recording, settings = read_log(write_simulation(sim, tmp_path_factory.mktemp("stands") / "log.mcap")), Settings()
    body = human()
    scene, people = find_person(recording, recording.up, body, settings)
    options = options_from(settings.solve, settings.track, settings.features)
    return lambda: Session(body, options, people, scene, settings)


def test_who_sat_before_the_chair_was_taken_away_sits(session, monkeypatch):
    """Where that costs hardly more than to stand or to raise an arm."""

    def trial(run, at, body, before=None, rest=None):
        if rest is None:
            return Beginning(at, body, body.rest, 10e-4)
        sits = centre(rest, "l_knee")[0] > centre(rest, "l_hip")[0] + 0.2
        return Beginning(at, rest, rest.rest, 11e-4 if sits else 9e-4)

    monkeypatch.setattr("voodoo_jax.trackers.icp.initialise._trial", trial)
    run = session()
    assert begin(run, 0).cost == 10e-4 and run.stances == {}
    run = session()
    run.stances = {0: STANCES[3]}
    assert begin(run, 0).cost == 11e-4 and run.stances == {0: STANCES[3]}


def test_nobody_is_two_and_a_half_metres_tall(session):
    """What a start costs tells of the size, too; not where the size is known, nor of a dog."""
    assert [unlikely(scaled(BODY, size)) for size in (1.2, 1.75, 2.0)] == [1, 1, 1]
    assert unlikely(scaled(BODY, 2.1)) == pytest.approx(np.e, rel=1e-3) and unlikely(scaled(BODY, 2.5)) > 100
    assert unlikely(scaled(load_body("dog"), 3.0)) == 1
    run, giant = session(), scaled(human(), 2.3)
    costs = [initialise._trial(run, 0, giant).cost]
    run.body = giant
    costs.append(initialise._trial(run, 0, giant).cost)
    assert costs[0] == pytest.approx(unlikely(giant) * costs[1], rel=1e-5)
