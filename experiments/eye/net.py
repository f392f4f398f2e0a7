"""The eye's net as it is trained: first weights, what is to be small, what is measured (kernels/eye.py is the net)."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from experiments.eye.data import CLASSES, JOINTS, PARTS
from voodoo_jax.kernels.eye import BINS, DIRECTIONS, OTHER, WAVES, Params, Prediction, ahead, forward, named
from voodoo_jax.trackers.shared.eye import FEATURES

WIDTH, DEPTH = 64, 3
JOINT_COUNT = len(JOINTS)
INPUTS = 3 + 6 * len(WAVES) + FEATURES - 3 + 2
OTHER_PART = np.array(
    [PARTS.index({"l": "r", "r": "l"}[n[0]] + n[1:] if n[1] == "_" else n) for n in PARTS]
    + list(range(len(PARTS), CLASSES))
)


def init(key: Array) -> Params:
    keys = iter(jax.random.split(key, 64))

    def mat(*shape: int, by: float = 1.0) -> Array:
        return jax.random.normal(next(keys), shape) * by / np.sqrt(shape[-2])

    z, w, d = jnp.zeros, WIDTH, DEPTH
    return dict(
        a=mat(INPUTS, w), ab=z(w), b=mat(w, w), extra=mat(1, w, by=0.5), nf=jnp.ones(w),
        votes=mat(w, JOINT_COUNT * 3, by=0.3), votesb=z(JOINT_COUNT * 3), pick=mat(w, JOINT_COUNT, by=0.5),
        q1=mat(w, w), q1b=z(w), q2=mat(w, CLASSES, by=0.3), q2b=z(CLASSES),
        s1=mat(w, w), s1b=z(w), s2=mat(w, JOINT_COUNT + 1 + BINS, by=0.1), s2b=z(JOINT_COUNT + 1 + BINS),
        n=jnp.ones((d, w)), m=jnp.ones((d, w)), qkv=mat(d, w, 3 * w), p=mat(d, w, w, by=0.4),
        u=mat(d, w, 2 * w), ub=z((d, 2 * w)), d=mat(d, 2 * w, w, by=0.4),
    )  # fmt: skip


def each(p: Params, b: dict[str, Any]) -> Prediction:
    """The net on a batch."""
    return jax.vmap(forward, (None, 0, 0))(p, b["tok"], b["sensor"])


def loss(p: Params, b: dict[str, Any]) -> tuple[Array, dict[str, Any]]:
    """Of a batch: tok, hist [b, token, class], joints, sensor, has (somebody), care (weight of that). Left and right
    may be exchanged in all of a person, the better way counts; facing is learned by itself."""
    out, has, joints = each(p, b), b["has"], b["joints"]
    weight = jnp.ones(CLASSES).at[len(PARTS)].set(0.6)
    log_part = jax.nn.log_softmax(out.part) * weight
    number = b["hist"].sum((1, 2)) + 1e-6

    def off(one: Array, two: Array) -> Array:
        return jnp.sqrt(((one - two) ** 2).sum(-1) + 1e-5)

    part = [-(h * log_part).sum((1, 2)) / number for h in (b["hist"], b["hist"][..., OTHER_PART])]
    away = [off(out.joints, j) for j in (joints, joints[:, OTHER])]
    other = jax.lax.stop_gradient(part[0] + 4 * away[0].mean(1) > part[1] + 4 * away[1].mean(1)) & (has > 0)
    part, away = jnp.where(other, part[1], part[0]), jnp.where(other[:, None], away[1], away[0])
    goal = jnp.where(other[:, None, None], joints[:, OTHER], joints)
    share = has[:, None] / jnp.maximum(has.sum() * JOINT_COUNT, 1)
    body = b["hist"][..., : len(PARTS)].sum(-1)
    guess = jnp.einsum("bt,btjk->bjk", body / (body.sum(1, keepdims=True) + 1e-6), out.votes)
    spread = (jax.lax.stop_gradient(away) / jnp.exp(out.spread) + out.spread) * share
    near = jax.nn.softmax(8 * ahead(joints) @ DIRECTIONS.T, -1)
    facing = -(near * jax.nn.log_softmax(out.facing)).sum(-1)
    somebody = jax.nn.softplus(out.person) - has * out.person
    every = dict(
        part=part.mean(), joint=(away * share).sum(), guess=(off(guess, goal) * share).sum(), spread=spread.sum(),
        facing=(facing * has).sum() / jnp.maximum(has.sum(), 1),
        person=(somebody * b["care"]).sum() / jnp.maximum(b["care"].sum(), 1),
    )  # fmt: skip
    whole = every["part"] + 4 * every["joint"] + 1.5 * every["guess"] + 0.1 * every["spread"]
    return whole + 0.5 * every["facing"] + 0.4 * every["person"], every


def measured(p: Params, b: dict[str, Any]) -> dict[str, Any]:
    """[b] Error of the joints (metres), that of the better way, turned, somebody is right."""
    out, odds = jax.vmap(named)(each(p, b))
    away = [jnp.linalg.norm(out.joints - j, axis=-1) for j in (b["joints"], b["joints"][:, OTHER])]
    turned = (ahead(out.joints) * ahead(b["joints"])).sum(-1) < 0
    return dict(
        joint=away[0].mean(1), better=jnp.minimum(away[0].mean(1), away[1].mean(1)), turned=turned, odds=odds,
        person=out.person, own=jnp.exp(out.spread).mean(1),
    )  # fmt: skip
