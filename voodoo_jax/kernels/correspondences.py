"""From points to weighted correspondences of all limbs, and to their moments (Knoop 2007, sec. 5.2)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.geometry.rigid import Poses, unrotate
from voodoo_jax.geometry.robust import geman_mcclure
from voodoo_jax.kernels.assignment import closest_limb, cuts, in_reach, into_limb, may_belong, once, sampled
from voodoo_jax.kernels.assignment import closest_limbs as closest_limbs
from voodoo_jax.kernels.bounding_boxes import resolve_overlap, shares
from voodoo_jax.kernels.frustum import Sides, SurfacePoint, closest_point, near_side, uncut
from voodoo_jax.kernels.points import FREE as FREE
from voodoo_jax.kernels.points import ON_BODY as ON_BODY
from voodoo_jax.kernels.points import Components, MatchOptions, Points, components
from voodoo_jax.kernels.points import Sampling as Sampling


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


class Settled(NamedTuple):
    """Every choice of a matching: with these held fixed, pairs change smoothly with poses and sizes.

    Under the exclusive rule `limb` is the limb of each point, the number of limbs for none; under others a table of
    the candidates, and the rest has a leading limb axis.
    """

    limb: Int[Array, " point"] | Bool[Array, "limb point"]
    sides: Sides
    kept: Bool[Array, "*limb point"]  # near enough to count

    def differs(self, other: "Settled") -> Bool[Array, " point"]:
        """Which points are matched in another way, of those that count in one of the two."""
        sides = jnp.any(jnp.stack([a != b for a, b in zip(self.sides, other.sides)]), 0)
        unlike = (self.kept != other.kept) | ((sides | (self.limb != other.limb)) & self.kept)
        return unlike if unlike.ndim == 1 else jnp.any(unlike, 0)


def _sensors(poses: Poses, points: Points) -> list[Float[Array, "limb sensor"]]:
    """x, y and z of every sensor in every limb's frame, metres."""
    local = unrotate(poses.rotation[:, None], points.origins[None] - poses.translation[:, None])
    return [local[..., k] for k in range(3)]


# 7 parameters: a frame, how it is matched, and what is settled
def match(
    sizes: Float[Array, "limb 5"],
    poses: Poses,
    points: Points,
    adjacent: Bool[Array, "limb limb"],
    options: MatchOptions,
    present: Bool[Array, " limb"] | None = None,
    fixed: Settled | None = None,
) -> Match:
    """Gates, overlap rule, closest points, maximum distance and robust weights for one frame; `fixed` choices that are
    settled.

    Points known to be on the body pass the body's box, points of a known limb the limbs' boxes and the overlap rule too
    (2007, Fig. 4).
    """
    present = jnp.ones(sizes.shape[0], bool) if present is None else present
    if options.overlap != "exclusive":
        return _match_all(sizes, poses, points, adjacent, present, options, fixed)[0]
    # distances to all limbs, then the pair of each point with its closest limb alone
    xyz = components(points.xyz)
    limb = _closest(sizes, poses, points, xyz, present, options) if fixed is None else fixed.limb
    zero = jnp.zeros_like(xyz[0])
    nothing = Match(zero[None], zero, (zero, zero, zero), (zero, zero, zero))
    pairs = lambda: match_assigned(sizes, poses, points, limb, options, xyz, fixed)  # noqa: E731
    found = once(options.robust_scale > 0, pairs, nothing)
    chosen = jnp.arange(sizes.shape[0])[:, None] == limb
    return found._replace(weight=jnp.where(chosen, found.weight, 0.0))


def settled(
    sizes: Float[Array, "limb 5"],
    poses: Poses,
    points: Points,
    adjacent: Bool[Array, "limb limb"],
    options: MatchOptions,
    present: Bool[Array, " limb"],
) -> Settled:
    """The choices of a matching, see match."""
    if options.overlap != "exclusive":
        return _match_all(sizes, poses, points, adjacent, present, options)[1]
    xyz = components(points.xyz)
    limb = _closest(sizes, poses, points, xyz, present, options)
    return _assigned(sizes, poses, points, limb, options, xyz)[1]


