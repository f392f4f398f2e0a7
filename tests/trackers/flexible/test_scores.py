"""Hands look for skin but not for the face's; lost legs are looked for where people stand."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import voodoo_jax as vj
from voodoo_jax.config.options import FlexibleSettings
from voodoo_jax.trackers.flexible.filters import Inputs, restarted
from voodoo_jax.trackers.flexible.flexible_body import LIMBS, flexible_body
from voodoo_jax.trackers.flexible.scores import LimbContext, View, limb_score
from voodoo_jax.trackers.flexible.tracker import numbers, shape_of
from voodoo_jax.trackers.flexible.vectors import vectors

SETTINGS = FlexibleSettings(particles=200, restart=0.1)
NUMBERS, BODY = numbers(SETTINGS), flexible_body(vj.human(), 1.75)
SIZE, FOCAL = (96, 128), (90.0, 90.0, 63.5, 47.5)
FAR = 10.0


def view(depth: float, hand: slice = slice(0, 0)) -> View:
    """What a camera at the origin sees that looks along z: a wall with skin in some rows of its middle."""
    skin = np.zeros(SIZE, np.uint8)
    skin[hand, 55:73] = 255
    small = SIZE[0] // 4, SIZE[1] // 4
    return View(
        np.zeros(SIZE, np.uint32), np.zeros(small, np.uint8),
        np.zeros((*small, 2), np.float32), np.full(SIZE, depth, np.float32), np.array(FOCAL, np.float32),
        np.eye(3, dtype=np.float32), np.zeros(3, np.float32), skin,
    )  # fmt: skip


def context(head: Any, points: np.ndarray, others: float = FAR) -> LimbContext:
    """Of an arm."""
    return LimbContext(
        jnp.full((SIZE[0] // 4, SIZE[1] // 4), 1e6), jnp.full((2, 10, 3), 0.5), jnp.zeros((2, 10)),
        jnp.asarray(points, jnp.float32), jnp.full(len(points), others), jnp.ones(len(points)),
        jnp.zeros(2), jnp.array([0.0, 0.0, -1.0]), jnp.asarray(1.0), BODY.radii[0], BODY.tips[0],
        jnp.asarray([*head, 0.15], jnp.float32),
    )  # fmt: skip


def test_a_hand_scores_by_its_skin_unless_it_is_hidden_or_before_the_face():
    arm = jnp.array([[0.0, -0.30, 2.0], [0.0, 0.0, 2.0], [0.0, 0.25, 2.0]])
    hand = slice(58, 70)  # 0.25 to 0.42 m down at 2 m
    far, at_hand = (0.0, -0.6, 2.0), (0.0, 0.33, 2.0)
    points = vectors(arm[0, None]), vectors(arm[1, None]), vectors(arm[2, None])
    score = jax.jit(lambda p, c, v: limb_score(p, c, v, NUMBERS.weighing).skin[0])
    skin = {
        "seen": score(points, context(far, np.zeros((4, 3))), view(1.97, hand)),
        "clothes": score(points, context(far, np.zeros((4, 3))), view(1.97)),
        "room": score(points, context(far, np.zeros((4, 3))), view(3.0, hand)),
        "hidden": score(points, context(far, np.zeros((4, 3))), view(1.5, hand)),
        "face": score(points, context(at_hand, np.zeros((4, 3))), view(1.97, hand)),
    }
    assert skin["seen"] > 0.9 and skin["clothes"] == 0 and skin["room"] == 0
    assert 0 < skin["hidden"] < 0.5 and skin["face"] == skin["hidden"]


def test_of_a_leg_whose_points_the_other_may_explain_some_particles_stand_on_the_floor():
    x = jnp.asarray(BODY.rest)
    points = np.asarray(x[12] + np.random.default_rng(0).normal(0, 0.02, (50, 3)), np.float32)
    one = context((0.0, 0.0, 1.6), points, others=0.0)
    each = jax.tree.map(lambda a: jnp.broadcast_to(a, (4, *a.shape)), one)
    nothing, no = np.zeros(50, np.float32), np.float32(0)
    given = Inputs(
        view(3.0), points, 1 - nothing, nothing, np.zeros(3, np.float32), no, np.array([0, 0, 1], np.float32), no,
        np.int32(0), no, np.bool_(True),
    )  # fmt: skip
    given = jax.tree.map(jnp.asarray, given)
    floor, shape = jnp.array([0.0, 0.0, 1.0, 0.0]), shape_of(SETTINGS)
    standing = jax.jit(lambda key, f: restarted(key, BODY, x, each, given, f, shape))
    p, use = standing(jax.random.key(0), floor)
    assert use[2:].mean() == 0.5 and not use[:2].any()
    ankles = np.asarray(p[2:, :, 2])[np.asarray(use[2:])]
    hips = np.asarray(x[LIMBS[2:, 0]])
    assert np.median(ankles[:, 2]) < 0.15 and np.abs(ankles[:, 1] - hips[:, 1].mean()).max() < 0.5
    lengths = np.linalg.norm(np.diff(np.asarray(p), axis=2), axis=-1)[2:]
    np.testing.assert_allclose(lengths.mean((0, 1)), BODY.lengths[4:6], rtol=0.02)
    assert not standing(jax.random.key(0), jnp.array([0.0, 0.0, 1.0, -1e3]))[1].any()  # no floor
