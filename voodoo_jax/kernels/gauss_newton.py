"""All limbs and all bands in one damped Gauss-Newton step, beside the paper's solve limb by limb.

The solve per limb hands a correction down the chain one limb per step; here the bands couple the limbs' twists in one
linear system, so that a limb pulls the whole chain at once. Same correspondences, same bands, same weights.
"""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.ad_checkpoint import checkpoint_name
from jax.scipy.linalg import cho_factor, cho_solve, solve_triangular
from jaxtyping import Array, Float

from voodoo_jax.geometry.rigid import Poses, cross_matrix, matrix, quat_exp
from voodoo_jax.model.body import Links, LinkTables, Topology, tree_order

TURN_RADIUS = 0.1  # metres: what turns by one radian moves by so much


def _product(a: Float[Array, "*b row k"], b: Float[Array, "*b k column"]) -> Float[Array, "*b row column"]:
    """Product of small matrices, term by term: sums over an axis are calls of a library, slow for so few numbers."""
    return reduce(jnp.add, (a[..., :, k, None] * b[..., None, k, :] for k in range(b.shape[-2])))


def pair_normals(
    moments: Float[Array, "4 4"], second: Float[Array, "3 3"]
) -> tuple[Float[Array, "6 6"], Float[Array, "6"]]:
    """Normal matrix and right-hand side of one limb's twist (turn, shift; limb frame) from its point pairs.

    **Arguments:** `moments` sum of w [1, c] [1, p]^T; `second` sum of w c c^T; c model, p data points, limb frame.
    """
    weight, c, p, cp = moments[0, 0], moments[1:, 0], moments[0, 1:], moments[1:, 1:]
    turn = jnp.trace(second) * jnp.eye(3, dtype=second.dtype) - second
    mixed = cross_matrix(c)
    # sum of w c x p, from the antisymmetric part of the cross moments
    torque = jnp.stack([cp[1, 2] - cp[2, 1], cp[2, 0] - cp[0, 2], cp[0, 1] - cp[1, 0]])
    h = jnp.block([[turn, mixed], [-mixed, weight * jnp.eye(3, dtype=second.dtype)]])
    return h, jnp.concatenate([torque, p - c])


class Linked(NamedTuple):
    """What linked pairs add to the normal equations, for each link a block on both limbs and one between them."""

    first: Float[Array, "link 6 6"]
    second: Float[Array, "link 6 6"]
    between: Float[Array, "link 6 6"]  # row: twist of the first limb; column: of the second
    first_rhs: Float[Array, "link 6"]
    second_rhs: Float[Array, "link 6"]


def _slopes(points: Float[Array, "link pair 3"]) -> Float[Array, "link pair 3 7"]:
    """How points move with their limb's twist, in the limb's frame, and the points themselves."""
    eye = jnp.broadcast_to(jnp.eye(3, dtype=points.dtype), (*points.shape[:-1], 3, 3))
    return jnp.concatenate([-cross_matrix(points), eye, points[..., None]], -1)


def link_tables(links: Links) -> LinkTables:
    """What all steps of a frame have in common: a step turns only one frame into the other."""
    a, b, w = _slopes(links.first_points), _slopes(links.second_points), links.weights[..., None, None]
    first, second = (jnp.sum(_product(jnp.swapaxes(w * x, -1, -2), x), 1) for x in (a, b))
    return LinkTables(first, second, jnp.sum((w * a)[..., :, None, :, None] * b[..., None, :, None, :], 1))


