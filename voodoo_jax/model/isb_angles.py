"""Joint angles of people by the recommendations of the ISB (Wu 2002, 2005), of other bodies by their joints' frames.

Wu et al. 2002, J. Biomech. 35: hip, ankle, spine. Wu et al. 2005, J. Biomech. 38: shoulder, elbow, wrist. Knee: Grood
and Suntay 1983, as the ISB's joint coordinate systems are. Axes of a segment: X forwards, Y upwards, Z to the right;
they are those of the body's rest pose, in which a person stands upright with hanging arms and palms at the thighs. So
all angles are 0 in the rest pose but pronation: ISB counts it from palms forwards, and it is 90 degrees there. Left
limbs are mirrored first, as Wu 2005 says: an angle means the same on both sides.

| joint | order | first | second | third |
|---|---|---|---|---|
| hip | Z X Y | flexion | adduction | internal rotation |
| knee | Z X Y | flexion | adduction (varus) | internal rotation of the shank |
| ankle | Z X Y | dorsiflexion | inversion | internal rotation of the foot |
| shoulder | Y X Y | plane of elevation: 0 sideways, 90 degrees forwards | elevation | internal rotation |
| elbow | Z X Y | flexion | carrying angle | pronation |
| wrist | Z X Y | flexion | ulnar deviation | pronation of the hand |
| trunk (thorax in the pelvis), neck | Z X Y | flexion | bending to the right | rotation to the left |

The shoulder's are those of the humerus in the thorax. Flexions of knee, trunk and neck are turns about -Z, elevation is
one about -X: what is named is positive. Host side.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from voodoo_jax.config.toml import nearest
from voodoo_jax.geometry.rotations import rotations
from voodoo_jax.model.body import Body

# columns: X, Y, Z of a segment in the body frame of the rest pose (x forwards, y to the left, z up)
UPRIGHT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
# of a right forearm and hand, whose palm (X) faces the thigh and whose thumb (Z) is in front
PALM_IN = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
LOCKED = np.radians(2)  # so near to gimbal lock the first and third angle are not told apart
STEP = 1e-4  # radians, of the finite differences by which covariances are carried over


class Convention(NamedTuple):
    """Conventions for the angles of one joint of a person."""

    joint: str  # with l_ or r_ before it where `paired`
    parents: tuple[str, ...]  # limb names, the first that the body has
    child: str
    names: tuple[str, str, str]
    paired: bool = True
    signs: tuple[int, int, int] = (1, 1, 1)
    parent_axes: np.ndarray = UPRIGHT
    child_axes: np.ndarray = UPRIGHT
    order: str = "ZXY"


SPINE = ("flexion", "bending", "rotation")
CONVENTIONS = (
    Convention("hip", ("pelvis", "torso"), "thigh", ("flexion", "adduction", "rotation")),
    Convention("knee", ("thigh",), "shank", ("flexion", "adduction", "rotation"), signs=(-1, 1, 1)),
    Convention("ankle", ("shank",), "foot", ("dorsiflexion", "inversion", "rotation")),
    Convention("shoulder", ("chest", "torso"), "upper_arm", ("plane", "elevation", "rotation"), order="YXY"),
    Convention("elbow", ("upper_arm",), "forearm", ("flexion", "carrying", "pronation"), child_axes=PALM_IN),
    Convention("wrist", ("forearm",), "hand", ("flexion", "deviation", "pronation"), parent_axes=PALM_IN,
               child_axes=PALM_IN),
    Convention("trunk", ("pelvis",), "chest", SPINE, paired=False, signs=(-1, 1, 1)),
    Convention("neck", ("chest", "torso"), "head", SPINE, paired=False, signs=(-1, 1, 1)),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Angles:
    """Three angles of each joint over time, radians; NaN where a limb of the joint was not seen or has no pose.

    `angles["l_knee_flexion"]` is one of them over time: [frame].
    """

    joints: tuple[str, ...]
    names: tuple[tuple[str, str, str], ...]  # [joint] what its three angles are called
    values: Float[np.ndarray, "frame joint 3"]  # radians, without jumps of a full turn
    # of a joint's three angles, square radians; None: the tracks have no covariance of limbs
    covariance: Float[np.ndarray, "frame joint 3 3"] | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all angles: `<joint>_<angle>`."""
        return tuple(f"{joint}_{name}" for joint, names in zip(self.joints, self.names) for name in names)

    @property
    def table(self) -> Float[np.ndarray, "frame column"]:
        """All angles in the order of `columns`, radians."""
        return self.values.reshape(len(self.values), -1)

    @property
    def deviation(self) -> Float[np.ndarray, "frame column"]:
        """Standard deviations in the order of `columns`, radians; NaN where unknown."""
        if self.covariance is None:
            return np.full_like(self.table, np.nan)
        return np.sqrt(np.einsum("fjaa->fja", self.covariance)).reshape(len(self.values), -1)

    def __getitem__(self, name: str) -> Float[np.ndarray, " frame"]:
        if name not in self.columns:
            raise KeyError(f"no angle '{name}'{nearest(name, self.columns)}")
        return self.table[:, self.columns.index(name)]

    def __repr__(self) -> str:
        return f"Angles({len(self.values)} frames of {', '.join(self.joints)}; radians)"


