"""The body: a tree of degenerated cylinders held together by elastic bands (Knoop 2007, sec. 4).

Limb frame: origin in the centre of the bottom ellipse, +z along the cylinder to the top ellipse, x and y along the
ellipses' axes. Body frame: the frame in which the rest pose is given, z up, x forward, y left, origin on the floor.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rigid import AnyArray, Poses, apply, on_device, on_host, rotate

if TYPE_CHECKING:
    Leaf = Array
else:
    Leaf = AnyArray  # on the host NumPy's, which no program ever sees


class Topology(NamedTuple):
    """The part of a body that a compiled program depends on: names and the tree of limbs. Hashable, never traced."""

    limbs: tuple[str, ...]  # limb 0 is the root
    joints: tuple[str, ...]  # joint names (H-Anim for people)
    parents: tuple[int, ...]  # [joint] limb index
    children: tuple[int, ...]  # [joint] limb index; every limb but the root is the child of exactly one joint
    centres: tuple[str, ...]  # names of the joint centres that tracks report
    centre_limbs: tuple[int, ...]  # [centre] limb that carries it
    sites: tuple[str, ...]  # named feature points on the body
    site_limbs: tuple[int, ...]  # [site]
    segments: tuple[tuple[str, str, str], ...]  # (segment, end, end): reported lengths between joints or centres
    held: tuple[int, ...] = ()  # limbs that are things: they keep their size when the body is scaled


class Mode(NamedTuple):
    """One variation among bodies of one scale: the changes by one standard deviation."""

    name: str
    # parameters as a fit names them (fitting.parameters) and by how much: logarithms, or shares of the scale of anchors
    changes: tuple[tuple[str, float], ...]


class Body(eqx.Module):
    """Sizes, rest pose, joints and named points of an articulated body. Arrays are traced, `topology` is static."""

    sizes: Float[Leaf, "limb 5"]  # a0, b0 (bottom semi-axes along x, y), a1, b1 (top), length; metres
    rest: Poses  # [limb] T_body_limb in the rest pose
    parent_anchor: Poses  # [joint] T_parent_joint: where the joint's ellipse sits on the parent limb
    child_anchor: Poses  # [joint] T_child_joint
    axes: Float[Leaf, "joint 2"]  # semi-axes of the joint's ellipse along the joint frame's x and y, metres
    weights: Float[Leaf, " joint"]  # stiffness relative to the measured weight of a limb, times the ratio r
    centres: Float[Leaf, "centre 3"]  # joint centres in the frame of their limb, metres
    sites: Float[Leaf, "site 3"]  # feature points in the frame of their limb, metres
    scale: Float[Leaf, ""]  # the length that all others are multiples of (a person's stature), metres
    limits: Float[Leaf, "joint 3 2"]  # least and greatest swing about x and y, and twist; radians, infinite: none
    presence: Float[Leaf, " limb"]  # 1: the limb is present, 0: it is not; a float, for jax.grad
    topology: Topology = eqx.field(static=True)  # names and connections of limbs, joints, centres and sites
    name: str = eqx.field(static=True)  # of the body
    scale_name: str = eqx.field(static=True)  # name of `scale`, "stature" for people
    modes: tuple[Mode, ...] = eqx.field(static=True, default=())  # statistical shape, most important first; may be none

    @property
    def limb_count(self) -> int:
        return len(self.topology.limbs)

    @property
    def present(self) -> Bool[Leaf, " limb"]:
        """False: the limb is not there at the moment, nothing is matched to it."""
        return self.presence > 0.5

    def __repr__(self) -> str:
        concrete = isinstance(self.scale, np.ndarray | np.generic | jax.Array) and not isinstance(
            self.scale, jax.core.Tracer
        )
        size = f"{float(self.scale):.3f} m" if concrete and np.size(self.scale) == 1 else "being computed"
        return (
            f"Body({self.name}: {self.limb_count} limbs, {len(self.topology.joints)} joints, {self.scale_name} {size})"
        )


class LinkTables(NamedTuple):
    """The part of the normal equations of linked pairs that does not depend on poses; points as (turn, shift,
    place)."""

    first: Float[Array, "link 7 7"]  # sum of w a^T a, a how the first limb's points move with its twist
    second: Float[Array, "link 7 7"]
    between: Float[Array, "link 3 3 7 7"]  # for each entry of the turn from the second limb's frame to the first's


class Links(NamedTuple):
    """Artificial point pairs between limbs: a point of one limb and a point of another that should coincide."""

    first: Int[Array, " link"]  # limb
    second: Int[Array, " link"]  # limb
    first_points: Float[Array, "link pair 3"]  # in the first limb's frame
    second_points: Float[Array, "link pair 3"]  # in the second limb's frame
    weights: Float[Array, "link pair"]  # 0: unused
    tables: LinkTables | None = None  # see kernels.gauss_newton.link_tables; None: made where they are needed


def scaled(body: Body, scale: Float[AnyArray, ""] | float) -> Body:
    """The same body with another `scale` (stature for people): every length and offset in proportion, except held
    things."""
    body, scale = on_host((body, scale))
    dtype, t = body.sizes.dtype, body.topology
    here = np if isinstance(body.sizes, np.ndarray) and not isinstance(scale, jax.Array) else jnp
    factor = here.asarray(scale, dtype) / here.asarray(body.scale, dtype)
    own = here.where(np.isin(np.arange(body.limb_count), t.held), here.ones((), dtype), factor)
    of = lambda limbs: own[np.array(limbs, int)][:, None]  # noqa: E731
    lengths = lambda b: (  # noqa: E731
        b.sizes, b.rest.translation, b.parent_anchor.translation, b.child_anchor.translation, b.axes, b.centres,
        b.sites, b.scale,
    )  # fmt: skip
    factors = (own[:, None], factor, of(t.parents), of(t.children), of(t.children), of(t.centre_limbs),
               of(t.site_limbs), factor)  # fmt: skip
    return on_device(eqx.tree_at(lengths, body, tuple(x * f for x, f in zip(lengths(body), factors))))


def without_side(name: str) -> str:
    """A limb's or joint's name without l_ or r_."""
    return name[2:] if name[:2] in ("l_", "r_") else name


def tree_levels(topology: Topology) -> list[list[int]]:
    """Joints by their distance from the root, limb 0, in the tree of limbs: those next to it first."""
    done, levels = {0}, []
    while len(done) <= len(topology.joints):
        ready = [j for j, (p, c) in enumerate(zip(topology.parents, topology.children)) if p in done and c not in done]
        levels.append(ready)
        done |= {topology.children[j] for j in ready}
    return levels


def tree_order(topology: Topology) -> list[int]:
    """Joints in an order in which a joint's parent limb comes before it."""
    return [joint for level in tree_levels(topology) for joint in level]


