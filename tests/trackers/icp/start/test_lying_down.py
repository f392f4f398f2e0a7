"""Who lies is started from lying poses, with the head at the right end; who stands is not asked."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.in_front import in_front
from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import joint_centres, scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.records.observation import whole
from voodoo_jax.records.scene import Scene
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import motion_of_turns, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.solve.scan import options_from
from voodoo_jax.trackers.icp.initialise import begin
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis, measured_at, trial
from voodoo_jax.trackers.icp.start.lying_down import LyingDown, lying_places
from voodoo_jax.trackers.icp.start.stage import Search

BODY = scaled(human(), 1.75)


@pytest.mark.parametrize("head", [1.0, -1.0])
def test_who_lies_on_their_back_is_started_so(tmp_path, head):
    time = np.arange(8) / 15
    moved = motion_of_turns(BODY, time, {}, lean=np.tile(np.array([0.0, -np.pi / 2, 0.0], np.float32), (8, 1)))
    place = np.asarray(moved.root.translation) * [1, 1, 0] + [0, 0, 0.13]  # a trunk's half depth above the floor
    moved = replace(moved, root=Poses(moved.root.rotation, place.astype(np.float32)))
    sim = simulate(BODY, placed(moved, 3.0, 0.0, head * np.pi / 2), tof_camera(2.0, 0.6))
    recording, settings = read_log(write_simulation(sim, tmp_path / "lies.mcap")), Settings()
    scene = Scene(Plane(np.array([0, 0, 1], np.float32), 0.0), (), True)
    seen = [whole(f) for f in recording.frames]
    near = (0.8, 1.0, 0.2)  # without the box beside them
    people = [f.only(np.all(np.abs(f.points - [3, 0, 0.25]) < near, 1)) for f in seen]
    run = Runner(human(), options_from(settings.solve, settings.track, settings.features), people, scene, settings)
    start = begin(run, 0)
    names = BODY.topology.centres
    neck, hips = names.index("vc7"), [names.index("l_hip"), names.index("r_hip")]
    found = np.asarray(joint_centres(start.body, start.poses))
    trunk, true = (joints[neck] - joints[hips].mean(0) for joints in (found, sim.joints[0]))
    assert trunk @ true > 0.9 * np.linalg.norm(trunk) * np.linalg.norm(true)
    assert start.cost < 0.5 * trial(run, 0, measured_at(run, 0)).cost


def test_who_stands_is_not_asked(tmp_path, monkeypatch):
    _, run = in_front(tmp_path / "log.mcap", BODY, {}, 8)
    monkeypatch.setattr(Runner, "trials", lambda *_: pytest.fail("a lying start was tried"))
    start = StartHypothesis(0, BODY, BODY.rest, 1.0)
    assert LyingDown()(run, search := Search(0, start, (start,))) is search


def test_places_have_the_head_or_the_feet_at_each_end(tmp_path):
    _, run = in_front(tmp_path / "log.mcap", BODY, {}, 2)
    along = np.linspace(-0.5, 0.5, 400, dtype=np.float32)
    frame = run.people[0]
    line = np.column_stack([np.full(400, 3.0), along, 0.1 + 0 * along]).astype(np.float32)
    frame = replace(frame, points=line, sensor=np.zeros(400, np.int32), before=None, before_sensor=None)
    head = BODY.topology.limbs.index("head")
    ends = {True: set(), False: set()}
    for places, feet in zip(lying_places(BODY, frame, run.scene.floor), (True, False)):
        for poses in places:
            away = np.asarray(poses.translation[head] - poses.translation[0])
            assert abs(away[2]) < 0.1 and abs(away[1]) > 0.3
            ends[feet].add((bool(away[1] > 0), round(float(np.max(np.abs(poses.translation[:, 1]))), 1)))
    assert len(ends[True]) == len(ends[False]) == 2
    # of a body that is longer than what is seen, one list has more beyond the head's end, the other beyond the feet's
    assert {reach for _, reach in ends[True]} != {reach for _, reach in ends[False]}
