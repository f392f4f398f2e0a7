"""Motion clips of DeepMimic (Peng 2018), as PyBullet's package brings them, for any skeleton: turns of segments."""

import json
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
