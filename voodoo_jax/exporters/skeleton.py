"""Tracks as a skeleton of bones, shared by the animation formats (BVH, glTF, USD).

A bone's place is the joint of the tracks that it begins in; bones between these (parts of the spine, clavicles, toes)
lie in fixed places of their limb. People have the bones of a rig that animation programs know, other bodies one for
each limb. In the bind pose all bones' axes are those of the file; a person stands in a T or an A, other bodies as their
body file says. Joints are held by elastic bands, so a bone's place in its parent changes by some millimetres from frame
to frame.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from voodoo_jax.config.output_style import Style
from voodoo_jax.exporters.frames import known, upright
from voodoo_jax.exporters.limb_shapes import loft, profile, side_of
from voodoo_jax.geometry.rotations import rotations, shortest_turns
from voodoo_jax.model.body import Body, tree_order
from voodoo_jax.model.joint_names import row_of
from voodoo_jax.model.pose_library import beyond
from voodoo_jax.records.tracks import Tracks

SIDES = ("middle", "left", "right")
# red, green, blue, 0..1 (linear): left warm, right cool, so that sides are told apart
SIDE_COLOURS = {"middle": (0.55, 0.55, 0.55), "left": (0.85, 0.25, 0.12), "right": (0.10, 0.30, 0.80)}


class _Part(NamedTuple):
    """A bone of a person's rig; `#` stands for l or r in the names of body files."""

    parent: int
    limbs: tuple[str, ...]  # that turns it: the first one that the body has
    at: str | float  # joint centre, sites with commas between, or a share of the way from between the hips to the neck
    aims: bool = False  # it points to its only child, whatever its limb does


# the waist is at 0.32 of that way in the built-in body; legs come first, as in LAFAN1's files
PARTS = (
    _Part(-1, ("pelvis", "torso"), 0.0), _Part(0, ("#_thigh",), "#_hip"), _Part(1, ("#_shank",), "#_knee"),
    _Part(2, ("#_foot", "#_shank"), "#_talocrural"),
    _Part(3, ("#_foot",), "#_metatarsal_phalanx_1,#_metatarsal_phalanx_5"), _Part(0, ("chest", "torso"), 0.32),
    _Part(5, ("chest", "torso"), 0.55), _Part(6, ("chest", "torso"), 0.78),
    _Part(7, ("chest", "torso"), "vc7", aims=True), _Part(8, ("head",), "skullbase"),
    _Part(7, ("chest", "torso"), "#_sternoclavicular", aims=True), _Part(10, ("#_upper_arm",), "#_shoulder"),
    _Part(11, ("#_forearm",), "#_elbow"), _Part(12, ("#_hand", "#_forearm"), "#_radiocarpal"),
)  # fmt: skip
# what programs call the bones of PARTS
RIGS = {
    "mixamo": "Hips UpLeg Leg Foot ToeBase Spine Spine1 Spine2 Neck Head Shoulder Arm ForeArm Hand",
    "lafan1": "Hips UpLeg Leg Foot Toe Spine Spine1 Spine2 Neck Head Shoulder Arm ForeArm Hand",
    "humanoid": "Hips UpperLeg LowerLeg Foot Toes Spine Chest UpperChest Neck Head Shoulder UpperArm LowerArm Hand",
}
RAISED = {"t": 90.0, "a": 45.0}  # degrees by which hanging arms are raised in the bind pose
NEAR = 0.08  # shares of the body's scale: a joint centre that is so near to a joint is the joint's


class _Bone(NamedTuple):
    """A bone of a body: `pivot` is a point of the limb `carrier` (in its frame); it turns as `limb`."""

    name: str
    parent: int
    limb: int
    carrier: int
    pivot: Float[np.ndarray, "3"]
    centres: tuple[int, ...] = ()  # joints of the tracks in whose middle it begins; none: where the pivot is
    aims: bool = False


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Bones, parents before children, and their poses. Metres; axes as requested; quaternions wxyz.

    `rotation` and `translation` are relative to the parent bone; frames without pose have those of the last one that
    had (`held`), and the bind pose before.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]  # [bone], -1: the root
    limbs: tuple[int, ...]  # [bone] limb of the body that turns it
    main: tuple[int, ...]  # [limb] the bone that is the limb
    bind: Float[np.ndarray, "bone 3"]  # pivots in the bind pose
    tips: Float[np.ndarray, "bone 3"]  # far ends of the limbs in the bind pose
    bind_limbs: tuple[Rotation, Float[np.ndarray, "limb 3"]]  # poses of the body's limbs in the bind pose
    rotation: Float[np.ndarray, "frame bone 4"]
    translation: Float[np.ndarray, "frame bone 3"]
    held: Bool[np.ndarray, " frame"]

    @property
    def offsets(self) -> Float[np.ndarray, "bone 3"]:
        """Pivots in the bind pose relative to the parents'."""
        return np.array([self.bind[i] - (self.bind[p] if p >= 0 else 0) for i, p in enumerate(self.parents)])

    def children(self, bone: int) -> list[int]:
        """Bones that hang on a bone."""
        return [i for i, parent in enumerate(self.parents) if parent == bone]


