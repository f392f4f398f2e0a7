"""A person's mesh in motion: linear blend skinning, the bones turned as a clip's segments."""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from experiments.people.motions import PARENT, Clip

BONES = {
    "skullbase": "head", "vc7": "neck01", "l_shoulder": "upperarm01.L", "l_elbow": "lowerarm01.L", "l_wrist": "wrist.L",
    "r_shoulder": "upperarm01.R", "r_elbow": "lowerarm01.R", "r_wrist": "wrist.R", "l_hip": "upperleg01.L",
    "l_knee": "lowerleg01.L", "l_ankle": "foot.L", "r_hip": "upperleg01.R", "r_knee": "lowerleg01.R",
    "r_ankle": "foot.R",
}  # fmt: skip
# how far a bone goes from the first segment to the second one
BENT = {"spine05": 0.1, "spine04": 0.4, "spine03": 0.7, "spine02": 0.9, "neck01": 0.3, "neck02": 0.6, "neck03": 0.8}
LIMBS = (
    ("upperarm", "upper_arm"), ("lowerarm", "forearm"), ("wrist", "forearm"), ("finger", "forearm"),
    ("metacarpal", "forearm"), ("upperleg", "thigh"), ("lowerleg", "shank"), ("foot", "foot"), ("toe", "foot"),
)  # fmt: skip
TRUNK = (("root", "root"), ("pelvis", "root"), ("spine", "chest"), ("breast", "chest"))
# The clips' skeleton has no shoulder girdle, people have: as the arm turns from hanging to pointing forward, outward or
# up, its joint goes along, by so much of the stature for each unit of its direction (as in recorded people)
GIRDLE = np.array([0.013, 0.002, 0.018])


class Meshes(NamedTuple):
    """What bodies.py has written."""

    vertices: np.ndarray  # [person, vertex, 3] metres, at rest
    heads: np.ndarray  # [person, bone, 3]
    faces: np.ndarray
    bones: list[str]
    parents: np.ndarray
    skin: np.ndarray  # [vertex, k] bones
    weights: np.ndarray


@cache
def read_meshes(path: Path) -> Meshes:
    """Read once in each process."""
    data = np.load(path)
    return Meshes(*(data[name].tolist() if name == "bones" else data[name] for name in Meshes._fields))