def linked(links: Links, poses: Poses, strength: Float[Array, " limb"]) -> Linked:
    """Normal equations of linked pairs."""
    one, two = links.first, links.second
    *own, table = link_tables(links) if links.tables is None else links.tables

    r, place = matrix(poses.rotation), poses.translation
    back = jnp.swapaxes(r[one], -1, -2)
    turn = _product(back, r[two])
    apart = _product(back, (place[two] - place[one])[..., None])  # of the limbs' origins, in the first one's frame
    other = _product(jnp.swapaxes(turn, -1, -2), apart)  # in the second one's
    terms = [table[:, i, j] * turn[:, i, j, None, None] for i in range(3) for j in range(3)]
    mixed = reduce(jnp.add, terms)
    s = ((strength[one] + strength[two]) / 2)[:, None]
    shift = lambda h, v: _product(h[:, :6, 3:6], v)[..., 0]  # noqa: E731
    g1 = mixed[:, :6, 6] + shift(own[0], apart) - own[0][:, :6, 6]
    g2 = mixed[:, 6, :6] - shift(own[1], other) - own[1][:, :6, 6]
    block = lambda h: s[..., None] * h[:, :6, :6]  # noqa: E731
    return Linked(block(own[0]), block(own[1]), -block(mixed), s * g1, s * g2)


def add_links(links: Links, poses: Poses, strength, h, g):
    """Adds linked pairs to the normal matrix [limb, 6, limb, 6] and right-hand side [limb, 6]."""
    one, two, found = links.first, links.second, linked(links, poses, strength)
    rows, columns = jnp.concatenate([one, two, one, two]), jnp.concatenate([one, two, two, one])
    blocks = jnp.concatenate([found.first, found.second, found.between, jnp.swapaxes(found.between, 1, 2)])
    h = h.at[rows, :, columns].add(blocks)
    return h, g.at[rows[: 2 * len(one)]].add(jnp.concatenate([found.first_rhs, found.second_rhs]))


def coupled_normals(
    links: tuple[Links, ...],
    poses: Poses,
    normals: Float[Array, "limb 6 6"],
    rhs: Float[Array, "limb 6"],
    strength: Float[Array, " limb"],
    damping: Float[Array, ""],
) -> tuple[Float[Array, "limb6 limb6"], Float[Array, "limb 6"]]:
    """Normal matrix of all limbs' twists (turn, shift; each in its limb's frame), damped, and the right-hand side.

    **Arguments:** `normals, rhs` of each limb's own pairs; `strength` what a linked pair of weight 1 weighs on a limb,
    a link takes the mean of its two; `damping` added to the diagonal, as a share of each limb's mean diagonal.
    """
    count = normals.shape[0]
    limbs = jnp.arange(count)
    # each block where it lies in the whole matrix: to put it there later takes as long as all the sums
    h = jnp.zeros((count, 6, count, 6), normals.dtype).at[limbs, :, limbs].add(normals)
    g = rhs
    for some in links:
        h, g = add_links(some, poses, strength, h, g)
    full = h.reshape(6 * count, 6 * count)
    own = jnp.sum(jnp.diagonal(full).reshape(count, 6), 1) / 6
    return full + jnp.diag(jnp.repeat(damping * own + 1e-9, 6)), g


def coupled_twists(full: Float[Array, "limb6 limb6"], rhs: Float[Array, "limb 6"]) -> Float[Array, "limb 6"]:
    """The step that the normal equations ask for: turns and shifts of all limbs, each in its own frame, radians and
    metres.

    **Arguments:** see coupled_normals.
    """
    # transposed, which it equals: LAPACK goes by columns, and nothing need be copied
    factor = checkpoint_name(cho_factor(jax.lax.stop_gradient(full).T, lower=True)[0], "factor"), True
    # so that the derivative is one more solve with the same factor, and that of the factor is not needed
    twist = jax.lax.custom_linear_solve(
        lambda x: full @ x, rhs.reshape(-1), lambda _, b: cho_solve(factor, b), symmetric=True
    )
    return checkpoint_name(twist.reshape(rhs.shape), "factor")


def stretched(
    twist: Float[Array, "limb 6"], before: Float[Array, "limb 6"], most: Float[Array, ""]
) -> Float[Array, "limb 6"]:
    """A step, longer for limbs whose previous step had the same direction: if each step is a constant share of the
    previous one, the sum of all is 1 / (1 - share) times as long (Aitken's extrapolation; for vectors: Irons and Tuck
    1969, doi:10.1002/nme.1620010306).

    **Arguments:** `before` the previous step before extrapolation, zero: unknown; `most` the largest factor.
    """
    metres = jnp.array([TURN_RADIUS**2] * 3 + [1.0] * 3, twist.dtype)
    along, square = jnp.sum(metres * twist * before, -1), jnp.sum(metres * before * before, -1)
    share = jnp.clip(along / (square + 1e-12), 0.0, 1.0 - 1.0 / most)
    return twist / (1.0 - share)[:, None]


