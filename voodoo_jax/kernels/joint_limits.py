"""Plausibility: joints beyond their limits, limbs that pass through each other (named in Knoop 2006, sec. IV-B.7).

Both are found from a pose alone, and corrected by artificial correspondences of the same kind as elastic bands (2007,
sec. 8: "angular limits ... maintained valid by artificial point correspondences").
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from voodoo_jax.geometry.rigid import Poses, apply, quat_conjugate, quat_exp, quat_log, quat_multiply, rotate
from voodoo_jax.kernels.self_collision import contact_links, contacts, passing_through
from voodoo_jax.model.body import Body, Links, bands


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