def with_rest_from_joints(body: Body) -> Body:
    """The body with every limb but the root moved in the rest pose to where its joint holds it, without rotation."""
    body = on_host(body)
    return on_device(eqx.tree_at(lambda b: b.rest.translation, body, places_from_joints(body, body.rest)))


def places_from_joints(body: Body, poses: Poses) -> Float[Any, "*frame limb 3"]:
    """Places of all limbs of a body on the host by their joints, with the rotations of `poses`; the root stays."""
    t, turn = body.topology, poses.rotation
    ends = [rotate(turn[..., np.array(limbs, int), :], anchor.translation) for limbs, anchor in (
        (t.parents, body.parent_anchor), (t.children, body.child_anchor))]  # fmt: skip
    at = {0: poses.translation[..., 0, :]}
    for j in tree_order(t):
        at[t.children[j]] = at[t.parents[j]] + ends[0][..., j, :] - ends[1][..., j, :]
    return (np if isinstance(turn, np.ndarray) else jnp).stack([at[limb] for limb in range(body.limb_count)], -2)


def with_proportions(body: Body, lengths: Mapping[str, float], girth: float = 1.0) -> Body:
    """The body with the named limbs longer by a factor (their children move along) and all radii by `girth`. The rest
    pose follows from the joints; the root stays. Raises ValueError for an unknown limb."""
    body = on_host(body)
    t = body.topology
    if unknown := set(lengths) - set(t.limbs):
        raise ValueError(f"no limb named {sorted(unknown)}; the body has {list(t.limbs)}")
    factor = np.array([lengths.get(name, 1.0) for name in t.limbs], np.float32)
    along = np.concatenate([np.ones((len(factor), 2), np.float32), factor[:, None]], 1)
    at = lambda limbs: along[np.array(limbs, int)]  # noqa: E731
    size_factor = np.concatenate([np.full((len(factor), 4), girth, np.float32), factor[:, None]], 1)
    leaves = lambda b: (b.sizes, b.parent_anchor.translation, b.child_anchor.translation, b.centres, b.sites)  # noqa: E731
    factors = (size_factor, at(t.parents), at(t.children), at(t.centre_limbs), at(t.site_limbs))
    body = eqx.tree_at(leaves, body, tuple(x * f for x, f in zip(leaves(body), factors)))
    return with_rest_from_joints(body)


