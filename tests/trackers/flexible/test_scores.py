"""Hands look for skin but not for the face's; lost legs are looked for where people stand."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import voodoo_jax as vj
from voodoo_jax.config.options import FlexibleSettings
from voodoo_jax.trackers.flexible.flexible_body import flexible_body
from voodoo_jax.trackers.flexible.scores import LimbContext, View, limb_score
from voodoo_jax.trackers.flexible.tracker import numbers
from voodoo_jax.trackers.flexible.vectors import vectors

SETTINGS = FlexibleSettings(particles=200)
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
        np.full(SIZE, depth, np.float32), np.array(FOCAL, np.float32),
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
