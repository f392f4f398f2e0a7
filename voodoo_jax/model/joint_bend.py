"""Angles by which joints are bent the wrong way, for any twist of round limbs about their own axes. Host side.

A knee that bends forwards shows that front and back are exchanged. The angles of kernels.plausible cannot be used for
that: the twist of a round thigh about its axis is not visible, so a tracked one may have any.
"""

import numpy as np
from jaxtyping import Float, Float32

from voodoo_jax.geometry.rigid import quat_conjugate, quat_multiply, rotate, unrotate
from voodoo_jax.model.body import Body, tree_levels

ROUND = 0.8  # a limb whose smaller axis is more than this share of the larger one is round
TWISTS = 13  # of a round limb that are tried, over the range that its joint allows


def wrong_bend(body: Body, rotation: Float32[np.ndarray, "frame limb 4"]) -> Float[np.ndarray, "frame joint"]:
    """Angle in radians between where a joint's child limb points and the nearest direction that its limits allow.

    Round limbs are taken to have whatever twist within their joints' limits suits their children best.

    **Arguments:** `rotation` of the limbs in the world, unit quaternions wxyz; NaN gives 0.
    """
    t, limits = body.topology, np.asarray(body.limits, float)
    there = np.all(np.isfinite(rotation), -1)
    world = np.where(there[..., None], rotation, [1.0, 0, 0, 0])
    to_parent, to_child = (np.asarray(a.rotation, float) for a in (body.parent_anchor, body.child_anchor))
    sizes = np.asarray(body.sizes, float)[:, :4].reshape(-1, 2, 2)
    is_round = np.all(sizes.min(-1) > ROUND * sizes.max(-1), -1)
    # twists that a limb may have, one if it is not round
    low, high = np.zeros((2, len(sizes)))
    children, parents = np.array(t.children, int), np.array(t.parents, int)
    low[children], high[children] = np.where(is_round[children], np.clip(limits[:, 2].T, -np.pi, np.pi), 0.0)
    out = np.zeros((len(world), len(t.joints)))
    for joints in tree_levels(t):
        parent, child = parents[joints], children[joints]
        frame = quat_multiply(world[:, parent], to_parent[joints])
        axis = rotate(quat_multiply(world[:, child], to_child[joints]), np.array([0.0, 0.0, 1.0]))
        swing = _swing(unrotate(frame, axis))
        # a round limb without any twist, and free to have one
        plain = quat_multiply(quat_multiply(frame, _turned(swing)), quat_conjugate(to_child[joints]))
        world[:, child] = np.where(is_round[child, None], plain, world[:, child])
        twist = low[parent] + (high - low)[parent] * np.linspace(0, 1, TWISTS)[:, None, None]
        c, s = np.cos(twist), np.sin(twist)
        x, y = swing[..., 0], swing[..., 1]
        seen = np.stack([c * x + s * y, c * y - s * x], -1)
        off = np.linalg.norm(seen - np.clip(seen, limits[joints, :2, 0], limits[joints, :2, 1]), axis=-1)
        out[:, joints] = np.where(there[:, parent] & there[:, child], off.min(0), 0.0)
    return out


def _turned(swing: Float[np.ndarray, "frame joint 2"]) -> Float[np.ndarray, "frame joint 4"]:
    """Unit quaternions wxyz of rotation vectors in the x-y plane."""
    half = np.linalg.norm(swing, axis=-1, keepdims=True) / 2
    return np.concatenate([np.cos(half), np.sinc(half / np.pi) / 2 * swing, np.zeros_like(half)], -1)


def _swing(towards: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame joint 2"]:
    """Rotation vectors in the x-y plane that turn the z axis to unit vectors."""
    x, y, z = towards[..., 0], towards[..., 1], towards[..., 2]
    level = np.hypot(x, y)
    share = np.where(level > 1e-9, np.arctan2(level, z) / np.maximum(level, 1e-9), 0.0)
    return np.stack([-y * share, x * share], -1)