def joint_angles(
    body: Body,
    rotation: Float[np.ndarray, "frame limb 4"],
    seen: Bool[np.ndarray, "frame limb"],
    covariance: Float[np.ndarray, "frame limb 6 6"] | None = None,
    conventions: tuple[Convention, ...] = CONVENTIONS,
) -> Angles:
    """Angles of all joints: by ISB for a body with limbs of a person; else, for each joint of the body file, swing
    about x and y and twist about z of the joint's frame, as `swing_x`, `swing_y` and `twist` of its limits are counted.

    **Arguments:** `rotation` T_fixed_limb, unit quaternions wxyz; `seen` what was measured: angles of other limbs are
    NaN; `covariance` of limb poses, turn (radians) and shift in the limb's frame; `conventions` how angles
    of people are counted.
    """
    found = _of_person(body, conventions) or _of_joint_frames(body)
    values, spread = [], []
    for f in found:
        pair = [f.parent, f.child]
        there = np.asarray(seen[:, pair].all(1) & np.isfinite(rotation[:, pair]).all((1, 2)))
        parent, child = rotations(rotation[:, f.parent]), rotations(rotation[:, f.child])
        values.append(without_jumps(np.where(there[:, None], f.read(parent, child), np.nan)))
        if covariance is not None:
            turns = covariance[:, pair, :3, :3].astype(float)
            spread.append(np.where(there[:, None, None], _carried(f.read, parent, child, turns), np.nan))
    frames, count = len(rotation), len(found)
    return Angles(
        tuple(f.joint for f in found),
        tuple(f.names for f in found),
        np.stack(values, 1) if count else np.zeros((frames, 0, 3)),
        None if covariance is None else np.stack(spread, 1) if count else np.zeros((frames, 0, 3, 3)),
    )


def cardan_zxy(turn: Float[np.ndarray, "frame 3 3"]) -> Float[np.ndarray, "frame 3"]:
    """Angles about Z, then X, then Y of the turned frame, radians; the outer ones NaN at gimbal lock."""
    second = np.arcsin(np.clip(turn[:, 2, 1], -1, 1))
    first, third = np.arctan2(-turn[:, 0, 1], turn[:, 1, 1]), np.arctan2(-turn[:, 2, 0], turn[:, 2, 2])
    return _open_at_lock(first, second, third, np.cos(second))


def euler_yxy(turn: Float[np.ndarray, "frame 3 3"]) -> Float[np.ndarray, "frame 3"]:
    """Plane, elevation (0 to pi, about -X) and rotation: Y, then X, then Y; the outer ones NaN at gimbal lock."""
    aside = np.hypot(turn[:, 0, 1], turn[:, 2, 1])
    first, third = np.arctan2(-turn[:, 0, 1], -turn[:, 2, 1]), np.arctan2(-turn[:, 1, 0], turn[:, 1, 2])
    return _open_at_lock(first, np.arctan2(aside, turn[:, 1, 1]), third, aside)