def band_mask(axes: Float[Array, "joint 2"]) -> Bool[Array, "joint band"]:
    """Which of the four bands (+x, -x, +y, -y) a joint has: one, two or four (2007, sec. 4.2)."""
    has_x, has_y = axes[:, 0] > 0, axes[:, 1] > 0
    # no axis: the first band alone, it then sits in the middle
    return jnp.stack([has_x | ~has_y, has_x, has_y, has_y], -1)


def bands(body: Body) -> Links:
    """Elastic bands of all joints, parent first: universal (both axes zero), hinge (one zero) and elliptic joints are
    one formula. A joint's weights sum to its weight, or to zero where a limb of it is absent."""
    zero = jnp.zeros_like(body.axes[:, 0])
    a, b = body.axes[:, 0], body.axes[:, 1]
    ends = jnp.stack(
        [jnp.stack(p, -1) for p in ([a, zero, zero], [-a, zero, zero], [zero, b, zero], [zero, -b, zero])], 1
    )
    parents, children = jnp.array(body.topology.parents, int), jnp.array(body.topology.children, int)
    mask = band_mask(body.axes).astype(body.axes.dtype)
    weight = body.weights * (body.present[parents] & body.present[children])
    weights = weight[:, None] * mask / mask.sum(-1, keepdims=True)
    return Links(
        parents, children, apply(body.parent_anchor[:, None], ends), apply(body.child_anchor[:, None], ends), weights
    )


def joint_centres(body: Body, poses: Poses) -> Float[Any, "centre 3"]:
    """Joint centres in tracks, in the frame of the poses."""
    return apply(poses[np.array(body.topology.centre_limbs, int)], body.centres)


def site_points(body: Body, poses: Poses) -> Float[Array, "site 3"]:
    """Feature points in the frame of the poses."""
    return apply(poses[jnp.array(body.topology.site_limbs, int)], body.sites)


def segment_lengths(body: Body) -> dict[str, float]:
    """Length of each named segment in the rest pose, metres; left and right averaged.

    Between joints of the model where the ends are joints: reported joint centres are shifted to where people's lie when
    the model fits their surface, which is right for places and not for lengths.
    """
    body = on_host(body)
    ends = dict(zip(body.topology.centres, joint_centres(body, body.rest)))
    parents = np.array(body.topology.parents, int)
    ends |= dict(zip(body.topology.joints, apply(body.rest[parents], body.parent_anchor.translation)))
    found: dict[str, list[float]] = {}
    for name, start, end in body.topology.segments:
        length = np.sqrt(np.sum((ends[start] - ends[end]) ** 2))
        found.setdefault(name, []).append(float(length))
    return {name: sum(values) / len(values) for name, values in found.items()}


def rest_box(body: Body) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Lowest and highest coordinates of all limbs' end ellipses in the rest pose, metres."""
    turn = Rotation.from_quat(np.asarray(body.rest.rotation), scalar_first=True).as_matrix()
    sizes = np.asarray(body.sizes, np.float64)
    bottom = np.asarray(body.rest.translation, np.float64)
    ends = np.stack([bottom, bottom + sizes[:, 4:] * turn[:, :, 2]])
    reach = np.stack(
        [np.hypot(sizes[:, k, None] * turn[:, :, 0], sizes[:, k + 1, None] * turn[:, :, 1]) for k in (0, 2)]
    )
    return np.min(ends - reach, (0, 1)), np.max(ends + reach, (0, 1))


def rest_height(body: Body) -> float:
    """Height of the body above the floor in its rest pose, metres: its stature, or the top of its highest limb."""
    return float(body.scale) if body.scale_name == "stature" else float(rest_box(body)[1][2])
