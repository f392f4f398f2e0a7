"""The learned eye of experiments/eye, without its training: postures, what a sensor sees, the net."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.eye import net
from experiments.eye.data import BACKGROUND, CLASSES, JOINTS, Scene, seen
from experiments.eye.postures import drawn
from experiments.eye.voxels import tokens_and_labels
from experiments.people.motions import PARENT, Clip
from voodoo_jax.kernels.eye import DIRECTIONS, LEFT, NECK, OTHER, RIGHT, Prediction, ahead, forward, named
from voodoo_jax.kernels.eye import JOINTS as NAMES
from voodoo_jax.trackers.shared.eye import TOKENS, tokens

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


def test_the_net_hardly_minds_the_order_of_points_nor_where_padding_is():
    rng = np.random.default_rng(0)
    points = rng.normal([0, 0, 1.0], [0.2, 0.25, 0.3], (300, 3))
    params, sensor = net.init(jax.random.PRNGKey(0)), np.array([2.0, 1.2], np.float32)
    told = jax.jit(lambda *given: named(forward(*given)))
    one, two = (told(params, tokens(points[order])[0], sensor) for order in (np.arange(300), rng.permutation(300)))
    assert np.allclose(one[0].joints, two[0].joints, atol=1e-4) and np.allclose(one[1], two[1], atol=1e-3)


def test_the_names_of_the_net_are_those_of_the_figures():
    alias = {"radiocarpal": "wrist", "talocrural": "ankle"}
    assert tuple("_".join(alias.get(word, word) for word in name.split("_")) for name in NAMES) == JOINTS


def test_a_step_of_learning_makes_the_loss_smaller():
    rng, params = np.random.default_rng(0), net.init(jax.random.PRNGKey(0))
    batch = dict(
        tok=np.stack([tokens(rng.normal([0, 0, 1.0], 0.25, (200, 3)))[0] for _ in range(2)]),
        hist=rng.random((2, TOKENS, CLASSES)).astype(np.float32), joints=np.zeros((2, len(JOINTS), 3), np.float32),
        sensor=np.ones((2, 2), np.float32), has=np.ones(2, np.float32), care=np.ones(2, np.float32),
    )  # fmt: skip
    sloping = jax.jit(jax.value_and_grad(net.loss, has_aux=True))
    (before, _), slope = sloping(params, batch)
    (after, _), _ = sloping(jax.tree.map(lambda p, g: p - 1e-3 * g, params, slope), batch)
    assert after < before


@pytest.mark.parametrize("lying", [False, True])
def test_left_and_right_are_told_by_facing(lying):
    """Also of a person lying on the back, who faces up."""
    joints = np.zeros((len(JOINTS), 3), np.float32)
    joints[LEFT, 1], joints[RIGHT, 1], joints[NECK, 2] = 0.2, -0.2, 0.5  # faces +x
    front = np.array([1.0, 0, 0])
    if lying:
        turn = Rotation.from_euler("y", -90, degrees=True)
        joints, front = turn.apply(joints).astype(np.float32), turn.apply(front)
    np.testing.assert_allclose(ahead(joints), front, atol=1e-5)
    for sign, left in ((1, 0.2), (-1, -0.2)):
        facing = 4 * sign * DIRECTIONS @ front
        said, odds = named(Prediction(facing, facing, joints, facing[: len(JOINTS)], facing[0], facing))  # pyright: ignore[reportArgumentType]
        assert odds > 2 and np.allclose(np.asarray(said.joints)[LEFT, 1], left)
    assert np.array_equal(OTHER[OTHER], np.arange(len(JOINTS)))


def test_directions_are_spread_evenly():
    """Each has its nearest neighbour 25 to 45 degrees away."""
    np.testing.assert_allclose(np.linalg.norm(DIRECTIONS, axis=1), 1, atol=1e-12)
    apart = np.degrees(np.arccos(np.clip(DIRECTIONS @ DIRECTIONS.T - 2 * np.eye(len(DIRECTIONS)), -1, 1)))
    assert apart.min() > 25 and apart.min(1).max() < 45


def test_compiled_voxels_are_those_of_the_package():
    rng = np.random.default_rng(0)
    points, labels = rng.normal([0, 0, 1.0], [0.3, 0.25, 0.5], (700, 3)), rng.integers(0, CLASSES, 700).astype(np.uint8)
    made, hist = tokens_and_labels(points, labels)
    wanted, at = tokens(points)
    np.testing.assert_allclose(made, wanted, atol=1e-5)
    for label in range(CLASSES):
        some = (labels == label) & (at >= 0)
        assert np.array_equal(hist[:, label], np.bincount(at[some], minlength=TOKENS))
