"""Motion clips for any skeleton, as turns of segments: those of DeepMimic (Peng 2018), as PyBullet's package brings
them, and those of the Bandai-Namco motion data set (*.bvh)."""

import json
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

RATE = 30.0  # frames per second
AXES = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]])  # x forward, y up, z right becomes x forward, y left, z up
LEG = 0.8312  # metres from hip to ankle of who was recorded
PARENT = {"root": "", "chest": "root", "neck": "chest"} | {
    f"{side}_{name}": parent if parent in ("root", "chest") else f"{side}_{parent}"
    for side in "lr"
    for name, parent in (
        ("thigh", "root"), ("shank", "thigh"), ("foot", "shank"), ("upper_arm", "chest"), ("forearm", "upper_arm"),
    )
}  # fmt: skip
BALLS = dict(root=4, chest=8, neck=12, r_thigh=16, r_foot=21, r_upper_arm=25, l_thigh=30, l_foot=35, l_upper_arm=39)
ENDS = ("l_forearm", "r_forearm", "l_shank", "r_shank")
# the joints of a *.bvh that turn each segment, and where the segment ends
BVH = {"root": ("Hips", ""), "chest": ("Chest", ""), "neck": ("Head", "")} | {
    f"{side}_{name}": (f"{joint}_{side.upper()}", f"{end}_{side.upper()}" if end else "")
    for side in "lr"
    for name, joint, end in (
        ("thigh", "UpperLeg", "LowerLeg"), ("shank", "LowerLeg", "Foot"), ("foot", "Foot", ""),
        ("upper_arm", "UpperArm", "LowerArm"), ("forearm", "LowerArm", "Hand"),
    )
}  # fmt: skip
HINGES = dict(r_shank=20, r_forearm=29, l_shank=34, l_forearm=43)  # columns of a clip's frames


class Clip(NamedTuple):
    """Turns of each segment against the one before it (zero: stands upright, arms and legs hanging), at RATE."""

    turns: dict[str, Rotation]  # [frame]
    place: np.ndarray  # [frame, 3] of the hips, metres, of somebody whose legs are 1 m long

    def world(self) -> dict[str, Rotation]:
        """Turns of all segments against the fixed axes."""
        found: dict[str, Rotation] = {}
        for name, parent in PARENT.items():
            found[name] = found[parent] * self.turns[name] if parent else self.turns[name]
        return found

    def mirrored(self) -> "Clip":
        """Left and right exchanged."""
        other = lambda name: {"l": "r", "r": "l"}.get(name[0], "") + name[1:] if name[1] == "_" else name  # noqa: E731
        turns = {other(k): Rotation.from_rotvec(v.as_rotvec() * [-1, 1, -1]) for k, v in self.turns.items()}
        return Clip(turns, self.place * [1, -1, 1])


def read_clip(path: Path, speed: float, times: int) -> Clip:
    """A clip, so many times on end, each going on where the one before ended; begins at the origin and faces x."""
    frames = np.array(json.loads(path.read_text())["Frames"])
    time = np.concatenate([[0], np.cumsum(frames[:-1, 0])])
    axes = Rotation.from_matrix(AXES)
    turns = {k: Rotation.from_quat(frames[:, c : c + 4], scalar_first=True) for k, c in BALLS.items()}
    turns |= {k: Rotation.from_rotvec(frames[:, c, None] * [0, 0, 1.0]) for k, c in HINGES.items()}
    turns = {k: axes * v * axes.inv() for k, v in turns.items()}
    place = frames[:, 1:4] @ AXES.T / LEG
    at = np.arange(0, time[-1] / speed, 1 / RATE) * speed
    turns = {k: Slerp(time, v)(at) for k, v in turns.items()}
    place = np.stack([np.interp(at, time, p) for p in place.T], 1)
    rounds, root = [], []
    heading, here = 0.0, np.zeros(2)
    for _ in range(times):
        turn = Rotation.from_euler("z", heading - _heading(turns["root"][0]))
        root.append(turn * turns["root"])
        gone = turn.apply(place - place[0])
        rounds.append(np.column_stack([gone[:, :2] + here, place[:, 2]]))
        heading, here = _heading(root[-1][-1]), rounds[-1][-1, :2]
    turns = {k: Rotation.concatenate([v] * times) for k, v in turns.items()} | {"root": Rotation.concatenate(root)}
    return Clip(turns, np.concatenate(rounds))


def find_clip(folder: Path, name: str, speed: float, times: int, most: int = 0) -> Clip:
    """The clip of a name in a folder, of either kind; its `most` liveliest frames on end (0: all)."""
    path = next(path for path in sorted(folder.glob(f"*_{name}.*")) if path.suffix in (".txt", ".bvh"))
    return liveliest(read_bvh(path) if path.suffix == ".bvh" else read_clip(path, speed, times), most)


