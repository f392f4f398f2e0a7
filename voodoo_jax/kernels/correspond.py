"""From points to weighted correspondences of all limbs, and to their moments (Knoop 2007, sec. 5.2)."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.kernels.gate import Overlap, body_box, in_box, in_limb_box, resolve_overlap
from voodoo_jax.kernels.surface import closest_point, near_side
from voodoo_jax.pose import Poses, unrotate


class Points(eqx.Module):
    """One frame's free points (or a batch of frames), padded. A padded entry has weight zero and any finite place."""

    xyz: Float[Array, "*frame point 3"]  # world frame, metres
    weight: Float[Array, "*frame point"]  # 0 for padding; 1 for a depth camera's point (2007, sec. 6)
    sensor: Int[Array, "*frame point"]  # which sensor saw it
    origins: Float[Array, "*frame sensor 3"]  # where the sensors stand, world frame, metres
    limb: Int[Array, "*frame point"] | None = None  # limb the point is known to be on, ON_BODY, FREE; None: all free


FREE, ON_BODY = -1, -2  # kinds of points (2007, sec. 5.1): may be anything; on the body, on which limb is not known


class Sampling(eqx.Module):
    """How many of a limb's points are used (2007, sec. 5.2, point number reduction)."""

    factor: Float[Array, ""]  # share of the limb's points
    least: Int[Array, ""]  # a limb with fewer points keeps all
    most: Int[Array, ""]


class MatchOptions(eqx.Module):
    """Parameters of the matching; numbers are traced so that changing one compiles nothing anew."""

    body_enlarge: Float[Array, ""]  # metres
    limb_enlarge: Float[Array, ""]  # metres
    max_distance: Float[Array, ""]  # metres
    robust_scale: Float[Array, ""]  # metres; infinite: every pair counts fully, as in the papers
    sampling: Sampling | None  # None: all points are used
    overlap: Overlap = eqx.field(static=True)
    near_side: bool = eqx.field(static=True)
    refine: int = eqx.field(static=True)


class Match(NamedTuple):
    """Correspondences in the frames of their limbs.

    Under the exclusive rule a point has one pair at most, and the pair's arrays have no limb axis.
    """

    weight: Float[Array, "limb point"]  # 0: no pair
    distance: Float[Array, "*limb point"]  # between the pair's points, metres
    model: tuple[Float[Array, "*limb point"], Float[Array, "*limb point"], Float[Array, "*limb point"]]
    data: tuple[Float[Array, "*limb point"], Float[Array, "*limb point"], Float[Array, "*limb point"]]

    def close(self, distance: float) -> Bool[Array, " point"]:
        """Which points have a pair shorter than `distance`, metres."""
        return jnp.any((self.weight > 0) & (self.distance < distance), 0)

    def squares(self) -> Float[Array, ""]:
        """Weighted sum of squared distances, square metres."""
        return jnp.sum(self.weight * self.distance**2)


def _into_limb(rotation, translation, x, y, z):
    """World points in the frame of a limb, by component; the pose by component too, of one limb or point by point."""
    w, i, j, k = (rotation[n] for n in range(4))
    dx, dy, dz = x - translation[0], y - translation[1], z - translation[2]
    px = (1 - 2 * (j * j + k * k)) * dx + 2 * (i * j + w * k) * dy + 2 * (i * k - w * j) * dz
    py = 2 * (i * j - w * k) * dx + (1 - 2 * (i * i + k * k)) * dy + 2 * (j * k + w * i) * dz
    pz = 2 * (i * k + w * j) * dx + 2 * (j * k - w * i) * dy + (1 - 2 * (i * i + j * j)) * dz
    return px, py, pz


def _sensor_directions(poses: Poses, points: Points) -> tuple[Float[Array, "limb sensor"], Float[Array, "limb sensor"]]:
    """x and y of every sensor in every limb's frame, metres."""
    local = unrotate(poses.rotation[:, None], points.origins[None] - poses.translation[:, None])
    return local[..., 0], local[..., 1]


def _near_body(sizes, poses, points: Points, options: MatchOptions, present) -> Bool[Array, " point"]:
    """Points in the body's box, or known to be on the body."""
    low, high = body_box(sizes, poses, options.body_enlarge, present)
    near_body = in_box(low, high, points.xyz)
    if points.limb is not None:
        near_body |= points.limb != FREE
    return near_body & (points.weight > 0)