def skeleton(
    tracks: Tracks, axes: Float[np.ndarray, "3 3"], style: Style | None = None, rigid: bool = False
) -> Skeleton:
    """The bones of a body and their poses, in a frame whose axes are the rows of `axes` in one with z up; `rigid`:
    bones point to the next one, for programs that keep their lengths constant."""
    style, body = style or Style(), tracks.body
    turn, place = bind_pose(body, RAISED[style.pose])
    bones, places = _places(tracks, _bones(body, RIGS[style.rig].split()))
    at = lambda limb, point: turn[limb].apply(point) + place[limb]  # noqa: E731
    bind = np.array([at(b.carrier, b.pivot) for b in bones])
    lengths = np.asarray(body.sizes, float)[:, 4]
    tips = np.array([at(b.limb, [0, 0, lengths[b.limb]]) for b in bones])
    rotation, position, there = _poses(tracks, bones, places, bind, turn, rigid)
    out, parents = axes @ upright(tracks), [b.parent for b in bones]
    position = position @ out.T
    # of frames in the body's axes at first: in the file's axes both before and after
    count, frame = Rotation.from_matrix(out), Rotation.from_matrix(axes.T)
    whole = [count * rotation[i] * frame for i in range(len(bones))]
    local_turn, local_place = np.zeros((*position.shape[:2], 4)), np.zeros(position.shape)
    for i, parent in enumerate(parents):
        above = whole[parent].inv() if parent >= 0 else Rotation.identity()
        base = position[:, parent] if parent >= 0 else 0.0
        local_turn[:, i] = (above * whole[i]).as_quat(scalar_first=True)
        local_place[:, i] = above.apply(position[:, i] - base)
        if parent >= 0:
            there[:, i] &= there[:, parent]
    binds, ends = bind @ axes.T, tips @ axes.T
    offsets = np.array([binds[i] - (binds[p] if p >= 0 else 0) for i, p in enumerate(parents)])
    for i in range(len(bones)):
        _hold(local_turn[:, i], there[:, i], np.array([1.0, 0, 0, 0]))
        _hold(local_place[:, i], there[:, i], offsets[i])
    _continuous(local_turn)
    main = tuple(_main(bones, limb) for limb in range(body.limb_count))
    return Skeleton(
        tuple(b.name for b in bones), tuple(parents), tuple(b.limb for b in bones), main, binds, ends,
        (Rotation.from_matrix(axes) * turn, place @ axes.T), local_turn, local_place, ~there[:, 0],
    )  # fmt: skip


def bind_pose(body: Body, raised: float = 90.0) -> tuple[Rotation, Float[np.ndarray, "limb 3"]]:
    """Limbs in the body frame (z up, x forwards): the rest pose, with a person's hanging arms raised sideways by this
    many degrees."""
    t = body.topology
    turn = Rotation.from_quat(np.asarray(body.rest.rotation, float), scalar_first=True)
    turns, place = turn.as_matrix(), np.asarray(body.rest.translation, float).copy()
    for side, sign in (("l", 1.0), ("r", -1.0)):
        name = f"{side}_upper_arm"
        if name not in t.limbs or turns[t.limbs.index(name)][2, 2] > -0.9:  # its axis points downwards
            continue
        joint = t.children.index(t.limbs.index(name))
        parent = t.parents[joint]
        at = turns[parent] @ np.asarray(body.parent_anchor.translation, float)[joint] + place[parent]
        lift = Rotation.from_euler("x", sign * raised, degrees=True).as_matrix()
        for limb in beyond(body, joint):
            turns[limb] = lift @ turns[limb]
            place[limb] = lift @ (place[limb] - at) + at
    return Rotation.from_matrix(turns), place