def read_bvh(path: Path) -> Clip:
    """A clip of the Bandai-Namco data set; begins at the origin and faces x.

    In its first frame somebody stands: limbs there are turned the shortest way from hanging, all else not at all.
    """
    places, turns, names = [], [], re.findall(r"(?:ROOT|JOINT) (\w+)", text := path.read_text())
    frames = np.array([row.split() for row in text.split("Frame Time:")[1].splitlines()[1:] if row.strip()], float)
    parents: dict[str, str] = {}
    above: list[str] = []
    for word, name in re.findall(r"(ROOT|JOINT|End|\})(?: (\w+))?", text.split("MOTION")[0]):
        if word == "}":
            above.pop()
        else:
            parents[name] = above[-1] if above else ""
            above.append(name)
    axes = Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0.0]])  # z forward, x left, y up becomes x, y, z
    for k, name in enumerate(names):
        place = axes.apply(frames[:, 6 * k : 6 * k + 3]) / 100
        turn = axes * Rotation.from_euler("ZXY", frames[:, 6 * k + 3 : 6 * k + 6], degrees=True) * axes.inv()
        if parent := parents[name]:
            at = names.index(parent)
            place, turn = places[at] + turns[at].apply(place), turns[at] * turn
        places.append(place)
        turns.append(turn)
    at = dict(zip(names, places))
    left = at["UpperLeg_L"][0] - at["UpperLeg_R"][0]
    facing = Rotation.from_euler("z", np.arctan2(left[0], left[1]))
    world = {}
    for name, (joint, end) in BVH.items():
        turn, begins = turns[names.index(joint)], Rotation.identity()
        if end:
            along = facing.apply(at[end][0] - at[joint][0])
            begins = Rotation.align_vectors([along], [[0, 0, -1.0]])[0]
        world[name] = facing * turn * turn[0].inv() * facing.inv() * begins
    legs = np.linalg.norm(at["UpperLeg_L"] - at["LowerLeg_L"], axis=1) + np.linalg.norm(
        at["LowerLeg_L"] - at["Foot_L"], axis=1
    )
    relative = {k: world[parent].inv() * world[k] if (parent := PARENT[k]) else world[k] for k in PARENT}
    return Clip(relative, facing.apply(at["Hips"] - at["Hips"][0] * [1, 1, 0]) / legs.mean())


def liveliest(clip: Clip, most: int) -> Clip:
    """Its frames on end, `most` of them, in which forearms and shanks turn most; all of them if that is 0."""
    if not 0 < most < len(clip.place):
        return clip
    world = clip.world()
    speed = np.sum([(world[name][1:] * world[name][:-1].inv()).magnitude() for name in ENDS], 0)
    first = int(np.argmax(np.convolve(speed, np.ones(most - 1), "valid")))
    some = slice(first, first + most)
    turn = Rotation.from_euler("z", -_heading(world["root"][first]))
    turns = {k: v[some] for k, v in clip.turns.items()} | {"root": turn * world["root"][some]}
    return Clip(turns, turn.apply(clip.place[some] - clip.place[first] * [1, 1, 0]))


def _heading(turn: Rotation) -> float:
    ahead = turn.apply([1.0, 0, 0])
    return float(np.arctan2(ahead[1], ahead[0]))


def after_standing(clip: Clip, still: int, eased: int, held: int) -> Clip:
    """So many frames relaxed, so many in which the clip's first pose is taken, the clip, and its last pose held."""
    relaxed = {k: Rotation.identity() for k in PARENT}
    relaxed |= {"l_upper_arm": Rotation.from_rotvec([0.15, 0, 0]), "r_upper_arm": Rotation.from_rotvec([-0.15, 0, 0])}
    relaxed |= {f"{side}_forearm": Rotation.from_rotvec([0, -0.2, 0]) for side in "lr"}
    share = np.arange(1, eased + 1) / (eased + 1)
    turns = {}
    for name, first in relaxed.items():
        between = turned(first, clip.turns[name][0], share)
        last = clip.turns[name][-1]
        turns[name] = Rotation.concatenate([*[first] * still, between, clip.turns[name], *[last] * held])
    place = np.concatenate(
        [np.repeat(clip.place[:1], still + eased, 0), clip.place, np.repeat(clip.place[-1:], held, 0)]
    )
    return Clip(turns, place)


def turned(first: Rotation, last: Rotation, share: np.ndarray) -> Rotation:
    """From one turn to another: where it is after each `share` (0..1) of the time, slow at both ends."""
    return first * Rotation.from_rotvec(eased(share)[:, None] * (first.inv() * last).as_rotvec())


def eased(share: np.ndarray) -> np.ndarray:
    """How far something has gone after each `share` (0..1) of the time that is slow at both ends."""
    return share * share * (3 - 2 * share)


def there_and_back(clip: Clip, held: int) -> Clip:
    """The clip backwards, so many frames in its first pose, and the clip."""
    turns = {k: Rotation.concatenate([v[::-1], *[v[0]] * held, v]) for k, v in clip.turns.items()}
    return Clip(turns, np.concatenate([clip.place[::-1], np.repeat(clip.place[:1], held, 0), clip.place]))
