"""All limbs and all bands in one damped Gauss-Newton step, beside the paper's solve limb by limb.

The solve per limb hands a correction down the chain one limb per step; here the bands couple the limbs' twists in one
linear system, so that a limb pulls the whole chain at once. Same correspondences, same bands, same weights.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve, solve_triangular
from jaxtyping import Array, Float

from voodoo_jax.body import Links
from voodoo_jax.pose import Poses, matrix, quat_exp, rotate, unrotate


def _cross(v: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Matrix of the cross product: _cross(v) w = v x w."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    o = jnp.zeros_like(x)
    return jnp.stack([jnp.stack(r, -1) for r in ([o, -z, y], [z, o, -x], [-y, x, o])], -2)


def pair_normals(
    moments: Float[Array, "4 4"], second: Float[Array, "3 3"]
) -> tuple[Float[Array, "6 6"], Float[Array, "6"]]:
    """Normal matrix and right-hand side of one limb's twist (turn, shift; limb frame) from its point pairs.

    **Arguments:** `moments` sum of w [1, c] [1, p]^T; `second` sum of w c c^T; c model, p data points, limb frame.
    """
    weight, c, p, cp = moments[0, 0], moments[1:, 0], moments[0, 1:], moments[1:, 1:]
    turn = jnp.trace(second) * jnp.eye(3, dtype=second.dtype) - second
    mixed = _cross(c)
    # sum of w c x p, from the antisymmetric part of the cross moments
    torque = jnp.stack([cp[1, 2] - cp[2, 1], cp[2, 0] - cp[0, 2], cp[0, 1] - cp[1, 0]])
    h = jnp.block([[turn, mixed], [-mixed, weight * jnp.eye(3, dtype=second.dtype)]])
    return h, jnp.concatenate([torque, p - c])


def add_links(links: Links, poses: Poses, strength, h, g):
    """Adds linked pairs to the normal matrix [limb, limb, 6, 6] and right-hand side [limb, 6]."""
    one, two = links.first, links.second
    r = matrix(poses.rotation)

    def arm(limbs, points):
        """World place of points and its derivative by the limb's twist."""
        rot = r[limbs][:, None]
        place = rotate(poses.rotation[limbs][:, None], points) + poses.translation[limbs][:, None]
        turn = -jnp.sum(rot[..., :, :, None] * _cross(points)[..., None, :, :], -2)
        return place, jnp.concatenate([turn, jnp.broadcast_to(rot, turn.shape)], -1)

    x1, j1 = arm(one, links.first_points)
    x2, j2 = arm(two, links.second_points)
    w = links.weights * ((strength[one] + strength[two]) / 2)[:, None]
    gap = x2 - x1

    def outer(a, b):
        return jnp.einsum("jb,jbki,jbkl->jil", w, a, b, precision="highest")

    def along(a, v):
        return jnp.einsum("jb,jbki,jbk->ji", w, a, v, precision="highest")

    h = h.at[one, one].add(outer(j1, j1)).at[two, two].add(outer(j2, j2))
    h = h.at[one, two].add(-outer(j1, j2)).at[two, one].add(-outer(j2, j1))
    return h, g.at[one].add(along(j1, gap)).at[two].add(-along(j2, gap))


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
    h = jnp.zeros((count, count, 6, 6), normals.dtype).at[limbs, limbs].add(normals)
    g = rhs
    for some in links:
        h, g = add_links(some, poses, strength, h, g)
    full = h.transpose(0, 2, 1, 3).reshape(6 * count, 6 * count)
    own = jax.vmap(lambda k: jnp.trace(h[k, k]) / 6)(limbs)
    return full + jnp.diag(jnp.repeat(damping * own + 1e-9, 6)), g


def coupled_product(
    links: tuple[Links, ...],
    poses: Poses,
    normals: Float[Array, "limb 6 6"],
    strength: Float[Array, " limb"],
    damping: Float[Array, ""],
    twist: Float[Array, "limb 6"],
) -> Float[Array, "limb 6"]:
    """The normal matrix of coupled_normals times a twist of every limb, without the matrix."""
    product = jnp.sum(normals * twist[:, None], -1)
    diagonal = jnp.trace(normals, axis1=1, axis2=2)
    for some in links:
        one, two = some.first, some.second
        w = some.weights * ((strength[one] + strength[two]) / 2)[:, None]

        def speed(limbs, points, twist=twist):
            turn, shift = jnp.split(twist[limbs][:, None], 2, -1)
            return rotate(poses.rotation[limbs][:, None], shift + jnp.cross(turn, points))

        def force(limbs, points, pull):
            own = unrotate(poses.rotation[limbs][:, None], pull)
            return jnp.sum(jnp.concatenate([jnp.cross(points, own), own], -1), 1)

        pull = w[..., None] * (speed(one, some.first_points) - speed(two, some.second_points))
        product = product.at[one].add(force(one, some.first_points, pull))
        product = product.at[two].add(-force(two, some.second_points, pull))
        # of a link's own block: a shift counts once, a turn with the square of its arm
        for limbs, points in ((one, some.first_points), (two, some.second_points)):
            diagonal = diagonal.at[limbs].add(jnp.sum(w * (3 + 2 * jnp.sum(points * points, -1)), -1))
    return product + (damping * diagonal / 6 + 1e-9)[:, None] * twist


def coupled_factor(full: Float[Array, "limb6 limb6"]) -> Float[Array, "limb6 limb6"]:
    """Lower triangle of the normal matrix's factors, without a derivative of its own: see coupled_step."""
    return cho_factor(jax.lax.stop_gradient(full), lower=True)[0]


def coupled_step(
    factor: Float[Array, "limb6 limb6"],
    rhs: Float[Array, "limb 6"],
    product: Callable[[Float[Array, "limb 6"]], Float[Array, "limb 6"]],
) -> tuple[Float[Array, "limb 4"], Float[Array, "limb 3"]]:
    """Motions of all limbs, each in its own frame: unit quaternions and shifts (metres).

    **Arguments:** `factor, rhs` see coupled_factor and coupled_normals; `product` the normal matrix times a twist
    (coupled_product): the derivative of the solution is one more solve with the same factor, and that of the factors is
    not needed.
    """

    def solve(_, b):
        return cho_solve((factor, True), b.reshape(-1)).reshape(b.shape)

    twist = jax.lax.custom_linear_solve(product, rhs, solve, symmetric=True)
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


def point_covariance(twist: Float[Array, "6 6"], pose: Poses, point: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Covariance in the world frame of a point of a limb (limb frame, metres) from that of the limb's twist."""
    turn = matrix(pose.rotation)
    slope = jnp.concatenate([-_cross(point), jnp.eye(3, dtype=point.dtype)], -1)
    local = jnp.matmul(jnp.matmul(slope, twist, precision="highest"), slope.T, precision="highest")
    return jnp.matmul(jnp.matmul(turn, local, precision="highest"), turn.T, precision="highest")