def _bones(body: Body, names: list[str]) -> list[_Bone]:
    """Bones in the order of BVH: each is followed by its descendants. `names` of a person's."""
    t = body.topology
    person = {"l_upper_arm", "l_thigh"} <= set(t.limbs)
    bones = _of_rig(body, names) if person else [_Bone("_".join(t.limbs[0].split()), -1, 0, 0, np.zeros(3))]
    centre_of, anchors = _centre_of_joint(body), np.asarray(body.child_anchor.translation, float)
    has = {bone.limb for bone in bones if not bone.aims}
    for j in tree_order(t):  # limbs that the rig does not know, such as a thing that somebody carries
        child = t.children[j]
        if child not in has:
            own = (centre_of[j],) if j in centre_of else ()
            carrier = t.centre_limbs[own[0]] if own else child
            pivot = np.asarray(body.centres, float)[own[0]] if own else anchors[j]
            name = "_".join(t.limbs[child].split())
            bones.append(_Bone(name, _main(bones, t.parents[j]), child, carrier, pivot, own))
    for c in set(range(len(t.centres))) - {c for bone in bones for c in bone.centres}:
        limb = t.centre_limbs[c]
        bones.append(_Bone(t.centres[c], _main(bones, limb), limb, limb, np.asarray(body.centres, float)[c], (c,)))
    return _unlike(_in_depth(bones))


def _of_rig(body: Body, names: list[str]) -> list[_Bone]:
    """A person's bones; those without a place in the body are left out."""
    t = body.topology
    turn, place = rotations(np.asarray(body.rest.rotation)), np.asarray(body.rest.translation, float)
    at = lambda limb, point: turn[limb].apply(np.asarray(point, float)) + place[limb]  # noqa: E731
    spots = {name: at(limb, point) for name, limb, point in zip(t.sites, t.site_limbs, body.sites)}
    centres = np.array([at(limb, point) for limb, point in zip(t.centre_limbs, body.centres)])

    def begins(at: str | float) -> tuple[tuple[int, ...], list[np.ndarray]]:
        """The joint centres that are meant, and points between which the place is."""
        if isinstance(at, str):
            rows = [row for name in [at] if (row := row_of(t.centres, name)) is not None]
            return tuple(rows), [centres[row] for row in rows] or [spots[n] for n in at.split(",") if n in spots]
        hips, neck = (
            [row for side in "lr" if (row := row_of(t.centres, f"{side}_hip")) is not None],
            row_of(t.centres, "vc7"),
        )
        low = centres[hips].mean(0) if hips else place[0]
        if not at:
            return tuple(hips), [low]
        return (), [] if neck is None else [low + at * (centres[neck] - low)]

    bones: list[_Bone] = []
    made: dict[tuple[int, str], int] = {}  # part and side: its bone, or its parent's where it was left out
    for k, (part, name) in enumerate(zip(PARTS, names)):
        for side, word in (("l", "Left"), ("r", "Right")) if "#" in str(part) else (("", ""),):
            parent = made.get((part.parent, side), made.get((part.parent, ""), -1))
            limb = next((t.limbs.index(n) for own in part.limbs if (n := own.replace("#", side)) in t.limbs), None)
            own, points = begins(part.at.replace("#", side) if isinstance(part.at, str) else part.at)
            made[k, side] = parent
            if limb is not None and points:
                carrier = t.centre_limbs[own[0]] if own else limb
                pivot = turn[carrier].inv().apply(np.mean(points, 0) - place[carrier])
                made[k, side] = len(bones)
                bones.append(_Bone(word + name, parent, limb, carrier, pivot, own, part.aims))
    return bones


def _main(bones: list[_Bone], limb: int) -> int:
    """The bone that moves with a limb."""
    return next(i for i, bone in enumerate(bones) if bone.limb == limb and not bone.aims)


def _in_depth(bones: list[_Bone]) -> list[_Bone]:
    order: list[int] = []

    def follow(bone: int) -> None:
        order.append(bone)
        for child, other in enumerate(bones):
            if other.parent == bone:
                follow(child)

    follow(0)
    return [bones[i]._replace(parent=order.index(bones[i].parent) if i else -1) for i in order]


def _unlike(bones: list[_Bone]) -> list[_Bone]:
    """Names without duplicates, by a number: a centre may have the name of a limb."""
    count = {bone.name: 0 for bone in bones}
    for i, bone in enumerate(bones):
        count[bone.name] += 1
        if count[bone.name] > 1:
            bones[i] = bone._replace(name=f"{bone.name}_{count[bone.name]}")
    return bones


def _centre_of_joint(body: Body) -> dict[int, int]:
    """For joints of the body their reported centre: of the same name, or the nearest on one of both limbs, preferably
    the child's."""
    t = body.topology
    rest, place = Rotation.from_quat(np.asarray(body.rest.rotation, float), scalar_first=True), body.rest.translation
    place = np.asarray(place, float)
    found: dict[int, int] = {}
    for j in tree_order(t):
        parent, child = t.parents[j], t.children[j]
        at = rest[parent].apply(np.asarray(body.parent_anchor.translation, float)[j]) + place[parent]
        best = []
        for c, limb in enumerate(t.centre_limbs):
            if limb in (parent, child) and c not in found.values():
                centre = rest[limb].apply(np.asarray(body.centres, float)[c]) + place[limb]
                away = float(np.linalg.norm(centre - at)) / float(body.scale)
                if away < NEAR:
                    best.append((t.centres[c] != t.joints[j], limb != child, away, c))
        if best:
            found[j] = min(best)[3]
    return found


