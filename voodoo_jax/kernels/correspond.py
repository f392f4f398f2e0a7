"""From points to weighted correspondences of all limbs, and to their moments (Knoop 2007, sec. 5.2)."""

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


class MatchOptions(eqx.Module):
    """Parameters of the matching; numbers are traced so that changing one compiles nothing anew."""

    body_enlarge: Float[Array, ""]  # metres
    limb_enlarge: Float[Array, ""]  # metres
    max_distance: Float[Array, ""]  # metres
    robust_scale: Float[Array, ""]  # metres; infinite: every pair counts fully, as in the papers
    overlap: Overlap = eqx.field(static=True)
    near_side: bool = eqx.field(static=True)
    refine: int = eqx.field(static=True)


class Match(NamedTuple):
    """Correspondences of all limbs and points, in the frames of the limbs."""

    weight: Float[Array, "limb point"]  # 0: no pair
    distance: Float[Array, "limb point"]  # between the pair's points, metres
    model: tuple[Float[Array, "limb point"], Float[Array, "limb point"], Float[Array, "limb point"]]
    data: tuple[Float[Array, "limb point"], Float[Array, "limb point"], Float[Array, "limb point"]]


def match(
    sizes: Float[Array, "limb 5"],
    poses: Poses,
    points: Points,
    adjacent: Bool[Array, "limb limb"],
    options: MatchOptions,
) -> Match:
    """Gates, overlap rule, closest points, maximum distance and robust weights for one frame."""
    low, high = body_box(sizes, poses, options.body_enlarge)
    near_body = in_box(low, high, points.xyz) & (points.weight > 0)
    x, y, z = points.xyz[:, 0], points.xyz[:, 1], points.xyz[:, 2]

    def one_limb(size, pose):
        w, i, j, k = (pose.rotation[n] for n in range(4))
        dx, dy, dz = x - pose.translation[0], y - pose.translation[1], z - pose.translation[2]
        # rows of the inverse rotation, by component
        px = (1 - 2 * (j * j + k * k)) * dx + 2 * (i * j + w * k) * dy + 2 * (i * k - w * j) * dz
        py = 2 * (i * j - w * k) * dx + (1 - 2 * (i * i + k * k)) * dy + 2 * (j * k + w * i) * dz
        pz = 2 * (i * k + w * j) * dx + 2 * (j * k - w * i) * dy + (1 - 2 * (i * i + j * j)) * dz
        surface = closest_point(size, px, py, pz, options.refine)
        signed = surface.distance
        if options.near_side:
            sensors = unrotate(pose.rotation[None], points.origins - pose.translation)
            surface = near_side(size, px, py, surface, sensors[points.sensor, 0], sensors[points.sensor, 1])
        box = in_limb_box(size, px, py, pz, options.limb_enlarge)
        return surface.x, surface.y, surface.z, signed, box, px, py, pz

    cx, cy, cz, signed, box, px, py, pz = jax.vmap(one_limb)(sizes, poses)
    candidate = box & near_body[None, :]
    chosen = resolve_overlap(options.overlap, candidate, signed, adjacent)
    d2 = (px - cx) ** 2 + (py - cy) ** 2 + (pz - cz) ** 2
    s2 = options.robust_scale**2
    # Geman-McClure; written as a ratio so that an infinite scale gives exactly one
    robust = (1 / (1 + d2 / s2)) ** 2
    keep = chosen & (d2 <= options.max_distance**2)
    weight = jnp.where(keep, robust * points.weight[None, :], 0.0)
    return Match(weight, jnp.sqrt(d2 + 1e-12), (cx, cy, cz), (px, py, pz))


def moments(found: Match) -> Float[Array, "limb 4 4"]:
    """Sum over points of w [1, c] [1, p]^T for every limb, both points in the limb frame."""
    w = found.weight
    rows = []
    for c in (None, *found.model):
        wc = w if c is None else w * c
        rows.append(jnp.stack([jnp.sum(wc if p is None else wc * p, -1) for p in (None, *found.data)], -1))
    return jnp.stack(rows, -2)


def second_moments(found: Match) -> Float[Array, "limb 3 3"]:
    """Sum over points of w c c^T for every limb, limb frame."""
    rows = [jnp.stack([jnp.sum(found.weight * a * b, -1) for b in found.model], -1) for a in found.model]
    return jnp.stack(rows, -2)