def as_motions(twist: Float[Array, "limb 6"]) -> tuple[Float[Array, "limb 4"], Float[Array, "limb 3"]]:
    """Motions of all limbs, each in its own frame: unit quaternions and shifts (metres)."""
    # a first step from far away may ask for more than the linearisation is good for
    turn = twist[:, :3]
    angle = jnp.sqrt(jnp.sum(turn * turn, -1, keepdims=True) + 1e-12)
    turn = turn * jnp.minimum(1.0, 0.5 / angle)
    return quat_exp(turn), twist[:, 3:]


def twist_covariance(full: Float[Array, "limb6 limb6"]) -> Float[Array, "limb 6 6"]:
    """Covariance of each limb's twist (turn, shift; limb frame) for measurements of unit variance per unit of weight:
    the limb's block of the inverse of the normal matrix, so that what the other limbs leave open counts."""
    count = full.shape[0] // 6
    factor = jnp.linalg.cholesky(full)

    def block(columns):
        half = solve_triangular(factor, columns, lower=True)
        return jnp.matmul(half.T, half, precision="highest")

    # limb by limb: for more columns at once LAPACK wakes threads, which takes a hundred times as long as the solve
    return jax.lax.map(block, jnp.eye(6 * count, dtype=full.dtype).reshape(-1, count, 6).transpose(1, 0, 2))


def tree_covariance(topology: Topology, full: Float[Array, "limb6 limb6"]) -> Float[Array, "limb 6 6"]:
    """As twist_covariance, where nothing but joints links limbs: from the outermost limbs inwards and back, no call of
    LAPACK; for many frames at once."""
    count, joints = full.shape[0] // 6, np.array(tree_order(topology), int)
    parents, children = (jnp.array(np.array(limbs, int)[joints]) for limbs in (topology.parents, topology.children))
    blocks = full.reshape(count, 6, count, 6)
    limbs = jnp.arange(count)

    def inwards(own, joint):
        parent, child, between = joint
        inverse = _inverse(own[child])
        gain = _product(inverse, between)
        return own.at[parent].add(-_product(between.T, gain)), (inverse, gain)

    between = blocks[children, :, parents]
    own, (inverse, gain) = jax.lax.scan(inwards, blocks[limbs, :, limbs], (parents, children, between), reverse=True)

    def outwards(found, joint):
        parent, child, inverse, gain = joint
        return found.at[child].set(inverse + _product(_product(gain, found[parent]), gain.T)), None

    found = jnp.zeros_like(own).at[0].set(_inverse(own[0]))
    return jax.lax.scan(outwards, found, (parents, children, inverse, gain))[0]


def _inverse(a: Float[Array, "row row"]) -> Float[Array, "row row"]:
    """Inverse of a symmetric positive definite matrix: all its rows swept, one after the other."""

    def sweep(k, a):
        here = jnp.arange(a.shape[0]) == k
        row = a[k] / a[k, k]
        swept = a - a[:, k, None] * row
        swept = jnp.where(here[:, None], row, jnp.where(here, row[:, None], swept))
        return jnp.where(here[:, None] & here, -1 / a[k, k], swept)

    return -jax.lax.fori_loop(0, a.shape[0], sweep, a)


def point_covariance(twist: Float[Array, "6 6"], pose: Poses, point: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Covariance in the world frame of a point of a limb (limb frame, metres) from that of the limb's twist."""
    turn = matrix(pose.rotation)
    slope = jnp.concatenate([-cross_matrix(point), jnp.eye(3, dtype=point.dtype)], -1)
    local = jnp.matmul(jnp.matmul(slope, twist, precision="highest"), slope.T, precision="highest")
    return jnp.matmul(jnp.matmul(turn, local, precision="highest"), turn.T, precision="highest")
