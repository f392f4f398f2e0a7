"""What the learned eye sees: voxels of points, poses of joints, people who are turned and who are nobody."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.in_front import in_front
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.kernels.eye import JOINTS
from voodoo_jax.model.body import joint_centres, scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.trackers.icp.refine.choose_facing import turned_round
from voodoo_jax.trackers.icp.start.hypothesis import best_from, trial, turned
from voodoo_jax.trackers.icp.trials import facing
from voodoo_jax.trackers.shared import eye

BODY = scaled(human(), 1.75)
CHILD = """
import os, sys
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: int(sys.argv[1])])
import numpy as np
from voodoo_jax.trackers.shared import eye
points = np.random.default_rng(0).normal([0, 0, 1.0], [0.2, 0.25, 0.3], (300, 3))
said = eye.predict(eye.weights(), eye.tokens(points)[0], np.array([2.0, 1.2], np.float32))
print(b"".join(np.asarray(each).tobytes() for each in said).hex())
"""


def joints_of(poses: Poses) -> np.ndarray:
    centres = np.asarray(joint_centres(BODY, poses))
    return centres[[BODY.topology.centres.index(name) for name in JOINTS]]


@pytest.fixture(scope="module")
def somebody(tmp_path_factory):
    """Who stretches out the left arm, before they are started."""
    turn = np.tile([1.2, 0.0, 0.0], (12, 1))
    return in_front(tmp_path_factory.mktemp("eye") / "log.mcap", BODY, {"l_shoulder": turn}, 12)


def test_it_sees_where_joints_are_and_which_way_they_face(somebody):
    sim, run = somebody
    person = run.person_in(run.people[0])
    truth = sim.joints[0][[BODY.topology.centres.index(name) for name in JOINTS]]
    assert person is not None
    away = np.linalg.norm(person.joints - truth, axis=1)
    assert away.mean() < 0.12 and person.spread.mean() < 0.2
    assert person.front @ facing(BODY, sim.rotation[:1])[0] > 2


def test_it_sees_the_same_wherever_up_is(somebody):
    _, run = somebody
    frame, floor = run.people[0], run.scene.floor
    turn, shift = Rotation.from_euler("xyz", [0.7, -0.4, 2.0]).as_matrix(), np.array([3.0, -2.0, 1.0])
    moved = replace(
        frame,
        points=(frame.points @ turn.T + shift).astype(np.float32),
        origins=(frame.origins @ turn.T + shift).astype(np.float32),
    )
    normal = (turn @ floor.normal).astype(np.float32)
    one, other = eye.seen(frame, floor), eye.seen(moved, Plane(normal, float(floor.offset + normal @ shift)))
    assert one is not None and other is not None
    np.testing.assert_allclose(one.joints @ turn.T + shift, other.joints, atol=0.03)
    fronts = np.stack([turn @ one.front, other.front])
    odds = np.linalg.norm(fronts, axis=1)
    assert odds.min() > 3 and fronts[0] @ fronts[1] > np.cos(np.radians(5)) * odds.prod()


def test_voxels_hold_all_points_about_the_column():
    points = np.random.default_rng(0).normal([0, 0, 1.0], [0.2, 0.25, 0.3], (300, 3))
    made, at = eye.tokens(np.concatenate([points, [[2.0, 0, 1], [0, 0, 2.6]]]))
    count = np.round(9 * made[:, -1])
    assert made.shape == (eye.TOKENS, eye.FEATURES) and np.all(at[-2:] == -1)
    assert np.array_equal(np.bincount(at[at >= 0], minlength=eye.TOKENS), count)
    for k in range(5):
        np.testing.assert_allclose(made[k, :3], points[at[:-2] == k].mean(0), rtol=1e-5)
        np.testing.assert_allclose(made[k, 3:6], 400 * points[at[:-2] == k].var(0), atol=1e-3)
    assert not eye.tokens(np.zeros((0, 3)))[0].any()


def test_the_body_takes_on_the_joints_that_are_seen(somebody):
    sim, run = somebody
    wanted = sim.joints[0][[BODY.topology.centres.index(name) for name in JOINTS]]
    person = eye.Seen(wanted, np.full(len(JOINTS), 0.1), np.zeros(3), np.ones(1))
    poses = eye.poses_of(BODY, person)
    assert poses is not None and np.linalg.norm(joints_of(poses) - wanted, axis=1).max() < 0.03
    assert eye.poses_of(BODY, person._replace(spread=np.ones(len(JOINTS)))) is None
    assert eye.poses_of(load_body("arm"), person) is None


def test_dogs_and_unknown_floors_are_not_looked_at(somebody):
    _, run = somebody
    run = run.anew(run.people)
    run.scene = replace(run.scene, floor_open=True)
    assert run.person_in(run.people[0]) is None
    run.scene, run.body = replace(run.scene, floor_open=False), load_body("dog")
    assert run.person_in(run.people[0]) is None


def test_a_start_that_is_turned_costs_more(somebody, monkeypatch):
    """By the odds of its facing."""
    _, run = somebody
    right = on_host(trial(run, 0, BODY).poses)
    wrong = turned_round(right, run.scene.floor.normal)
    costs = [best_from(run, 0, BODY, [poses]).cost for poses in (right, wrong)]
    front = run.person_in(run.people[0]).front
    assert turned(BODY, right.rotation[None], front) == 1 and turned(BODY, wrong.rotation[None], front) > 2
    monkeypatch.setattr(run, "person_in", lambda frame: None)
    plain = [best_from(run, 0, BODY, [poses]).cost for poses in (right, wrong)]
    assert costs[0] == pytest.approx(plain[0]) and costs[1] > 1.5 * plain[1]


def test_processes_and_threads_say_the_same_to_the_last_bit():
    """One process on one processor, one on all."""
    said = [
        subprocess.run([sys.executable, "-c", CHILD, n], capture_output=True, check=True, text=True).stdout.strip()
        for n in ("1", "256")
    ]
    assert len(said[0]) > 8 * len(JOINTS) and said[0] == said[1]