def match(
    sizes: Float[Array, "limb 5"],
    poses: Poses,
    points: Points,
    adjacent: Bool[Array, "limb limb"],
    options: MatchOptions,
    present: Bool[Array, " limb"] | None = None,
) -> Match:
    """Gates, overlap rule, closest points, maximum distance and robust weights for one frame.

    Points known to be on the body pass the body's box, points of a known limb the limbs' boxes and the overlap rule too
    (2007, Fig. 4).
    """
    present = jnp.ones(sizes.shape[0], bool) if present is None else present
    near_body = _near_body(sizes, poses, points, options, present)
    if options.overlap == "exclusive":
        return _match_closest(sizes, poses, points, near_body, present, options)
    x, y, z = points.xyz[:, 0], points.xyz[:, 1], points.xyz[:, 2]
    to_x, to_y = _sensor_directions(poses, points)

    def one_limb(limb, here, size, pose, towards_x, towards_y):
        px, py, pz = _into_limb(pose.rotation, pose.translation, x, y, z)
        surface = closest_point(size, px, py, pz, options.refine)
        signed = surface.distance
        if options.near_side:
            surface = near_side(size, px, py, surface, towards_x[points.sensor], towards_y[points.sensor])
        box = here & _in_limb_box(limb, size, px, py, pz, points, options)
        return (surface.x, surface.y, surface.z), (px, py, pz), signed, box

    limbs = jnp.arange(sizes.shape[0])
    model, data, signed, box = jax.vmap(one_limb)(limbs, present, sizes, poses, to_x, to_y)
    chosen = resolve_overlap(options.overlap, box & near_body[None, :], signed, adjacent)
    if options.sampling is not None:
        chosen = _sampled(chosen, options.sampling)
    return _weigh(chosen, model, data, points.weight[None, :], options)


def _in_limb_box(limb, size, px, py, pz, points: Points, options: MatchOptions):
    """Which points may belong to a limb: by its box, or because somebody knows."""
    inside = in_limb_box(size, px, py, pz, options.limb_enlarge)
    if points.limb is None:
        return inside
    return jnp.where(points.limb >= 0, points.limb == limb, inside)


def _match_closest(sizes, poses, points, near_body, present, options) -> Match:
    """The exclusive rule: distances to all limbs, then the pair of each point with its closest limb alone."""
    limb = _closest_limb(sizes, poses, points, near_body, present, options)
    found = _once(options.robust_scale > 0, lambda: match_assigned(sizes, poses, points, limb, options))
    chosen = jnp.arange(sizes.shape[0])[:, None] == limb
    return found._replace(weight=jnp.where(chosen, found.weight, 0.0))


def _once(true: Bool[Array, ""], compute: Callable[[], Match]) -> Match:
    """What `compute` gives, computed once; `true` is a condition that the compiler cannot know to be so.

    The compiler for the CPU repeats a whole match for each sum that uses it (half of a step's time, and not linear in
    the points), but it does not look through a branch.
    """
    shapes = jax.eval_shape(compute)
    return jax.lax.cond(true, compute, lambda: jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes))


def _closest_limb(sizes, poses, points, near_body, present, options) -> Int[Array, " point"]:
    """The closest limb of those in whose box a point is; the number of limbs where there is none."""
    x, y, z = points.xyz[:, 0], points.xyz[:, 1], points.xyz[:, 2]
    limbs = sizes.shape[0]

    def one_limb(limb, here, size, pose):
        px, py, pz = _into_limb(pose.rotation, pose.translation, x, y, z)
        signed = closest_point(size, px, py, pz, options.refine).distance
        return jnp.where(here & _in_limb_box(limb, size, px, py, pz, points, options), signed, jnp.inf)

    signed = jax.vmap(one_limb)(jnp.arange(limbs), present, sizes, poses)
    nearest = jnp.min(signed, 0)
    # the first of equals; two minima are faster than one argmin
    winner = jnp.min(jnp.where(signed == nearest, jnp.arange(limbs)[:, None], limbs), 0)
    winner = jnp.where(near_body & (nearest < jnp.inf), winner, limbs)
    if options.sampling is None:
        return winner
    return jnp.where(_sampled(jnp.arange(limbs)[:, None] == winner, options.sampling).any(0), winner, limbs)


