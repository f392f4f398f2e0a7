"""Which limb each point belongs to: gates, and the distances to all limbs (Knoop 2007, sec. 5.2)."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.kernels.bounding_boxes import body_box, in_box, in_limb_box
from voodoo_jax.kernels.frustum import rim_factors, signed_square
from voodoo_jax.kernels.points import FREE, MatchOptions, Points, Sampling, components

T = TypeVar("T")


def once(true: Bool[Array, ""], compute: Callable[[], T], nothing: T | None = None) -> T:
    """What `compute` gives, computed once; `true` is a condition that the compiler cannot know to be so.

    The compiler for the CPU repeats a whole match for each sum that uses it (half of a step's time, and not linear in
    the points), but it does not look through a branch, nor through the barrier before it, where the condition is a
    constant of the program. A condition that differs over a mapped axis is no branch: use one that all have in common.
    `nothing`: zeros of the same shapes; where they are given it is traced once, too.
    """
    if nothing is None:
        nothing = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(compute))
    return jax.lax.cond(jax.lax.optimization_barrier(true), compute, lambda: nothing)


@jax.custom_jvp
def _cut(true, *numbers):
    return numbers


@_cut.defjvp
def _cut_jvp(primals, tangents):
    true, tangents = primals[0], tangents[1:]
    nothing = lambda *t: tuple(jnp.zeros_like(x) for x in t)  # noqa: E731
    return _cut(*primals), jax.lax.cond(jax.lax.optimization_barrier(true), lambda *t: t, nothing, *tangents)


def cuts(true: Bool[Array, ""]) -> Callable[..., Any]:
    """The identity of some arrays, whose derivative is computed once, as with `once`: put where much hangs on few
    numbers, or on the way back the compiler repeats all that lies behind them for everything that they depend on."""
    return functools.partial(_cut, true)


def into_limb(rotation, translation, x, y, z):
    """World points in the frame of a limb, by component; the pose by component too, of one limb or point by point."""
    r = turn_rows(rotation)
    dx, dy, dz = x - translation[0], y - translation[1], z - translation[2]
    px, py, pz = (r[i] * dx + r[i + 3] * dy + r[i + 6] * dz for i in range(3))
    return px, py, pz


def turn_rows(q):
    """Rotation matrix, row by row, of a unit quaternion by component."""
    w, i, j, k = (q[n] for n in range(4))
    return (
        1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j),
        2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i),
        2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j),
    )  # fmt: skip


def in_reach(sizes, poses, points: Points, options: MatchOptions, present) -> Bool[Array, " point"]:
    """Points in the body's box, or known to be on the body."""
    low, high = body_box(sizes, poses, options.body_enlarge, present)
    near_body = in_box(low, high, points.xyz)
    if points.limb is not None:
        near_body |= points.limb != FREE
    return near_body & (points.weight > 0)


# 7 parameters: points by component, for products over an axis of 3 are slow
def may_belong(limb, size, px, py, pz, points: Points, options: MatchOptions):
    """Which points may belong to a limb: those in its box, and those that a segmentation has assigned to it."""
    inside = in_limb_box(size, px, py, pz, options.limb_enlarge)
    if points.limb is None:
        return inside
    return jnp.where(points.limb >= 0, points.limb == limb, inside)


def sampled(chosen: Bool[Array, "limb point"], sampling: Sampling) -> Bool[Array, "limb point"]:
    """Evenly spread ones of each limb's points: exactly the wanted number of them."""
    count = jnp.sum(chosen, 1, keepdims=True)
    share = jnp.round(sampling.factor * count).astype(count.dtype)
    wanted = jnp.minimum(jnp.clip(share, sampling.least, sampling.most), count)
    order = jnp.cumsum(chosen, 1)
    total = jnp.maximum(count, 1)
    return chosen & (order * wanted // total > (order - 1) * wanted // total)


def _limb_rows(sizes: Float[Array, "limb 5"], poses: Poses) -> Float[Array, "limb 21"]:
    """What distances need of each limb: rotation matrix, place, sizes, factors of the rims."""
    turn = jnp.stack(turn_rows(poses.rotation.T), -1)
    return jnp.concatenate([turn, poses.translation, sizes, jnp.stack(rim_factors(sizes.T), -1)], -1)


@jax.jit  # traced once, not limb by limb
def _signed_if_near(limb, here, row, xyz, points, options):
    """Signed squared distances of all points to one limb, where they are in its box."""
    dx, dy, dz = (k - row[9 + i] for i, k in enumerate(xyz))
    px, py, pz = (row[i] * dx + row[i + 3] * dy + row[i + 6] * dz for i in range(3))
    size = row[12:17]
    signed = signed_square(size, px, py, pz, options.refine, options.caps, row[17:21])
    return jnp.where(here & may_belong(limb, size, px, py, pz, points, options), signed, jnp.inf)


# 7 parameters: points by component, for products over an axis of 3 are slow
def closest_limb(sizes, poses, points, xyz, near_body, present, options) -> Int[Array, " point"]:
    """The closest limb of those in whose box a point is; the number of limbs where there is none."""
    limbs, true = sizes.shape[0], options.robust_scale > 0
    rows = once(true, lambda: _limb_rows(sizes, poses), jnp.zeros((limbs, 21), sizes.dtype))
    # one limb after the other, the first of equals: one pass over the points, nothing of [limb, point] is written
    nearest, winner = jnp.full_like(xyz[0], jnp.inf), jnp.full_like(near_body, limbs, jnp.int32)
    for limb in range(limbs):
        signed = _signed_if_near(limb, present[limb], rows[limb], xyz, points, options)
        closer = signed < nearest
        nearest, winner = jnp.where(closer, signed, nearest), jnp.where(closer, limb, winner)
    winner = jnp.where(near_body, winner, limbs)
    if options.sampling is None:
        return winner
    return jnp.where(sampled(jnp.arange(limbs)[:, None] == winner, options.sampling).any(0), winner, limbs)


def closest_limbs(
    sizes: Float[Array, "limb 5"], poses: Poses, points: Points, options: MatchOptions, present: Bool[Array, " limb"]
) -> Int[Array, " point"]:
    """Which limb each point is matched to under the exclusive rule; the number of limbs where to none."""
    near_body = in_reach(sizes, poses, points, options, present)
    return closest_limb(sizes, poses, points, components(points.xyz), near_body, present, options)
