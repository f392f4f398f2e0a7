"""A learned eye: from the points about one person, where the joints are and which way the trunk faces.

A small transformer (Vaswani 2017) on voxels, in the frame of the view: origin on the floor, z up, the sensor
towards +x. It is trained by experiments/eye.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

JOINTS = (
    "skullbase", "vc7", "l_shoulder", "l_elbow", "l_radiocarpal", "r_shoulder", "r_elbow", "r_radiocarpal", "l_hip",
    "l_knee", "l_talocrural", "r_hip", "r_knee", "r_talocrural",
)  # fmt: skip
NECK = JOINTS.index("vc7")
LEFT, RIGHT = ([JOINTS.index(f"{side}_{name}") for name in ("shoulder", "hip")] for side in "lr")
OTHER = np.array([JOINTS.index({"l": "r", "r": "l"}[n[0]] + n[1:] if n[1] == "_" else n) for n in JOINTS])
# the weights hold for these alone, see experiments/eye: heads, directions of facing, highest voxel in metres
HEADS, BINS, HIGH = 4, 34, 2.4
PARTS = 13  # of the body, the first classes of a voxel; then background, somebody else
WAVES = np.array([1.0, 2.0, 4.0, 8.0]) * np.pi / HIGH  # of positions, radians per metre, as in experiments/eye
LAYERS = ("n", "qkv", "p", "m", "u", "ub", "d")  # weights with an axis of layers
# derived: directions spread evenly over the sphere (Fibonacci lattice, Gonzalez 2010,
# doi 10.1007/s11004-009-9257-x)
_Z, _YAW = 1 - (2 * np.arange(BINS) + 1) / BINS, np.arange(BINS) * np.pi * (3 - np.sqrt(5))
DIRECTIONS = np.stack([np.sqrt(1 - _Z**2) * np.cos(_YAW), np.sqrt(1 - _Z**2) * np.sin(_YAW), _Z], -1)
Params = Mapping[str, Any]


class Prediction(NamedTuple):
    """What the net says; left and right may be exchanged, see `named`."""

    part: Float[Array, "token class"]  # logits: parts of the body, background, somebody else
    votes: Float[Array, "token joint 3"]  # where each voxel supposes the joints
    joints: Float[Array, "joint 3"]  # metres
    spread: Float[Array, " joint"]  # logarithm of their error, metres
    person: Float[Array, ""]  # logarithm of the odds that this is a person
    facing: Float[Array, " bin"]  # logits of DIRECTIONS


def forward(p: Params, tok: Float[Array, "token feature"], sensor: Float[Array, "2"]) -> Prediction:
    """**Arguments:** `tok` a voxel's mean, covariance, octants and number of points, 0: padding; `sensor` its level
    distance and its height, metres."""
    on, at, count = tok[:, -1] > 0, tok[:, :3], len(tok)
    waves = (at[..., None] * WAVES).reshape(count, -1)
    far = jnp.broadcast_to(sensor / 4, (count, 2))
    x = jnp.concatenate([at - jnp.array([0, 0, 0.9]), jnp.sin(waves), jnp.cos(waves), tok[:, 3:], far], -1)
    x = jnp.concatenate([jax.nn.relu(x @ p["a"] + p["ab"]) @ p["b"], p["extra"]])
    bias = jnp.where(jnp.append(on, True), 0.0, -1e9)

    def layer(x: Array, w: Params) -> tuple[Array, None]:
        q, key, v = jnp.split((_norm(x, w["n"]) @ w["qkv"]).reshape(count + 1, HEADS, -1), 3, -1)
        share = jnp.einsum("qhd,khd->hqk", q, key) / np.sqrt(q.shape[-1]) + bias
        x = x + jnp.einsum("hqk,khd->qhd", jax.nn.softmax(share, -1), v).reshape(x.shape) @ w["p"]
        return x + jax.nn.relu(_norm(x, w["m"]) @ w["u"] + w["ub"]) @ w["d"], None

    x, _ = jax.lax.scan(layer, x, {name: p[name] for name in LAYERS})
    x = _norm(x, p["nf"])
    each, whole = x[:-1], x[-1]
    votes = at[:, None] + (each @ p["votes"] + p["votesb"]).reshape(count, len(JOINTS), 3)
    pick = jax.nn.softmax((each @ p["pick"]).T + bias[:-1], -1)
    said = jax.nn.relu(whole @ p["s1"] + p["s1b"]) @ p["s2"] + p["s2b"]
    spread, person, facing = jnp.split(said, [len(JOINTS), len(JOINTS) + 1])
    part = jax.nn.relu(each @ p["q1"] + p["q1b"]) @ p["q2"] + p["q2b"]
    return Prediction(part, votes, jnp.einsum("jt,tjk->jk", pick, votes), spread - 2.0, person[0], facing)


def _norm(x: Array, w: Array) -> Array:
    return x * jax.lax.rsqrt((x * x).mean(-1, keepdims=True) + 1e-6) * w


def ahead(joints: Float[Any, "*b joint 3"]) -> Any:
    """Unit vector in which the trunk faces: the normal of its axis and of the line between its sides."""
    across = joints[..., LEFT, :].mean(-2) - joints[..., RIGHT, :].mean(-2)
    way = jnp.cross(across, joints[..., NECK, :] - joints[..., [LEFT[1], RIGHT[1]], :].mean(-2))
    return way * jax.lax.rsqrt((way * way).sum(-1, keepdims=True) + 1e-9)


def named(found: Prediction) -> tuple[Prediction, Float[Array, ""]]:
    """What it says with left and right as it faces, and the logarithm of the odds that they are so."""
    front = jnp.sum(jax.nn.softmax(found.facing) * (DIRECTIONS @ ahead(found.joints) > 0))
    odds = jnp.log(front + 1e-4) - jnp.log(1 - front + 1e-4)
    order = jnp.where(odds < 0, OTHER, np.arange(len(JOINTS)))
    return found._replace(joints=found.joints[order], spread=found.spread[order]), jnp.abs(odds)