def _closest(sizes, poses, points, xyz, present, options) -> Int[Array, " point"]:
    """The exclusive rule; which limb is nearest has no derivative."""
    near_body = in_reach(sizes, poses, points, options, present)
    sizes, poses, points, xyz = jax.lax.stop_gradient((sizes, poses, points, xyz))
    near = lambda: closest_limb(sizes, poses, points, xyz, near_body, present, options)  # noqa: E731
    return checkpoint_name(once(options.robust_scale > 0, near, jnp.zeros_like(near_body, jnp.int32)), "limb")


# 7 parameters: those of match
def _match_all(sizes, poses, points, adjacent, present, options, fixed=None) -> tuple[Match, Settled]:
    """Pairs of every point with every limb, and the choices in them."""
    xyz = components(points.xyz)

    def one_limb(limb, here, size, pose, sensors, fixed):
        sides, counts = (None, None) if fixed is None else (fixed.sides, fixed.limb)
        seen_from = [part[points.sensor] for part in sensors] if options.near_side else None
        data, surface = _on_limb(size, pose.rotation, pose.translation, xyz, seen_from, options, uncut, sides, counts)
        return surface, data, here & may_belong(limb, size, *data, points, options)

    limbs = jnp.arange(sizes.shape[0])
    rows = limbs, present, sizes, poses, _sensors(poses, points), fixed
    surface, data, box = jax.vmap(one_limb)(*rows)
    if fixed is not None:
        chosen = fixed.limb
    else:
        near_body = in_reach(sizes, poses, points, options, present)
        chosen = resolve_overlap(options.overlap, box & near_body, surface.distance, adjacent)
        if options.sampling is not None:
            chosen = sampled(chosen, options.sampling)
    weight = points.weight[None, :]
    if options.overlap == "soft":
        weight = weight * shares(chosen, surface.distance, options.softness)
    found, kept = _weigh(chosen, surface, data, weight, options, fixed=fixed)
    return found, Settled(chosen, surface.sides, kept)


# 7 parameters: points by component, for a product over an axis of 3 is slow, and what is settled
def match_assigned(
    sizes: Float[Array, "limb 5"],
    poses: Poses,
    points: Points,
    limb: Int[Array, " point"],
    options: MatchOptions,
    xyz: Components | None = None,
    fixed: Settled | None = None,
) -> Match:
    """Pairs of points whose limbs are settled (see closest_limbs); of the limb axis of the weights 1 is left.

    `xyz`: the points by component, where they are at hand; `fixed`: all other choices, if they are settled, too.
    """
    return _assigned(sizes, poses, points, limb, options, xyz, fixed)[0]


# 7 parameters: those of match_assigned
def _assigned(sizes, poses, points, limb, options, xyz=None, fixed=None) -> tuple[Match, Settled]:
    """The same, and the choices in it."""
    cut = cuts(options.robust_scale > 0)
    xyz = components(points.xyz) if xyz is None else xyz
    order = jnp.arange(sizes.shape[0])[:, None]
    # points of no limb take the last one's row, with weight zero
    row = order == jnp.minimum(limb, sizes.shape[0] - 1)
    columns = [poses.rotation, poses.translation, sizes, *(_sensors(poses, points) if options.near_side else ())]
    table = jnp.concatenate([some.T for some in columns])
    # each point's column of the table by one product: much faster than a gather
    mine = jnp.matmul(table, row.astype(xyz[0].dtype), precision="highest")
    # split, not indexed: the derivative is one concatenation then, instead of a sum of padded arrays
    mine = cut(*(part[0] for part in jax.lax.split(mine, (1,) * len(table))))
    seen_from = None
    if options.near_side:
        sensors = points.origins.shape[-2]
        one = jax.nn.one_hot(points.sensor, sensors, axis=0, dtype=xyz[0].dtype)
        seen_from = [jnp.sum(jnp.stack(mine[12 + k * sensors :][:sensors]) * one, 0) for k in range(3)]
    sides, counts = (None, None) if fixed is None else (fixed.sides, fixed.kept)
    data, surface = _on_limb(mine[7:12], mine[:4], mine[4:7], xyz, seen_from, options, cut, sides, counts)
    found, kept = _weigh(limb < sizes.shape[0], surface, data, points.weight, options, cut, fixed)
    return found._replace(weight=found.weight[None]), Settled(limb, surface.sides, kept)


