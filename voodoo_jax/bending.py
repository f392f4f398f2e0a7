"""How far joints are bent the wrong way, whatever round limbs seem to be turned about their own axes. Host side.

A knee that bends forwards tells that front and back are exchanged. The angles of kernels.plausible cannot be asked for
that: nobody sees how far a round thigh is turned about its axis, so a tracked one may have any twist.
"""

import numpy as np
from jaxtyping import Float, Float32
from scipy.spatial.transform import Rotation

from voodoo_jax.body import Body, tree_order

ROUND = 0.8  # a limb whose smaller axis is more than this share of the larger one is round
TWISTS = 13  # of a round limb that are tried, over the range that its joint allows


def wrong_bend(body: Body, rotation: Float32[np.ndarray, "frame limb 4"]) -> Float[np.ndarray, "frame joint"]:
    """Angle in radians between where a joint's child limb points and the nearest direction that its limits allow.

    Round limbs are taken to have whatever twist within their joints' limits suits their children best.

    **Arguments:** `rotation` of the limbs in the world, unit quaternions wxyz; NaN gives 0.
    """
    t, limits = body.topology, np.asarray(body.limits, float)
    there = np.all(np.isfinite(rotation), -1)
    turns = np.where(there[..., None], rotation, [1.0, 0, 0, 0])
    world = [Rotation.from_quat(turns[:, limb], scalar_first=True) for limb in range(body.limb_count)]
    anchors = [
        Rotation.from_quat(np.asarray(a.rotation), scalar_first=True) for a in (body.parent_anchor, body.child_anchor)
    ]
    sizes = np.asarray(body.sizes, float)[:, :4].reshape(-1, 2, 2)
    is_round = np.all(sizes.min(-1) > ROUND * sizes.max(-1), -1)
    free = {0: np.zeros(1)}  # limb -> twists that it may have
    out = np.zeros((len(turns), len(t.joints)))
    for j in tree_order(t):
        parent, child = t.parents[j], t.children[j]
        frame = world[parent] * anchors[0][j]
        towards = frame.inv().apply((world[child] * anchors[1][j]).apply([0.0, 0.0, 1.0]))
        swing = _swing(towards)
        if is_round[child]:
            # without any twist, and free to have one
            world[child] = frame * Rotation.from_rotvec(np.pad(swing, ((0, 0), (0, 1)))) * anchors[1][j].inv()
        low, high = np.clip(limits[j, 2], -np.pi, np.pi)
        free[child] = np.linspace(low, high, TWISTS) if is_round[child] else np.zeros(1)
        c, s = np.cos(free[parent]), np.sin(free[parent])
        seen = np.stack([c * swing[:, :1] + s * swing[:, 1:], c * swing[:, 1:] - s * swing[:, :1]], -1)
        off = np.linalg.norm(seen - np.clip(seen, limits[j, :2, 0], limits[j, :2, 1]), axis=-1)
        out[:, j] = np.where(there[:, parent] & there[:, child], off.min(1), 0.0)
    return out


def _swing(towards: Float[np.ndarray, "frame 3"]) -> Float[np.ndarray, "frame 2"]:
    """Rotation vector in the x-y plane that turns the z axis to a unit vector."""
    level = np.linalg.norm(towards[:, :2], axis=1)
    angle = np.arctan2(level, towards[:, 2])
    share = np.where(level > 1e-9, angle / np.maximum(level, 1e-9), 0.0)
    return np.stack([-towards[:, 1] * share, towards[:, 0] * share], 1)