def closest_limbs(
    sizes: Float[Array, "limb 5"],
    poses: Poses,
    points: Points,
    options: MatchOptions,
    present: Bool[Array, " limb"],
) -> Int[Array, " point"]:
    """Which limb each point is matched to under the exclusive rule; the number of limbs where to none."""
    near_body = _near_body(sizes, poses, points, options, present)
    return _closest_limb(sizes, poses, points, near_body, present, options)


def match_assigned(
    sizes: Float[Array, "limb 5"],
    poses: Poses,
    points: Points,
    limb: Int[Array, " point"],
    options: MatchOptions,
) -> Match:
    """Pairs of points whose limbs are settled (see closest_limbs); of the limb axis of the weights 1 is left."""
    x, y, z = points.xyz[:, 0], points.xyz[:, 1], points.xyz[:, 2]
    order = jnp.arange(sizes.shape[0])[:, None]
    # points of no limb take the last one's row, with weight zero
    row = order == jnp.minimum(limb, sizes.shape[0] - 1)
    to_x, to_y = _sensor_directions(poses, points)
    rows = jnp.concatenate([poses.rotation, poses.translation, sizes, to_x, to_y], -1)
    # each point's row of the table by one product: much faster than a gather
    mine = jnp.matmul(rows.T, row.astype(x.dtype), precision="highest")
    size = mine[7:12]
    px, py, pz = _into_limb(mine[:4], mine[4:7], x, y, z)
    surface = closest_point(size, px, py, pz, options.refine)
    if options.near_side:
        sensors = to_x.shape[1]
        one = jax.nn.one_hot(points.sensor, sensors, axis=0, dtype=x.dtype)
        towards = [jnp.sum(mine[k : k + sensors] * one, 0) for k in (12, 12 + sensors)]
        surface = near_side(size, px, py, surface, *towards)
    chosen = (limb < sizes.shape[0])[None]
    return _weigh(chosen, (surface.x, surface.y, surface.z), (px, py, pz), points.weight[None], options)


def _weigh(chosen, model, data, weight, options) -> Match:
    """Maximum distance and robust weight (Geman-McClure) of the chosen pairs."""
    d2 = sum((p - c) ** 2 for p, c in zip(data, model))
    # a ratio, so that an infinite scale gives exactly one
    robust = (1 / (1 + d2 / options.robust_scale**2)) ** 2
    keep = chosen & (d2 <= options.max_distance**2)
    return Match(jnp.where(keep, robust * weight, 0.0), jnp.sqrt(d2 + 1e-12), model, data)


def _sampled(chosen: Bool[Array, "limb point"], sampling: Sampling) -> Bool[Array, "limb point"]:
    """Evenly spread ones of each limb's points: exactly the wanted number of them."""
    count = jnp.sum(chosen, 1, keepdims=True)
    share = jnp.round(sampling.factor * count).astype(count.dtype)
    wanted = jnp.minimum(jnp.clip(share, sampling.least, sampling.most), count)
    order = jnp.cumsum(chosen, 1)
    total = jnp.maximum(count, 1)
    return chosen & (order * wanted // total > (order - 1) * wanted // total)


def moments(found: Match) -> tuple[Float[Array, "limb 4 4"], Float[Array, "limb 3 3"]]:
    """Sums over points for every limb, limb frame: of w [1, c] [1, p]^T, and of w c c^T (for the coupled solver)."""
    one = jnp.ones_like(found.data[0])
    c, p = (one, *found.model), (one, *found.data)
    limbs = found.weight.shape[0]
    cross = [a * b for a in c for b in p]
    square = [found.model[a] * found.model[b] for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
    if one.ndim == 1:
        # column by column: a table of all would be made anew for each; full float32 everywhere (pitfall P27)
        sums = jnp.stack([jnp.matmul(found.weight, v, precision="highest") for v in (*cross, *square)], -1)
    else:
        sums = jnp.stack([jnp.sum(found.weight * v, -1) for v in (*cross, *square)], -1)
    xx, xy, xz, yy, yz, zz = (sums[:, 16 + i] for i in range(6))
    second = jnp.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], -1).reshape(limbs, 3, 3)
    return sums[:, :16].reshape(limbs, 4, 4), second