# 9 parameters: a limb, or each point's own, by component; and what is settled
def _on_limb(
    size, rotation, translation, xyz, seen_from, options, cut, sides, counts
) -> tuple[Components, SurfacePoint]:
    """Points in their limb's frame, and where on it their pairs are."""
    x, y, z = cut(*into_limb(rotation, translation, *xyz))
    if counts is not None:  # what counts nothing must not be a number that is none: it is put anywhere off the axis
        x, y, z = (jnp.where(counts, k, 1.0) for k in (x, y, z))
    surface = closest_point(size, x, y, z, options.refine, options.caps, cut=cut, fixed=sides)
    if seen_from is not None:
        surface = near_side(size, x, y, surface, seen_from, cut=cut, fixed=sides)
    return (x, y, z), surface


# 7 parameters: pairs by component, and what is settled
def _weigh(chosen, surface, data, weight, options, cut=uncut, fixed=None) -> tuple[Match, Bool[Array, "*limb point"]]:
    """Maximum distance and robust weight (Geman-McClure) of the chosen pairs, and which are near enough."""
    model = surface.x, surface.y, surface.z
    (d2,) = cut(sum((p - c) ** 2 for p, c in zip(data, model)))
    robust = geman_mcclure(d2, options.robust_scale)
    keep = chosen & (d2 <= options.max_distance**2) if fixed is None else fixed.kept
    (weight,) = cut(jnp.where(keep, robust * weight, 0.0))
    return Match(weight, jnp.sqrt(d2 + 1e-12), model, data), keep


class Sums(NamedTuple):
    """Sums over the pairs of every limb, in its frame; c model, p data points, w weights."""

    moments: Float[Array, "limb 4 4"]  # w [1, c] [1, p]^T
    second: Float[Array, "limb 3 3"] | None  # w c c^T, for the coupled solver
    squares: Float[Array, ""]  # w distance^2 of all limbs, square metres


def sums(found: Match, second: bool = True) -> Sums:
    """Moments as one product of matrices where all limbs have the same pairs. Second moments are computed only on
    request, and the squares separately: the compiler cannot leave out unused parts of a product."""
    c, p = found.model, found.data
    first = [jnp.ones_like(p[0]), *p, *(k for x in c for k in (x, *(x * y for y in p)))]
    rows = jnp.stack([*first, *(c[i] * c[j] for i, j in SYMMETRIC if second)])
    if rows.ndim > 2:
        table = jnp.sum(found.weight * rows, -1).T
        squares = jnp.sum(found.weight * found.distance**2)
    else:  # full float32 everywhere (docs/numerics.md#tf32)
        table = jax.lax.dot_general(found.weight, rows, (((1,), (1,)), ((), ())), precision="highest")
        # as a product: the compiler for the CPU adds a plain sum up number by number
        squares = jnp.sum(jnp.matmul(found.weight, found.distance**2, precision="highest"))
    of_first = table[:, :16].reshape(-1, 4, 4)
    if not second:
        return Sums(of_first, None, squares)
    of_second = table[:, [16 + SYMMETRIC.index((min(i, j), max(i, j))) for i in range(3) for j in range(3)]]
    return Sums(of_first, of_second.reshape(-1, 3, 3), squares)


SYMMETRIC = [(i, j) for i in range(3) for j in range(i, 3)]


def moments(found: Match) -> tuple[Float[Array, "limb 4 4"], Float[Array, "limb 3 3"]]:
    """The first two of the sums."""
    first, second, _ = sums(found)
    assert second is not None
    return first, second