def _places(tracks: Tracks, bones: list[_Bone]) -> tuple[list[_Bone], Float[np.ndarray, "frame bone 3"]]:
    """Places where bones begin, NaN: not known; and bones with median pivots."""
    places, there = [], known(tracks)
    for i, bone in enumerate(bones):
        turn, at = rotations(tracks.rotation[:, bone.carrier]), tracks.translation[:, bone.carrier]
        if bone.centres:
            place = tracks.joints[:, list(bone.centres)].astype(float).mean(1)
            own = turn.inv().apply(np.where(np.isfinite(place), place - at, 0))
            own = own[np.isfinite(place).all(1) & there[:, bone.carrier]]
            bones[i] = bone._replace(pivot=np.median(own, 0)) if len(own) else bone
        else:
            place = turn.apply(bone.pivot) + at
        places.append(np.where(there[:, bone.carrier, None], place, np.nan))
    return bones, np.stack(places, 1)


def _poses(
    tracks: Tracks, bones: list[_Bone], position: Float[np.ndarray, "frame bone 3"],
    bind: Float[np.ndarray, "bone 3"], bind_turn: Rotation, rigid: bool,
) -> tuple[list[Rotation], Float[np.ndarray, "frame bone 3"], Bool[np.ndarray, "frame bone"]]:  # fmt: skip
    """Rotation of each bone since the bind pose (body frame to fixed frame), its place, and where both are known."""
    there = known(tracks)[:, [b.limb for b in bones]] & np.isfinite(position).all(2)
    position = np.where(there[..., None], position, 0.0)
    turned = [rotations(tracks.rotation[:, b.limb]) * bind_turn[b.limb].inv() for b in bones]
    for i, bone in enumerate(bones):
        children = [c for c, other in enumerate(bones) if other.parent == i]
        if (bone.aims or rigid) and len(children) == 1:
            there[:, i] &= there[:, children[0]]
            now = position[:, children[0]] - position[:, i]
            turned[i] = shortest_turns(turned[i].apply(bind[children[0]] - bind[i]), now) * turned[i]
    return turned, position, there


def _hold(values: np.ndarray, there: Bool[np.ndarray, " frame"], first: np.ndarray) -> None:
    """Repeats the last known value in gaps, in place; `first` before there was one."""
    last = np.maximum.accumulate(np.where(there, np.arange(len(there)), -1))
    values[:] = np.where((last >= 0)[:, None], values[np.maximum(last, 0)], first)


def _continuous(turn: Float[np.ndarray, "frame bone 4"]) -> None:
    """Chooses the signs of quaternions by the frame before, in place: files are interpolated."""
    if len(turn) > 1:
        flips = np.where((turn[1:] * turn[:-1]).sum(-1) < 0, -1.0, 1.0)
        turn[1:] *= np.cumprod(flips, 0)[..., None]


@dataclass(frozen=True, eq=False)
class LimbMesh:
    """All limbs of one side, metres, in the bind pose and the axes of the skeleton."""

    side: str
    vertices: Float[np.ndarray, "vertex 3"]
    normals: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    bones: Int[np.ndarray, " vertex"]  # bone that moves the vertex


def limb_meshes(body: Body, bones: Skeleton) -> list[LimbMesh]:
    """One mesh for each side that the body has."""
    turn, place = bones.bind_limbs
    parts: dict[str, list] = {side: [] for side in SIDES}
    for limb, name in enumerate(body.topology.limbs):
        points, faces = loft(profile(body, limb))
        corners = points[faces]  # faces do not share vertices: edges of the ends are sharp
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        there = np.linalg.norm(normals, axis=1) > 0.5  # at the end of a round limb faces have no area
        vertices, smooth = corners[there].reshape(-1, 3), np.repeat(normals[there], 3, 0)
        parts[side_of(name)].append(
            (turn[limb].apply(vertices) + place[limb], turn[limb].apply(smooth), bones.main[limb])
        )
    found = []
    for side, pieces in parts.items():
        if pieces:
            vertices, normals = (np.concatenate([piece[k] for piece in pieces]) for k in (0, 1))
            owner = np.concatenate([np.full(len(piece[0]), piece[2]) for piece in pieces])
            found.append(LimbMesh(side, vertices, normals, np.arange(len(vertices)).reshape(-1, 3), owner))
    return found
