"""Tracks as a skeleton of bones: what animation formats (BVH, glTF, USD) share.

A bone for each limb, with its joint as pivot: the joint centre that tracks report, where there is one near the joint.
In the bind pose all bones' axes are those of the file; a person stands in a T, other bodies as their body file says.
Joints are held by elastic bands, so a bone's place in its parent changes by some millimetres from frame to frame.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from voodoo_jax.exporters.frames import known, upright
from voodoo_jax.geometry.rotations import rotations
from voodoo_jax.model.body import Body, tree_order
from voodoo_jax.records.tracks import Tracks

# limb or joint centre of a person: bone, as Mixamo calls it, whom Blender's add-ons and Unity's humanoid mapping know
HUMANOID = {"pelvis": "Hips", "torso": "Hips", "chest": "Spine", "vc7": "Neck", "head": "Head"} | {
    f"{side}_{limb}": f"{word}{bone}"
    for side, word in (("l", "Left"), ("r", "Right"))
    for limb, bone in {
        "upper_arm": "Arm", "forearm": "ForeArm", "hand": "Hand", "radiocarpal": "Hand", "thigh": "UpLeg",
        "shank": "Leg", "foot": "Foot", "talocrural": "Foot",
    }.items()
}  # fmt: skip
NEAR = 0.08  # shares of the body's scale: a joint centre that is so near to a joint is the joint's
ABOVE = {"head": "vc7"}  # a centre that is a bone of its own between a limb and its parent


class _Bone(NamedTuple):
    """A bone of a body: `pivot` is a point of the limb `carrier` (in its frame), turned is it as `limb`."""

    name: str
    parent: int
    limb: int
    carrier: int
    pivot: Float[np.ndarray, "3"]
    aims: bool = False  # it points to its only child, whatever its limb does
    whole: bool = False  # it is the limb, and not a place on it


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Bones, parents before children, and where they are. Metres; axes as asked for; quaternions wxyz.

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


def skeleton(tracks: Tracks, axes: Float[np.ndarray, "3 3"]) -> Skeleton:
    """The bones of a body and their poses, in a frame whose axes are the rows of `axes` in one with z up."""
    body = tracks.body
    turn, place = bind_pose(body)
    bones = _bones(body)
    at = lambda limb, point: turn[limb].apply(point) + place[limb]  # noqa: E731
    bind = np.array([at(b.carrier, b.pivot) for b in bones])
    lengths = np.asarray(body.sizes, float)[:, 4]
    tips = np.array([at(b.limb, [0, 0, lengths[b.limb]]) for b in bones])
    rotation, position, there = _poses(tracks, bones, bind, turn)
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
    main = tuple(next(i for i, b in enumerate(bones) if b.limb == limb and b.whole) for limb in range(body.limb_count))
    return Skeleton(
        tuple(b.name for b in bones), tuple(parents), tuple(b.limb for b in bones), main, binds, ends,
        (Rotation.from_matrix(axes) * turn, place @ axes.T), local_turn, local_place, ~there[:, 0],
    )  # fmt: skip


def bind_pose(body: Body) -> tuple[Rotation, Float[np.ndarray, "limb 3"]]:
    """Limbs in the body frame (z up, x forwards): the rest pose, with a person's hanging arms raised to their sides."""
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
        raised = Rotation.from_euler("x", sign * 90, degrees=True).as_matrix()
        for limb in _subtree(body, t.children[joint]):
            turns[limb] = raised @ turns[limb]
            place[limb] = raised @ (place[limb] - at) + at
    return Rotation.from_matrix(turns), place


def _subtree(body: Body, limb: int) -> list[int]:
    t = body.topology
    found = [limb]
    for j in tree_order(t):
        if t.parents[j] in found:
            found.append(t.children[j])
    return found


def _bones(body: Body) -> list[_Bone]:
    """Bones in such an order that BVH can write them: each followed by all that hangs on it."""
    t = body.topology
    centres, centre_of = np.asarray(body.centres, float), _centre_of_joint(body)
    anchors = np.asarray(body.parent_anchor.translation, float)
    free = [c for c in range(len(t.centres)) if c not in centre_of.values()]
    bones: list[_Bone] = []
    name = _named(body)

    def add(limb: int, parent: int, carrier: int, pivot: np.ndarray) -> None:
        above = [c for c in free if t.centres[c] == ABOVE.get(t.limbs[limb]) and parent >= 0]
        for c in above:
            free.remove(c)
            bones.append(_Bone(name(t.centres[c]), parent, bones[parent].limb, t.centre_limbs[c], centres[c], True))
            parent = len(bones) - 1
        bones.append(_Bone(name(t.limbs[limb]), parent, limb, carrier, pivot, whole=True))
        own = len(bones) - 1
        hanging = [j for j in range(len(t.joints)) if t.parents[j] == limb]
        half, upper = float(np.asarray(body.sizes)[limb, 4]) / 2, -1
        if t.limbs[limb] == "torso":  # of one piece: humanoid mappings ask for a spine
            hanging.sort(key=lambda j: anchors[j, 2] > half)
        for j in hanging:
            above = own
            if t.limbs[limb] == "torso" and anchors[j, 2] > half:
                if upper < 0:
                    bones.append(_Bone("Spine", own, limb, limb, np.array([0, 0, half])))
                    upper = len(bones) - 1
                above = upper
            child, c = t.children[j], centre_of.get(j)
            if c is None:
                add(child, above, child, np.asarray(body.child_anchor.translation, float)[j])
            else:
                add(child, above, t.centre_limbs[c], centres[c])
        for c in [c for c in free if t.centre_limbs[c] == limb and t.centres[c] not in ABOVE.values()]:
            free.remove(c)
            bones.append(_Bone(name(t.centres[c]), own, limb, limb, centres[c]))

    add(0, -1, 0, _root_pivot(body, centre_of))
    names: dict[str, int] = {}
    for i, bone in enumerate(bones):  # a centre may have the name of a limb
        names[bone.name] = names.get(bone.name, 0) + 1
        if names[bone.name] > 1:
            bones[i] = bone._replace(name=f"{bone.name}_{names[bone.name]}")
    return bones


