"""Sizes of a body as measured by tape, and their standard deviations after a fit."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float64

from voodoo_jax.fitting.parameters import Parameters, changed
from voodoo_jax.geometry.rigid import apply
from voodoo_jax.model.body import Body, joint_centres, without_side


class Size(NamedTuple):
    """One size before and after a fit; `sd` NaN if unknown. Metres."""

    name: str
    before: float
    after: float
    sd: float


def sizes_of(body: Body) -> dict[str, Float[Array, ""]]:
    """The scale, the reported segments, distances between joints of both sides on one limb, and girths half way along
    the limbs, metres; left and right averaged. Differentiable."""
    t = body.topology
    parents = jnp.array(t.parents, int)
    joints = dict(zip(t.joints, apply(body.rest[parents], body.parent_anchor.translation)))
    ends = dict(zip(t.centres, joint_centres(body, body.rest))) | joints  # joints where both have the name
    found: dict[str, list[Float[Array, ""]]] = {body.scale_name: [body.scale]}
    for name, start, end in t.segments:
        found.setdefault(name, []).append(jnp.linalg.norm(ends[start] - ends[end]))
    for j, name in enumerate(t.joints):
        other = "r_" + name[2:]
        if name.startswith("l_") and other in joints and t.parents[j] == t.parents[t.joints.index(other)]:
            found[f"between {name[2:]}s"] = [jnp.linalg.norm(joints[name] - joints[other])]
    for i, name in enumerate(t.limbs):
        if i not in t.held:
            a, b = (body.sizes[i, :2] + body.sizes[i, 2:4]) / 2
            # Ramanujan's first approximation of an ellipse's circumference, good to 0.1 % for these
            girth = jnp.pi * (3 * (a + b) - jnp.sqrt((3 * a + b) * (a + 3 * b)))
            found.setdefault(f"girth of {without_side(name)}", []).append(girth)
    return {name: sum(values[1:], values[0]) / len(values) for name, values in found.items()}


def sizes_after(
    body: Body, free: Parameters, x: Float64[np.ndarray, " free"], covariance: Float64[np.ndarray, "free free"]
) -> tuple[Size, ...]:
    """Sizes before and after the changes `x`, with standard deviations from the parameters' covariance."""
    of = lambda x: jnp.stack(list(sizes_of(changed(body, free.changes(x))).values()))  # noqa: E731
    at = jnp.asarray(x, jnp.float32)
    slope = np.asarray(jax.jit(jax.jacfwd(of))(at), np.float64)
    sd = np.sqrt(np.einsum("sf,fg,sg->s", slope, covariance, slope))
    before, after = np.asarray(of(jnp.zeros_like(at)), float), np.asarray(of(at), float)
    return tuple(Size(name, *map(float, row)) for name, *row in zip(sizes_of(body), before, after, sd))
