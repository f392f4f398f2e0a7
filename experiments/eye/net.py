"""A small transformer on the voxels about a column, in the frame of the view (the sensor towards +x): pure functions.

It tells the part of each voxel; where 14 joints are, left and right exchanged or not, and its own error; which way the
trunk faces, as a distribution; somebody or nobody.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from experiments.eye.data import JOINTS, PARTS
from experiments.eye.render import CLASSES, FEATURES, HIGH, TOKENS
from voodoo_jax.geometry.rigid import AnyArray

WIDTH, DEPTH, HEADS = 64, 3, 4
BINS = 16  # of facing, around the vertical
WAVES = np.array([1.0, 2.0, 4.0, 8.0]) * np.pi / (HIGH)
JOINT_COUNT = len(JOINTS)
INPUTS = 3 + 6 * len(WAVES) + FEATURES - 3 + 2
Params = dict[str, Any]


def exchanged(names: tuple[str, ...]) -> np.ndarray:
    """Of each name the place of that of the other side."""
    other = {"l": "r", "r": "l"}
    return np.array([names.index(other[n[0]] + n[1:] if n[1] == "_" else n) for n in names])


OTHER_JOINT = exchanged(JOINTS)
OTHER_PART = np.concatenate([exchanged(PARTS), np.arange(len(PARTS), CLASSES)])
LEFT = [JOINTS.index(n) for n in ("l_shoulder", "l_hip")]
RIGHT = [JOINTS.index(n) for n in ("r_shoulder", "r_hip")]
MIDDLES = (np.arange(BINS) + 0.5) * 2 * np.pi / BINS


def init(key: Array) -> Params:
    keys = iter(jax.random.split(key, 64))

    def mat(i: int, o: int, by: float = 1.0) -> Array:
        return jax.random.normal(next(keys), (i, o)) * by / np.sqrt(i)

    z, w = jnp.zeros, WIDTH
    p = dict(
        a=mat(INPUTS, w), ab=z(w), b=mat(w, w), extra=mat(1, w, 0.5), nf=jnp.ones(w),
        votes=mat(w, JOINT_COUNT * 3, 0.3), votesb=z(JOINT_COUNT * 3), pick=mat(w, JOINT_COUNT, 0.5),
        q1=mat(w, w), q1b=z(w), q2=mat(w, CLASSES, 0.3), q2b=z(CLASSES),
        s1=mat(w, w), s1b=z(w), s2=mat(w, JOINT_COUNT + 1 + BINS, 0.1), s2b=z(JOINT_COUNT + 1 + BINS),
    )  # fmt: skip
    for k in range(DEPTH):
        p |= {f"n{k}": jnp.ones(w), f"m{k}": jnp.ones(w), f"qkv{k}": mat(w, 3 * w), f"p{k}": mat(w, w, 0.4)}
        p |= {f"u{k}": mat(w, 2 * w), f"ub{k}": z(2 * w), f"d{k}": mat(2 * w, w, 0.4)}
    return p


def forward(p: Params, tok: Float[AnyArray, "b t f"], sensor: Float[AnyArray, "b 2"]) -> dict[str, Any]:
    """`sensor`: its level distance and its height, metres."""
    many = tok.shape[0]
    on = tok[..., -1] > 0
    at = tok[..., :3]
    waves = (at[..., None] * WAVES).reshape(many, TOKENS, -1)
    far = jnp.broadcast_to(sensor[:, None] / 4, (many, TOKENS, 2))
    x = jnp.concatenate([at - jnp.array([0, 0, 0.9]), jnp.sin(waves), jnp.cos(waves), tok[..., 3:], far], -1)
    x = jax.nn.relu(x @ p["a"] + p["ab"]) @ p["b"]
    x = jnp.concatenate([x, jnp.broadcast_to(p["extra"], (many, 1, WIDTH))], 1)
    bias = jnp.where(jnp.concatenate([on, jnp.ones((many, 1), bool)], 1), 0.0, -1e9)
    for k in range(DEPTH):
        q, key, v = jnp.split((_norm(x, p[f"n{k}"]) @ p[f"qkv{k}"]).reshape(many, TOKENS + 1, HEADS, -1), 3, -1)
        share = jnp.einsum("bqhd,bkhd->bhqk", q, key) / np.sqrt(WIDTH / HEADS) + bias[:, None, None]
        mixed = jnp.einsum("bhqk,bkhd->bqhd", jax.nn.softmax(share, -1), v).reshape(x.shape)
        x = x + mixed @ p[f"p{k}"]
        x = x + jax.nn.relu(_norm(x, p[f"m{k}"]) @ p[f"u{k}"] + p[f"ub{k}"]) @ p[f"d{k}"]
    x = _norm(x, p["nf"])
    each, whole = x[:, :-1], x[:, -1]
    part = jax.nn.relu(each @ p["q1"] + p["q1b"]) @ p["q2"] + p["q2b"]
    votes = at[:, :, None] + (each @ p["votes"] + p["votesb"]).reshape(many, TOKENS, JOINT_COUNT, 3)
    pick = jax.nn.softmax(jnp.swapaxes(each @ p["pick"], 1, 2) + bias[:, None, :-1], -1)
    told = jax.nn.relu(whole @ p["s1"] + p["s1b"]) @ p["s2"] + p["s2b"]
    return dict(
        part=part, votes=votes, joints=jnp.einsum("bjt,btjk->bjk", pick, votes), spread=told[:, :JOINT_COUNT] - 2.0,
        person=told[:, JOINT_COUNT], facing=told[:, JOINT_COUNT + 1 :],
    )  # fmt: skip


def _norm(x: Array, w: Array) -> Array:
    return x * jax.lax.rsqrt((x * x).mean(-1, keepdims=True) + 1e-6) * w


def ahead(joints: Float[AnyArray, "*b j 3"]) -> Any:
    """Where the trunk faces, level, by its sides; shorter where they are one above the other."""
    across = joints[..., LEFT, :2].mean(-2) - joints[..., RIGHT, :2].mean(-2)
    return jnp.stack([across[..., 1], -across[..., 0]], -1)


def front_odds(told: dict[str, Any]) -> Float[AnyArray, " b"]:
    """Logarithm of the odds that the joints are named as they should, and not left and right exchanged."""
    way = ahead(told["joints"])
    cosine = way @ jnp.stack([jnp.cos(MIDDLES), jnp.sin(MIDDLES)])
    share = jax.nn.softmax(told["facing"], -1)
    front = (share * (cosine > 0)).sum(-1)
    return jnp.log(front + 1e-4) - jnp.log(1 - front + 1e-4)


def told(p: Params, tok: AnyArray, sensor: AnyArray) -> dict[str, Any]:
    """forward() with left and right as facing tells them, and `odds` of that."""
    out = forward(p, tok, sensor)
    odds = front_odds(out)
    wrong = odds < 0
    return out | dict(
        joints=jnp.where(wrong[:, None, None], out["joints"][:, OTHER_JOINT], out["joints"]),
        spread=jnp.where(wrong[:, None], out["spread"][:, OTHER_JOINT], out["spread"]),
        part=jnp.where(wrong[:, None, None], out["part"][..., OTHER_PART], out["part"]), odds=jnp.abs(odds),
    )  # fmt: skip


def loss(p: Params, b: dict[str, Any]) -> tuple[Array, dict[str, Any]]:
    """Of a batch: tok, hist [b, token, class], joints, sensor, has (somebody), care (weight of that). Left and right
    may be exchanged in all of a person, the better way counts; facing is learned by itself."""
    out, has, joints = forward(p, b["tok"], b["sensor"]), b["has"], b["joints"]
    weight = jnp.ones(CLASSES).at[len(PARTS)].set(0.6)
    log_part = jax.nn.log_softmax(out["part"]) * weight
    number = b["hist"].sum((1, 2)) + 1e-6

    def off(one: Array, two: Array) -> Array:
        return jnp.sqrt(((one - two) ** 2).sum(-1) + 1e-5)

    part = [-(h * log_part).sum((1, 2)) / number for h in (b["hist"], b["hist"][..., OTHER_PART])]
    away = [off(out["joints"], j) for j in (joints, joints[:, OTHER_JOINT])]
    other = jax.lax.stop_gradient(part[0] + 4 * away[0].mean(1) > part[1] + 4 * away[1].mean(1)) & (has > 0)
    part, away = jnp.where(other, part[1], part[0]), jnp.where(other[:, None], away[1], away[0])
    goal = jnp.where(other[:, None, None], joints[:, OTHER_JOINT], joints)
    share = has[:, None] / jnp.maximum(has.sum() * JOINT_COUNT, 1)
    body = b["hist"][..., : len(PARTS)].sum(-1)
    guess = jnp.einsum("bt,btjk->bjk", body / (body.sum(1, keepdims=True) + 1e-6), out["votes"])
    spread = (jax.lax.stop_gradient(away) / jnp.exp(out["spread"]) + out["spread"]) * share
    way = ahead(joints)
    length = jnp.linalg.norm(way, axis=-1)
    near = jax.nn.softmax(8 * jnp.cos(jnp.arctan2(way[:, 1], way[:, 0])[:, None] - MIDDLES), -1)
    sure = has * jnp.minimum(1, length / 0.15)
    facing = -(near * jax.nn.log_softmax(out["facing"])).sum(-1)
    somebody = jax.nn.softplus(out["person"]) - has * out["person"]
    every = dict(
        part=part.mean(), joint=(away * share).sum(), guess=(off(guess, goal) * share).sum(), spread=spread.sum(),
        facing=(facing * sure).sum() / jnp.maximum(sure.sum(), 1),
        person=(somebody * b["care"]).sum() / jnp.maximum(b["care"].sum(), 1),
    )  # fmt: skip
    whole = every["part"] + 4 * every["joint"] + 1.5 * every["guess"] + 0.1 * every["spread"]
    return whole + 0.5 * every["facing"] + 0.4 * every["person"], every


def measured(p: Params, b: dict[str, Any]) -> dict[str, Any]:
    """[b] Error of the joints (metres), that of the better way, turned, somebody is right."""
    out = told(p, b["tok"], b["sensor"])
    away = [jnp.linalg.norm(out["joints"] - j, axis=-1) for j in (b["joints"], b["joints"][:, OTHER_JOINT])]
    turned = (ahead(out["joints"]) * ahead(b["joints"])).sum(-1) < 0
    return dict(
        joint=away[0].mean(1), better=jnp.minimum(away[0].mean(1), away[1].mean(1)), turned=turned, odds=out["odds"],
        person=out["person"], own=jnp.exp(out["spread"]).mean(1),
    )  # fmt: skip


def view(sensor: np.ndarray) -> np.ndarray:
    """The turn [3, 3] of the frame of the view: the sensor [3], relative to the column, is towards +x."""
    angle = np.arctan2(sensor[1], sensor[0])
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
