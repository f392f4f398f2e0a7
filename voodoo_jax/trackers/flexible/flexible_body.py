"""The flexible body: 16 point masses and 24 springs (Hecht et al. 2009, sec. II), made from a body's joint centres.

The paper lists the springs only in a figure. Four limbs of three points, head and neck are from its text; the flat
torso of two parts completes them to exactly 24 springs.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.model.body_file import load_on_host
from voodoo_jax.trackers.base import Unsuitable

POINTS = (
    "head", "neck", "l_shoulder", "l_elbow", "l_wrist", "r_shoulder", "r_elbow", "r_wrist", "l_waist", "r_waist",
    "l_hip", "l_knee", "l_ankle", "r_hip", "r_knee", "r_ankle",
)  # fmt: skip
HEAD, NECK = 0, 1  # the paper's points, as in the tables below
# index tables are always int32: in float64 mode JAX once failed on NumPy's int64 indices
LIMBS = np.array(
    [[2, 3, 4], [5, 6, 7], [10, 11, 12], [13, 14, 15]], np.int32
)  # the paper's four filters: left and right arm, left and right leg
SIDE = np.array([1.0, -1.0, 1.0, -1.0])  # +1: left, in the order of the paper's filters above
IS_ARM = np.array([True, True, False, False])
OTHER_SIDE = np.array(
    [0, 1, 5, 6, 7, 2, 3, 4, 9, 8, 13, 14, 15, 10, 11, 12], np.int32
)  # the mirrored point of each of the paper's points
UPPER = (2, 5, 8, 9)  # corners of the paper's upper torso part: left and right shoulder, left and right waist
LOWER = (8, 9, 10, 13)  # of the paper's lower torso part: left and right waist, left and right hip
# points that a spring joins, and its stiffness (share of its error that one relaxation removes). The stiffnesses were
# found by hand: bones keep their length, shoulders have play, sides and diagonals let the torso bow
SPRINGS = (
    (2, 3, 1.0), (3, 4, 1.0), (5, 6, 1.0), (6, 7, 1.0), (10, 11, 1.0), (11, 12, 1.0), (13, 14, 1.0), (14, 15, 1.0),
    (0, 1, 0.6), (0, 2, 0.3), (0, 5, 0.3), (1, 2, 0.6), (1, 5, 0.6), (2, 5, 0.6),
    (2, 8, 0.9), (5, 9, 0.9), (2, 9, 0.6), (5, 8, 0.6), (8, 9, 0.8),
    (8, 10, 0.9), (9, 13, 0.9), (8, 13, 0.6), (9, 10, 0.6), (10, 13, 0.8),
)  # fmt: skip
# name of a point -> joint centre in tracks
CENTRES = {
    "head": "skullbase", "neck": "vc7", "l_shoulder": "l_shoulder", "l_elbow": "l_elbow", "l_wrist": "l_radiocarpal",
    "r_shoulder": "r_shoulder", "r_elbow": "r_elbow", "r_wrist": "r_radiocarpal", "l_hip": "l_hip", "l_knee": "l_knee",
    "l_ankle": "l_talocrural", "r_hip": "r_hip", "r_knee": "r_knee", "r_ankle": "r_talocrural",
}  # fmt: skip
# the remaining points, shares of stature: left, up (measured on rendered people at rest)
_WAIST = (0.078, 0.650)
# radii at both ends of the two cylinders of an arm and a leg, and of hand and foot, shares of stature: measured on the
# built-in body
_ARM_RADII, _LEG_RADII = (
    ((0.029, 0.023), (0.024, 0.016), (0.018, 0.012)),
    ((0.052, 0.037), (0.035, 0.023), (0.02, 0.02)),
)
_HAND, _FOOT = 0.095, 0.11  # lengths beyond wrist and ankle, shares of stature, measured on rendered people
_MASS_TORSO, _MASS_LIMB = 4.0, 1.0  # relative; the paper gives only heavier and lighter, the numbers are set by hand


LIMB_NAMES = tuple(
    f"{side}_{part}"
    for parts in (("upper_arm", "forearm", "hand"), ("thigh", "shank", "foot"))
    for side in "lr"
    for part in parts
)  # limbs of the cylinders of the paper's filters


class FlexibleBody(eqx.Module):
    """Point masses, springs and cylinders of one person. All arrays are traced, so each may have gradients."""

    rest: Float[Array, "16 3"]  # metres; body frame: x forward, y left, z up, origin on the floor
    lengths: Float[Array, " 24"]  # of the springs at rest, metres
    stiffness: Float[Array, " 24"]  # share of a spring's error that one relaxation removes, 0..1
    masses: Float[Array, " 16"]  # relative; the head's is infinite
    radii: Float[Array, "4 3 2"]  # at both ends of each limb's two cylinders and its hand or foot, metres
    tips: Float[Array, " 4"]  # lengths of hands and feet beyond wrist and ankle, metres
    torso: Float[Array, "2"]  # half depth of the torso; radius of its rounded edge, metres
    skull: Float[Array, "2"]  # radius of the head; height of its top above the head point, metres
    stature: Float[Array, ""]  # metres
    covered: Float[Array, " part"]  # how unlikely skin is on each part, 0..1, see cylinders


class Colouring(NamedTuple):
    """Springs in groups without common points, so that a group is relaxed at once (Gauss-Seidel by groups)."""

    partner: np.ndarray  # [group, point] the point at the other end of its spring; itself without a spring in the group
    spring: np.ndarray  # [group, point] number of that spring; 0 without one


def _group_springs() -> Colouring:
    groups: list[list[int]] = []
    for number, (i, j, _) in enumerate(SPRINGS):
        for group in groups:
            if not {i, j} & {p for s in group for p in SPRINGS[s][:2]}:
                group.append(number)
                break
        else:
            groups.append([number])
    partner, spring = np.tile(np.arange(16, dtype=np.int32), (len(groups), 1)), np.zeros((len(groups), 16), np.int32)
    for g, group in enumerate(groups):
        for number in group:
            i, j, _ = SPRINGS[number]
            partner[g, [i, j]], spring[g, [i, j]] = (j, i), number
    return Colouring(partner, spring)


COLOURING = _group_springs()
ENDS = np.array([s[:2] for s in SPRINGS], np.int32)  # points of the paper's 24 springs


def rest_points(body: Body) -> Float[Any, "16 3"]:
    """The points at rest, metres in the body frame. Differentiable. Raises Unsuitable for a body without a person's
    joint centres."""
    names = body.topology.centres
    if missing := [name for name in CENTRES.values() if name not in names]:
        raise Unsuitable(
            f"the flexible tracker follows people: the body '{body.name}' has no joint centre {', '.join(missing)}; "
            "use --tracker icp"
        )
    here, centres = _select_module(joint_centres(body, body.rest))
    scale = body.scale if here is jnp else float(body.scale)
    waist = lambda name: here.asarray([0.0, _WAIST[0] * (1 if name[0] == "l" else -1), _WAIST[1]]) * scale  # noqa: E731
    found = [centres[names.index(CENTRES[n])] if n in CENTRES else waist(n) for n in POINTS]
    # all points in one plane: tracks add the offsets of the reported centres
    return here.stack(found) * np.array([0.0, 1.0, 1.0]) + 0.0  # + 0.0 removes negative zeros


def _select_module(value: Any) -> tuple[Any, Any]:
    """The array module for a value, and the value: jax.numpy if it is traced, else NumPy in float64 (not compiled)."""
    return (jnp, value) if isinstance(value, Tracer) else (np, np.asarray(value, np.float64))


def flexible_body(body: Body, stature: Float[Any, ""] | float) -> FlexibleBody:
    """The flexible body of a person of this stature (metres) with the proportions and girths of `body`. Differentiable.
    Raises Unsuitable."""
    here, rest = _select_module(rest_points(body))
    rest = (rest * (stature / (body.scale if here is jnp else float(body.scale)))).astype(np.float32)
    # rest lengths with arms held slightly out, as people stand (in Hecht's relaxed state they hang straight down)
    ends = rest[ENDS]
    masses = np.full(16, _MASS_LIMB, np.float32)
    masses[[1, 2, 5, 8, 9, 10, 13]] = _MASS_TORSO
    masses[HEAD] = np.inf
    thick, long = zip(*(_compare_to_human(body, limb) for limb in LIMB_NAMES))
    radii = np.array([_ARM_RADII] * 2 + [_LEG_RADII] * 2, np.float32) * here.stack(thick).reshape(4, 3, 2)
    tips = np.array([_HAND, _HAND, _FOOT, _FOOT], np.float32) * here.stack(long[2::3])
    trunk, skull = (_compare_to_human(body, limb)[0].mean() for limb in ("chest", "head"))
    return FlexibleBody(
        rest=jnp.asarray(rest),
        lengths=jnp.asarray(here.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)),
        stiffness=jnp.asarray(np.array([s[2] for s in SPRINGS], np.float32)),
        masses=jnp.asarray(masses),
        radii=jnp.asarray(radii * stature, jnp.float32),
        tips=jnp.asarray(tips * stature, jnp.float32),
        torso=jnp.asarray(np.array([0.055, 0.053], np.float32) * (trunk * stature), jnp.float32),
        skull=jnp.asarray(np.array([0.052, 0.045], np.float32) * (skull * stature), jnp.float32),
        stature=jnp.asarray(stature, jnp.float32),
        covered=jnp.asarray(np.repeat(np.array([0, 1, 0, 1], np.float32), [6, 6, 1, 2])),  # legs and trunk
    )


def _compare_to_human(body: Body, limb: str) -> tuple[Float[Any, "2"], Float[Any, ""]]:
    """Thickness of a limb at both ends, and its length, relative to the built-in human of the same stature, on which
    the radii of this file were measured; 1 for a limb that the body does not have."""
    usual = load_on_host("human")
    here, sizes = _select_module(body.sizes)
    if limb not in body.topology.limbs:
        return here.ones(2, np.float32), here.ones((), np.float32)
    own = sizes[body.topology.limbs.index(limb)] / (body.scale if here is jnp else float(body.scale))
    usual = np.asarray(usual.sizes, np.float64)[usual.topology.limbs.index(limb)] / float(usual.scale)
    share = (own / usual.astype(own.dtype)).astype(np.float32)
    thick = here.stack([own[0] + own[1], own[2] + own[3]]) / np.array([usual[0] + usual[1], usual[2] + usual[3]])
    return thick.astype(np.float32), share[4]


def bone_lengths(body: FlexibleBody) -> Float[Array, "4 2"]:
    """Lengths of each limb's two bones, metres."""
    return body.lengths[:8].reshape(4, 2)