def _named(body: Body) -> Callable[[str], str]:
    """What the bone of a limb or joint centre is called: by HUMANOID for a person, else as in the body file."""
    person = {"l_upper_arm", "l_thigh"} <= set(body.topology.limbs)
    return lambda own: (HUMANOID if person else {}).get(own, "_".join(own.split()))


def _centre_of_joint(body: Body) -> dict[int, int]:
    """For joints of the body the reported centre that is theirs: of the same name, or the nearest on one of both limbs,
    rather the child's."""
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


def _root_pivot(body: Body, centre_of: dict[int, int]) -> Float[np.ndarray, "3"]:
    """In the root limb's frame: between the pair of joints (left and right) that is nearest to its bottom, or there."""
    t, pairs = body.topology, []
    anchors = np.asarray(body.parent_anchor.translation, float)
    for j, name in enumerate(t.joints):
        other = f"r_{name[2:]}"
        if name.startswith("l_") and other in t.joints and t.parents[j] == t.parents[t.joints.index(other)] == 0:
            ends = [
                np.asarray(body.centres, float)[centre_of[k]]
                if k in centre_of and t.centre_limbs[centre_of[k]] == 0
                else anchors[k]
                for k in (j, t.joints.index(other))
            ]
            pairs.append((abs(float(np.mean(ends, 0)[2])), np.mean(ends, 0)))
    return min(pairs, key=lambda pair: pair[0])[1] if pairs else np.zeros(3)


def _poses(
    tracks: Tracks, bones: list[_Bone], bind: Float[np.ndarray, "bone 3"], bind_turn: Rotation
) -> tuple[list[Rotation], Float[np.ndarray, "frame bone 3"], Bool[np.ndarray, "frame bone"]]:
    """Rotation of each bone since the bind pose (body frame to fixed frame), its place, and where both are known."""
    limb, carrier = [b.limb for b in bones], [b.carrier for b in bones]
    poses = known(tracks)
    there = poses[:, limb] & poses[:, carrier]
    position = np.stack(
        [rotations(tracks.rotation[:, b.carrier]).apply(b.pivot) + tracks.translation[:, b.carrier] for b in bones], 1
    )
    position = np.where(there[..., None], position, 0.0)
    turned = [rotations(tracks.rotation[:, b.limb]) * bind_turn[b.limb].inv() for b in bones]
    for i, bone in enumerate(bones):
        children = [c for c, other in enumerate(bones) if other.parent == i]
        if bone.aims and len(children) == 1:
            there[:, i] &= there[:, children[0]]
            now = position[:, children[0]] - position[:, i]
            turned[i] = _towards(turned[i].apply(bind[children[0]] - bind[i]), now) * turned[i]
    return turned, position, there


def _towards(before: Float[np.ndarray, "frame 3"], after: Float[np.ndarray, "frame 3"]) -> Rotation:
    """Smallest turns of directions to other ones."""
    axis = np.cross(before, after)
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(length, (before * after).sum(1, keepdims=True))
    return Rotation.from_rotvec(axis * np.where(length > 1e-12, angle / np.maximum(length, 1e-12), 0.0))


def _hold(values: np.ndarray, there: Bool[np.ndarray, " frame"], first: np.ndarray) -> None:
    """Repeats the last known value where there is none, in place; `first` before there was one."""
    last = np.maximum.accumulate(np.where(there, np.arange(len(there)), -1))
    values[:] = np.where((last >= 0)[:, None], values[np.maximum(last, 0)], first)


def _continuous(turn: Float[np.ndarray, "frame bone 4"]) -> None:
    """Quaternions of that sign that is nearer to the frame before, in place: files are interpolated."""
    if len(turn) > 1:
        flips = np.where((turn[1:] * turn[:-1]).sum(-1) < 0, -1.0, 1.0)
        turn[1:] *= np.cumprod(flips, 0)[..., None]
