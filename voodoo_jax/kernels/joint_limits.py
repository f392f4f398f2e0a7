"""Plausibility: joints beyond their limits, limbs that pass through each other (named in Knoop 2006, sec. IV-B.7): the
nearest places of limbs that share no joint, and pairs that push limbs out of each other.

Both are found from a pose alone, and corrected by artificial correspondences of the same kind as elastic bands (2007,
sec. 8: "angular limits ... maintained valid by artificial point correspondences").
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from voodoo_jax.geometry.rigid import Poses, apply, quat_conjugate, quat_exp, quat_log, quat_multiply, rotate, unrotate
from voodoo_jax.model.body import Body, Links, Topology, bands


class Contacts(NamedTuple):
    """The nearest places of limbs that share no joint."""

    first: Int[Array, " pair"]  # limb
    second: Int[Array, " pair"]
    overlap: Float[Array, " pair"]  # how deep the limbs are in each other, metres; negative: the gap between them
    first_points: Float[Array, "pair 3"]  # on the surface, limb frame
    second_points: Float[Array, "pair 3"]
    normal: Float[Array, "pair 3"]  # unit, from the first limb's axis to the second's, world frame


def apart(topology: Topology) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of limbs that share no joint: first and second limb of each."""
    joined = {frozenset(ends) for ends in zip(topology.parents, topology.children)}
    count = len(topology.limbs)
    pairs = [(a, b) for a in range(count) for b in range(a) if frozenset((a, b)) not in joined]
    table = np.array(pairs, int).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def contacts(body: Body, poses: Poses) -> Contacts:
    """Nearest places of all pairs of limbs that share no joint.

    The shortest way between the limbs' axes, with the ellipses' radii in its direction: exact for round limbs side by
    side, a few millimetres off for flat or strongly tapering ones.
    """
    one, two = apart(body.topology)
    middle = body.sizes[:, 4] / 2
    # the ends are drawn in by their radii: a limb ends flat, not with a half sphere beyond its end
    low = jnp.minimum(jnp.minimum(body.sizes[:, 0], body.sizes[:, 1]), middle)
    high = jnp.maximum(body.sizes[:, 4] - jnp.minimum(body.sizes[:, 2], body.sizes[:, 3]), middle)
    axis = rotate(poses.rotation, jnp.array([0.0, 0.0, 1.0], body.sizes.dtype))
    s, t = _nearest_on_lines(poses.translation[one] - poses.translation[two], axis[one], axis[two],
                             (low[one], high[one]), (low[two], high[two]))  # fmt: skip
    p = poses.translation[one] + s[:, None] * axis[one]
    q = poses.translation[two] + t[:, None] * axis[two]
    d = q - p
    d2 = jnp.sum(d * d, -1)
    crossing = d2 < 1e-10
    distance = jnp.sqrt(jnp.where(crossing, 1.0, d2))
    # axes that cross say nothing about the way out: across both of them
    out = jnp.cross(axis[one], axis[two])
    out = out / jnp.sqrt(jnp.sum(out * out, -1, keepdims=True) + 1e-12)
    n = jnp.where(crossing[:, None], out, d / distance[:, None])
    r1 = _radius(body.sizes[one], s, unrotate(poses.rotation[one], n))
    r2 = _radius(body.sizes[two], t, unrotate(poses.rotation[two], n))
    first = unrotate(poses.rotation[one], p + r1[:, None] * n - poses.translation[one])
    second = unrotate(poses.rotation[two], q - r2[:, None] * n - poses.translation[two])
    overlap = r1 + r2 - jnp.where(crossing, 0.0, distance)
    there = body.present[one] & body.present[two]
    return Contacts(jnp.array(one, int), jnp.array(two, int), jnp.where(there, overlap, -jnp.inf), first, second, n)