class Figure:
    """One of the people."""

    def __init__(self, meshes: Meshes, person: int):
        self.meshes, self.vertices, self.heads = meshes, meshes.vertices[person], meshes.heads[person].astype(float)
        self.joints = {joint: self.heads[meshes.bones.index(bone)] for joint, bone in BONES.items()}
        length = lambda a, b: float(np.linalg.norm(self.joints[f"l_{a}"] - self.joints[f"l_{b}"]))  # noqa: E731
        self.dims = {
            "upper_arm": length("shoulder", "elbow"), "forearm": length("elbow", "wrist"),
            "thigh": length("hip", "knee"), "shank": length("knee", "ankle"),
            "stature": float(np.ptp(self.vertices[:, 2])),
        }  # fmt: skip
        self._hanging = {k: Rotation.identity() for k in ("root", "chest", "neck", "l_foot", "r_foot")}
        for side in "lr":
            for upper, lower, a, b, c in (
                ("upper_arm", "forearm", "shoulder", "elbow", "wrist"), ("thigh", "shank", "hip", "knee", "ankle"),
            ):  # fmt: skip
                first = self._down(side, a, b, Rotation.identity())
                self._hanging |= {f"{side}_{upper}": first, f"{side}_{lower}": self._down(side, b, c, first)}
        self.dims["stature"] = self._upright()

    def _upright(self) -> float:
        """Height of who stands with straight legs: in the rest pose legs are apart, and the mesh is 0.6 cm lower."""
        stands = Clip(dict.fromkeys(PARENT, Rotation.identity(1)), np.zeros((1, 3)))
        return float(np.ptp(self.posed(stands, np.ones(1))[0][0, :, 2]))

    def _down(self, side: str, upper: str, lower: str, turned: Rotation) -> Rotation:
        """The turn that lets a segment of the rest pose hang, after another turn."""
        along = turned.apply(self.joints[f"{side}_{lower}"] - self.joints[f"{side}_{upper}"])
        return Rotation.align_vectors([[0, 0, -1.0]], [along])[0] * turned

    def posed(self, clip: Clip, on_floor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertices [frame, vertex, 3] and joints [frame, joint, 3]; `on_floor` [frame]: 1 where the lowest part is on
        the floor, 0 where it is as high as the clip has it, between them in between."""
        world = clip.world()
        vertices, place = self.skinned(np.stack([self._bone(b, world).as_matrix() for b in self.meshes.bones], 1))
        leg = self.dims["thigh"] + self.dims["shank"]
        lowest, gone = vertices[..., 2].min(1), clip.place * leg
        height = gone[:, 2] + lowest
        free = on_floor < 1
        height -= np.percentile(height[free], 3) if free.any() else 0.0  # some part of the clip is on the floor
        gone[:, 2] = (1 - on_floor) * height - lowest
        return vertices + gone[:, None].astype(np.float32), self.joints_of(place) + gone[:, None]

    def joints_of(self, heads: np.ndarray) -> np.ndarray:
        """Joints [frame, joint, 3], from the heads of all bones."""
        return heads[:, [self.meshes.bones.index(bone) for bone in BONES.values()]]

    def skinned(self, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertices [frame, vertex, 3] and heads of bones [frame, bone, 3] under `turns` [frame, bone, 3, 3] from rest;
        the first bone's head is at the origin."""
        place, meshes = np.zeros((*turns.shape[:2], 3)), self.meshes
        for bone, parent in enumerate(meshes.parents):
            if parent >= 0:
                place[:, bone] = place[:, parent] + turns[:, parent] @ (self.heads[bone] - self.heads[parent])
        shift = place - np.einsum("fbij,bj->fbi", turns, self.heads)
        moves = np.concatenate([turns, shift[..., None]], -1).reshape(*turns.shape[:2], 12)
        vertex = np.repeat(np.arange(len(self.vertices)), meshes.skin.shape[1])
        size = len(self.vertices), turns.shape[1]
        weights = csr_array((meshes.weights.ravel(), (vertex, meshes.skin.ravel())), size)
        points = np.concatenate([self.vertices, np.ones((size[0], 1))], 1)
        one = lambda m: np.einsum("vij,vj->vi", (weights @ m).reshape(-1, 3, 4), points)  # noqa: E731
        return np.stack([one(m) for m in moves]).astype(np.float32), place

    def _bone(self, name: str, world: dict[str, Rotation]) -> Rotation:
        stem, _, side = name.partition(".")
        if stem in BENT:
            first, second = ("root", "chest") if stem.startswith("spine") else ("chest", "neck")
            return world[first] * Rotation.from_rotvec(BENT[stem] * (world[first].inv() * world[second]).as_rotvec())
        for start, segment in LIMBS if side else ():
            if stem.startswith(start):
                return world[f"{side.lower()}_{segment}"] * self._hanging[f"{side.lower()}_{segment}"]
        if side and stem.startswith(("clavicle", "shoulder")):
            return world["chest"] * self._girdle(side, world["chest"].inv() * world[f"{side.lower()}_upper_arm"])
        return world[next((segment for start, segment in TRUNK if stem.startswith(start)), "neck")]

    def _girdle(self, side: str, upper_arm: Rotation) -> Rotation:
        """The turn of the shoulder girdle against the chest, from that of the upper arm; [frame]."""
        hangs = np.array([0, 0, -1.0])
        moved = self.dims["stature"] * GIRDLE * (upper_arm.apply(hangs) - hangs)
        along = self.joints[f"{side.lower()}_shoulder"] - self.heads[self.meshes.bones.index(f"clavicle.{side}")]
        axis = np.cross(along, along + moved)
        angle = np.arctan2(np.linalg.norm(axis, axis=1), (along + moved) @ along)
        length = np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
        return Rotation.from_rotvec(angle[:, None] * axis / length)
