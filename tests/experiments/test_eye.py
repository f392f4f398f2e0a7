"""The learned eye of experiments/eye, without its training: postures, what a sensor sees, the net, the start."""

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from experiments.common import human
from experiments.eye import net, render
from experiments.eye.data import BACKGROUND, JOINTS, Scene, seen
from experiments.eye.postures import drawn
from experiments.eye.start import NAMES, poses_of
from experiments.people.motions import PARENT, Clip

REST = Clip(dict.fromkeys(PARENT, Rotation.identity(1)), np.zeros((1, 3)))


def test_a_seed_gives_the_same_postures():
    first, again, other = (drawn(np.random.default_rng(seed), 40, [REST]) for seed in (3, 3, 4))
    for name, turn in first.clip.turns.items():
        assert np.array_equal(turn.as_quat(), again.clip.turns[name].as_quat())
    assert len(set(first.kind)) > 6 and not np.array_equal(first.kind, other.kind)


def test_points_lie_on_what_is_there_and_are_labelled():
    scene = Scene()
    scene.ball((0, 0, 1.0), (0.3, 0.3, 0.3), label=4)
    scene.box((0, 0, -0.05), (16, 16, 0.1))
    points, labels = seen(scene, np.random.default_rng(0), np.array([2.0, 0.3, 1.4]), np.array([0, 0, 0.9]))
    ball, floor = points[labels == 4], points[labels == BACKGROUND]
    assert len(ball) > 100 and len(floor) > 100
    assert np.median(np.abs(np.linalg.norm(ball - [0, 0, 1.0], axis=1) - 0.3)) < 0.03
    assert np.median(np.abs(floor[:, 2])) < 0.03


def _tokens(points: np.ndarray) -> np.ndarray:
    tok = np.zeros((1, render.TOKENS, render.FEATURES), np.float32)
    hist, at = np.zeros((render.TOKENS, render.CLASSES), np.float32), np.empty(len(points), np.int32)
    render.tokens(points, np.full(len(points), 255, np.uint8), tok[0], hist, at)
    return tok


def test_the_net_hardly_minds_the_order_of_points_nor_where_padding_is():
    rng = np.random.default_rng(0)
    points = rng.normal([0, 0, 1.0], [0.2, 0.25, 0.3], (300, 3))
    params, sensor = net.init(jax.random.PRNGKey(0)), np.array([[2.0, 1.2]], np.float32)
    one, two = (net.told(params, _tokens(points[order]), sensor) for order in (np.arange(300), rng.permutation(300)))
    assert np.allclose(one["joints"], two["joints"], atol=1e-4) and np.allclose(one["odds"], two["odds"], atol=1e-3)


def test_left_and_right_are_told_by_facing():
    joints = np.zeros((1, len(JOINTS), 3), np.float32)
    joints[0, net.LEFT, 1], joints[0, net.RIGHT, 1] = 0.2, -0.2  # faces +x
    ahead, back = (np.exp(4 * np.cos(net.MIDDLES - way))[None] for way in (0.0, np.pi))
    assert net.front_odds(dict(joints=joints, facing=np.log(ahead)))[0] > 2
    assert net.front_odds(dict(joints=joints, facing=np.log(back)))[0] < -2
    assert np.array_equal(net.OTHER_JOINT[net.OTHER_JOINT], np.arange(len(JOINTS)))


def test_the_body_takes_on_the_joints_that_are_seen():
    body = human()
    centres, limbs = body.topology.centres, np.array(body.topology.centre_limbs)
    turn = Rotation.from_quat(np.asarray(body.rest.rotation)[limbs], scalar_first=True)
    world = turn.apply(np.asarray(body.centres)) + np.asarray(body.rest.translation)[limbs]
    rows = [centres.index(NAMES.get(name, name)) for name in JOINTS]
    way = Rotation.from_euler("xyz", [0.3, 0.8, 2.0])
    wanted = way.apply(world[rows]) + [1.0, 2.0, 0.5]
    poses = poses_of(body, wanted, np.ones(len(JOINTS), bool))
    turned = Rotation.from_quat(poses.rotation[limbs], scalar_first=True)
    found = (turned.apply(np.asarray(body.centres)) + poses.translation[limbs])[rows]
    assert np.linalg.norm(found - wanted, axis=1).max() < 0.03