def _nearest_on_lines(w, u, v, s_range, t_range):
    """Parameters of the nearest points of two line segments along unit vectors u, v; w from the second's origin to the
    first's (Ericson 2005, Real-Time Collision Detection, sec. 5.1.9)."""
    b, d, e = jnp.sum(u * v, -1), jnp.sum(u * w, -1), jnp.sum(v * w, -1)
    steep = 1 - b * b
    parallel = steep < 1e-6
    s = jnp.where(parallel, (s_range[0] + s_range[1]) / 2, (b * e - d) / jnp.where(parallel, 1.0, steep))
    t = jnp.clip(b * jnp.clip(s, *s_range) + e, *t_range)
    s = jnp.clip(b * t - d, *s_range)
    return s, jnp.clip(b * s + e, *t_range)


def _radius(sizes, z, n):
    """Distance from the axis to the surface at height z in the direction n (limb frame), metres."""
    share = jnp.clip(z / sizes[:, 4], 0.0, 1.0)
    a = sizes[:, 0] + share * (sizes[:, 2] - sizes[:, 0])
    b = sizes[:, 1] + share * (sizes[:, 3] - sizes[:, 1])
    flat = n[:, 0] ** 2 + n[:, 1] ** 2
    along = flat < 1e-6
    x = jnp.where(along, 0.5, n[:, 0] ** 2 / jnp.where(along, 1.0, flat))
    return a * b / jnp.sqrt(b * b * x + a * a * (1 - x))


def passing_through(body: Body, found: Contacts, margin: Float[Array, ""]) -> Float[Array, " pair"]:
    """How much farther the limbs are in each other than in the rest pose and `margin` (metres) allow; 0: they are not.

    A model's neighbouring limbs may overlap in the rest pose already: cylinders are not people.
    """
    rest = contacts(body, body.rest).overlap
    return jnp.maximum(found.overlap - jnp.maximum(rest, 0.0) - margin, 0.0)


def contact_links(body: Body, poses: Poses, weight: Float[Array, ""], margin: Float[Array, ""]) -> Links:
    """Pairs that push limbs out of each other; weight zero where they are not in each other."""
    found = contacts(body, poses)
    deep = passing_through(body, found, margin)
    # what is allowed stays: the pair's points are as far from each other as the limbs are too deep
    excess = (found.overlap - deep)[:, None] / 2
    excess = jnp.where(deep[:, None] > 0, excess, 0.0)
    first = found.first_points - excess * unrotate(poses.rotation[found.first], found.normal)
    second = found.second_points + excess * unrotate(poses.rotation[found.second], found.normal)
    weights = jnp.where(deep > 0, weight, 0.0)[:, None]
    return Links(found.first, found.second, first[:, None], second[:, None], weights)


class PlausibleOptions(eqx.Module):
    """Weights of the corrections, relative to a joint of weight 1; None: nothing is corrected."""

    limits: Float[Array, ""] | None
    collisions: Float[Array, ""] | None
    margin: Float[Array, ""]  # limbs may overlap by so much more than in the rest pose, metres


class JointAngles(NamedTuple):
    """Where the joints are, and where their limits would have them."""

    angles: Float[Array, "joint 3"]  # swing about x and y, twist about z of the joint's frame; radians
    beyond: Float[Array, " joint"]  # angle between the joint's rotation and the nearest allowed one, radians
    allowed: Float[Array, "joint 4"]  # rotation of the child's joint frame in the parent's, within the limits