def _open_at_lock(first: np.ndarray, second: np.ndarray, third: np.ndarray, away: np.ndarray) -> np.ndarray:
    free = np.where(away > np.sin(LOCKED), 1.0, np.nan)
    return np.stack([first * free, second, third * free], -1)


class _Found(NamedTuple):
    joint: str
    names: tuple[str, str, str]
    parent: int
    child: int
    read: Callable[[Rotation, Rotation], np.ndarray]  # angles of limb rotations


def _of_person(body: Body, conventions: tuple[Convention, ...]) -> list[_Found]:
    limbs, rest = body.topology.limbs, Rotation.from_quat(np.asarray(body.rest.rotation, float), scalar_first=True)
    found = []
    for how in conventions:
        for side in ("l_", "r_") if how.paired else ("",):
            own = [name for name in (*how.parents, *(side + p for p in how.parents)) if name in limbs]
            if not own or side + how.child not in limbs:
                continue
            parent, child = limbs.index(own[0]), limbs.index(side + how.child)
            read = _reader(how, side == "l_", rest[parent], rest[child])
            found.append(_Found(side + how.joint, how.names, parent, child, read))
    return found


def _reader(how: Convention, left: bool, parent_rest: Rotation, child_rest: Rotation):
    """A function from the rotations of both limbs to the three angles."""
    mirror = np.diag([1.0, -1.0, 1.0]) if left else np.eye(3)
    decompose = cardan_zxy if how.order == "ZXY" else euler_yxy

    def read(parent: Rotation, child: Rotation) -> np.ndarray:
        turn = (parent_rest * parent.inv() * child * child_rest.inv()).as_matrix()  # in the body frame, none at rest
        turn = mirror @ turn @ mirror
        return decompose(how.parent_axes.T @ turn @ how.child_axes) * how.signs

    return read


def _of_joint_frames(body: Body) -> list[_Found]:
    t = body.topology
    frames = [Rotation.from_quat(np.asarray(a.rotation, float).reshape(-1, 4), scalar_first=True) for a in (
        body.parent_anchor, body.child_anchor)] if t.joints else []  # fmt: skip

    def reader(j: int):
        def read(parent: Rotation, child: Rotation) -> np.ndarray:
            turn = (parent * frames[0][j]).inv() * child * frames[1][j]
            q = turn.as_quat(scalar_first=True)
            twist = 2 * np.arctan2(q[:, 3], q[:, 0])
            twist = np.where(twist > np.pi, twist - 2 * np.pi, np.where(twist < -np.pi, twist + 2 * np.pi, twist))
            level = np.stack([np.zeros_like(twist), np.zeros_like(twist), twist], -1)
            swing = (turn * Rotation.from_rotvec(level).inv()).as_rotvec()
            return np.concatenate([swing[:, :2], twist[:, None]], 1)

        return read

    names = ("swing_x", "swing_y", "twist")
    return [_Found(name, names, t.parents[j], t.children[j], reader(j)) for j, name in enumerate(t.joints)]


def _carried(read, parent: Rotation, child: Rotation, turns: Float[np.ndarray, "frame 2 3 3"]) -> np.ndarray:
    """Covariance of the three angles from those of both limbs' rotations, by central differences."""
    slopes = []
    for limb in (0, 1):
        for axis in range(3):
            small = Rotation.from_rotvec(STEP * np.eye(3)[axis])
            moved = [read(parent * s, child) if limb == 0 else read(parent, child * s) for s in (small, small.inv())]
            slopes.append(np.angle(np.exp(1j * (moved[0] - moved[1]))) / (2 * STEP))
    slope = np.stack(slopes, -1).reshape(len(turns), 3, 2, 3)
    return np.einsum("fali,flij,fblj->fab", slope, turns, slope)


def without_jumps(angles: Float[np.ndarray, "frame 3"]) -> Float[np.ndarray, "frame 3"]:
    """The same angles without jumps of a full turn between successive known values, their median within half a turn of
    0."""
    out = angles.copy()
    for column in out.T:
        known = np.isfinite(column)
        if known.any():
            smooth = np.unwrap(column[known])
            column[known] = smooth - 2 * np.pi * np.round(np.median(smooth) / (2 * np.pi))
    return out
