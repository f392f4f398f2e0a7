"""One frame's points and how they are matched to limbs: the types that the kernels of matching share."""

import equinox as eqx
from jaxtyping import Array, Float, Int

from voodoo_jax.kernels.bounding_boxes import Overlap


class Points(eqx.Module):
    """One frame's free points (or a batch of frames), padded. A padded entry has weight zero and any finite place."""

    xyz: Float[Array, "*frame point 3"]  # world frame, metres
    weight: Float[Array, "*frame point"]  # 0 for padding; 1 for a depth camera's point (2007, sec. 6)
    sensor: Int[Array, "*frame point"]  # which sensor saw it
    origins: Float[Array, "*frame sensor 3"]  # where the sensors stand, world frame, metres
    limb: Int[Array, "*frame point"] | None = None  # limb the point is known to be on, ON_BODY, FREE; None: all free
    doubt: Float[Array, "*frame"] | None = None  # variance of the measurements over the usual one; None: 1


Components = tuple[Float[Array, " point"], Float[Array, " point"], Float[Array, " point"]]
FREE, ON_BODY = -1, -2  # kinds of points (2007, sec. 5.1): may be anything; on the body, on which limb is not known


class Sampling(eqx.Module):
    """How many of a limb's points are used (2007, sec. 5.2, point number reduction)."""

    factor: Float[Array, ""]  # share of the limb's points
    least: Int[Array, ""]  # a limb with fewer points keeps all
    most: Int[Array, ""]


class MatchOptions(eqx.Module):
    """Parameters of the matching; numbers are traced, so new values compile nothing."""

    body_enlarge: Float[Array, ""]  # metres
    limb_enlarge: Float[Array, ""]  # metres
    max_distance: Float[Array, ""]  # metres
    robust_scale: Float[Array, ""]  # metres; infinite: every pair counts fully, as in the papers
    sampling: Sampling | None  # None: all points are used
    softness: Float[Array, ""]  # metres, of the overlap rule "soft": see kernels.bounding_boxes.shares
    overlap: Overlap = eqx.field(static=True)
    near_side: bool = eqx.field(static=True)
    refine: int = eqx.field(static=True)
    caps: bool = eqx.field(static=True, default=True)  # False: limbs are open tubes, see closest_point


def components(xyz: Float[Array, "point 3"]) -> Components:
    """x, y and z: everything about points is computed by component (docs/numerics.md#components)."""
    return xyz[:, 0], xyz[:, 1], xyz[:, 2]