def joint_angles(body: Body, poses: Poses) -> JointAngles:
    """Angles of all joints: the child's joint frame is first twisted about its z axis, then swung about an axis in the
    x-y plane (swing-twist decomposition)."""
    parents, children = jnp.array(body.topology.parents, int), jnp.array(body.topology.children, int)
    parent = quat_multiply(poses.rotation[parents], body.parent_anchor.rotation)
    child = quat_multiply(poses.rotation[children], body.child_anchor.rotation)
    q = quat_multiply(quat_conjugate(parent), child)
    w, z = q[:, 0], q[:, 3]
    # half a turn of swing leaves the twist open: any will do
    open_ = w * w + z * z < 1e-9
    w, z = jnp.where(open_, 1.0, w), jnp.where(open_, 0.0, z)
    twist = 2 * jnp.arctan2(z, w)
    twist = jnp.where(twist > jnp.pi, twist - 2 * jnp.pi, jnp.where(twist < -jnp.pi, twist + 2 * jnp.pi, twist))
    zero = jnp.zeros_like(twist)
    turn = quat_exp(jnp.stack([zero, zero, twist], -1))
    swing = quat_log(quat_multiply(q, quat_conjugate(turn)))
    angles = jnp.stack([swing[:, 0], swing[:, 1], twist], -1)
    kept = jnp.clip(angles, body.limits[..., 0], body.limits[..., 1])
    flat = jnp.concatenate([kept[:, :2], zero[:, None]], -1)
    allowed = quat_multiply(quat_exp(flat), quat_exp(jnp.stack([zero, zero, kept[:, 2]], -1)))
    off = quat_log(quat_multiply(quat_conjugate(q), allowed))
    off2 = jnp.sum(off * off, -1)
    within = jnp.all(kept == angles, -1) | (off2 < 1e-8)
    return JointAngles(angles, jnp.where(within, 0.0, jnp.sqrt(jnp.where(within, 1.0, off2))), allowed)


def limit_links(body: Body, poses: Poses, weight: Float[Array, ""]) -> Links:
    """Pairs that turn the limbs of a joint back to its nearest limit; weight zero within the limits.

    Three pairs per joint, on the axes of the joint's frame, half a limb's length away from the joint.
    """
    parents, children = jnp.array(body.topology.parents, int), jnp.array(body.topology.children, int)
    found = joint_angles(body, poses)
    reach = 0.5 * body.sizes[children, 4]
    ends = jnp.eye(3, dtype=reach.dtype)[None] * reach[:, None, None]
    target = rotate(found.allowed[:, None], ends)
    first = apply(body.parent_anchor[:, None], target)
    second = apply(body.child_anchor[:, None], ends)
    there = (found.beyond > 0) & body.present[parents] & body.present[children]
    weights = jnp.where(there, weight * body.weights / 3, 0.0)
    return Links(parents, children, first, second, jnp.broadcast_to(weights[:, None], (weights.shape[0], 3)))


def joint_links(body: Body, poses: Poses, options: PlausibleOptions) -> Links:
    """The bands of all joints, with the pairs that turn them back into their limits from these poses, where they are
    switched on: one link per joint, so that these cost a step nothing."""
    links = bands(body)
    if options.limits is None:
        return links
    back = limit_links(body, poses, options.limits)
    first, second, weights = (jnp.concatenate(pair, 1) for pair in zip(links[2:5], back[2:5]))
    return Links(links.first, links.second, first, second, weights)


def corrections(body: Body, poses: Poses, options: PlausibleOptions) -> tuple[Links, ...]:
    """The pairs that push limbs out of each other in this pose, where they are switched on."""
    if options.collisions is None:
        return ()
    return (contact_links(body, poses, options.collisions, options.margin),)


class Plausibility(NamedTuple):
    """What is not plausible about a pose."""

    beyond: Float[Array, " joint"]  # radians beyond the joint's limits
    depth: Float[Array, " limb"]  # how much deeper the limb is in another one than in the rest pose, metres


def check(body: Body, poses: Poses) -> Plausibility:
    """Joints beyond their limits and limbs that pass through each other, of one pose."""
    found = contacts(body, poses)
    deep = passing_through(body, found, jnp.zeros((), body.sizes.dtype))
    depth = jnp.zeros_like(body.sizes[:, 0]).at[found.first].max(deep).at[found.second].max(deep)
    parents, children = jnp.array(body.topology.parents, int), jnp.array(body.topology.children, int)
    there = body.present[parents] & body.present[children]
    return Plausibility(jnp.where(there, joint_angles(body, poses).beyond, 0.0), depth)
