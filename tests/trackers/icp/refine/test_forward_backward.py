"""Two passes made one: the better of each frame, halfway between them where they agree."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from voodoo_jax.trackers.icp.refine.forward_backward import ForwardBackward, combined
from voodoo_jax.trackers.icp.segment import Pass

LENGTHS = np.array([0.3, 0.4])
PASSES = ForwardBackward()


def made_one(forward: Pass, backward: Pass):
    """Rotation, translation, where the backward pass is taken, and how far both are apart."""
    taken = PASSES.is_better(backward.cost, forward.cost)
    rotation, translation, apart = combined(forward, backward, taken, LENGTHS)
    return rotation, translation, taken, apart


def a_pass(turns, places, cost) -> Pass:
    q = Rotation.from_rotvec(np.asarray(turns, float).reshape(-1, 3)).as_quat(scalar_first=True)
    shape = np.shape(turns)[:2]
    return Pass(q.reshape(*shape, 4).astype(np.float32), np.asarray(places, np.float32), np.asarray(cost, float))


def random_pass(seed, frames=12, cost=1.0) -> Pass:
    rng = np.random.default_rng(seed)
    return a_pass(rng.normal(size=(frames, 2, 3)), rng.normal(size=(frames, 2, 3)), np.full(frames, cost))


def ends(rotation, translation):
    axis = Rotation.from_quat(rotation.reshape(-1, 4).astype(float), scalar_first=True).apply([0, 0, 1.0])
    return translation, translation + axis.reshape(translation.shape) * LENGTHS[:, None]


def test_where_they_agree_the_mean_where_not_the_better():
    a = random_pass(0)
    near = Pass(a.rotation, a.translation + np.float32(0.02), a.cost)
    rotation, translation, taken, _ = made_one(a, near)
    np.testing.assert_allclose(translation, a.translation + 0.01, atol=1e-6)
    np.testing.assert_allclose(np.abs((rotation * a.rotation).sum(-1)), 1, atol=1e-6)
    assert not taken.any()
    far = Pass(a.rotation, a.translation + np.float32(2 * PASSES.agree), a.cost * 0.5)
    rotation, translation, taken, _ = made_one(a, far)
    np.testing.assert_array_equal(translation, far.translation)
    assert taken.all()


@pytest.mark.parametrize("seed", range(3))
def test_the_axis_is_turned_halfway_whatever_the_roll(seed):
    """Oracle: scipy's interpolation between the two directions of the axis."""
    rng = np.random.default_rng(seed)
    a = random_pass(seed)
    turn = Rotation.from_rotvec(rng.normal(0, 0.08, (24, 3)))
    roll = Rotation.from_rotvec(np.array([0, 0, 1.0]) * rng.uniform(-3, 3, (24, 1)))
    q = turn * Rotation.from_quat(a.rotation.reshape(-1, 4), scalar_first=True) * roll
    b = Pass(q.as_quat(scalar_first=True).reshape(12, 2, 4).astype(np.float32), a.translation, a.cost)
    rotation, *_ = made_one(a, b)
    z = [Rotation.from_quat(r.reshape(-1, 4).astype(float), scalar_first=True).apply([0, 0, 1.0])
         for r in (a.rotation, b.rotation, rotation)]  # fmt: skip
    middle = (z[0] + z[1]) / np.linalg.norm(z[0] + z[1], axis=1, keepdims=True)
    agree = np.linalg.norm((z[0] - z[1]).reshape(12, 2, 3) * LENGTHS[:, None], axis=-1).reshape(-1) < PASSES.agree
    assert agree.sum() > 12
    np.testing.assert_allclose(z[2][agree], middle[agree], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(rotation, axis=-1), 1, atol=1e-6)


def test_averaging_halves_independent_noise():
    rng = np.random.default_rng(5)
    true = random_pass(1, 60)
    noisy = [Pass(true.rotation, true.translation + rng.normal(0, 0.01, true.translation.shape).astype(np.float32),
                  true.cost) for _ in range(2)]  # fmt: skip
    _, translation, *_ = made_one(*noisy)
    assert np.std(translation - true.translation) == pytest.approx(0.01 / np.sqrt(2), rel=0.1)


def test_single_frames_do_not_decide():
    forward, backward = np.full(40, 1.0), np.full(40, 1.0)
    backward[20] = 0.9
    assert not PASSES.is_better(backward, forward).any()
    backward[10:25] = 0.5
    taken = PASSES.is_better(backward, forward)
    assert taken[12:23].all() and not taken[: 10 - PASSES.window].any() and not taken[25 + PASSES.window :].any()


@pytest.mark.parametrize("frames", [0, 1, 2, 3, 6, 8])
def test_short_recordings(frames):
    a, b = random_pass(0, frames), random_pass(1, frames, cost=0.5)
    rotation, translation, taken, _ = made_one(a, b)
    assert rotation.shape == (frames, 2, 4) and taken.shape == (frames,) and taken.all()
    np.testing.assert_array_equal(translation, b.translation)


def test_a_limb_that_is_nowhere_stays_nowhere():
    a, b = random_pass(0), random_pass(0)
    a.translation[:, 1], a.rotation[:, 1] = np.nan, np.nan
    rotation, translation, *_ = made_one(a, b)
    assert np.isnan(translation[:, 1]).all() and np.isfinite(translation[:, 0]).all()
    assert np.isnan(rotation[:, 1]).all()
