"""Postures drawn at random: people who stand, walk, bend, sit, kneel, crawl, lie; as a clip of which each frame is
another one."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.people.motions import PARENT, Clip

KINDS = {
    "clip": 0.14, "stand": 0.16, "walk": 0.1, "lunge": 0.05, "bend": 0.05, "squat": 0.04, "sit": 0.18, "floor": 0.04,
    "kneel": 0.03, "crawl": 0.03, "supine": 0.07, "prone": 0.05, "side": 0.05, "any": 0.01,
}  # fmt: skip
LIES = ("supine", "prone", "side")
# arms: forwards, outwards, turned inwards about the vertical, elbow; radians, mean and deviation; and how often
ARMS = np.array([
    [(0.0, 0.25), (0.15, 0.12), (0.0, 0.2), (0.3, 0.25)],  # hang
    [(1.2, 0.5), (0.15, 0.25), (0.2, 0.4), (0.8, 0.6)],  # ahead
    [(0.3, 0.5), (2.4, 0.4), (0.0, 0.4), (0.6, 0.6)],  # up
    [(0.1, 0.3), (1.4, 0.3), (0.0, 0.4), (0.6, 0.6)],  # to the side
    [(-0.4, 0.15), (0.7, 0.15), (1.2, 0.2), (1.6, 0.2)],  # on the hip
    [(0.6, 0.2), (0.15, 0.1), (1.0, 0.2), (1.9, 0.2)],  # crossed
    [(0.4, 0.2), (0.15, 0.1), (0.3, 0.2), (1.4, 0.3)],  # carries, writes
    [(0.7, 0.3), (0.3, 0.2), (0.4, 0.3), (2.3, 0.2)],  # to the head
    [(-0.4, 0.2), (0.2, 0.1), (0.8, 0.2), (1.2, 0.3)],  # behind
    [(0.6, 1.0), (0.6, 0.7), (0.2, 0.6), (1.2, 0.8)],  # any
])  # fmt: skip
# arms of who lies flat: outwards, elbow bent in the plane of the trunk; radians
FLAT = np.array([[0.2, 0.15], [0.3, 0.3], [1.3, 1.4], [2.3, 1.2]])
OFTEN = np.array([0.34, 0.14, 0.08, 0.06, 0.05, 0.05, 0.1, 0.05, 0.03, 0.1])


class Drawn(NamedTuple):
    """Postures."""

    clip: Clip  # each frame another one
    kind: np.ndarray  # [frame] names in KINDS


def drawn(rng: np.random.Generator, count: int, clips: list[Clip]) -> Drawn:
    """So many postures; some of them frames of motion clips, half of these mirrored."""
    kinds = rng.choice(list(KINDS), count, p=list(KINDS.values()))
    parts = {name: np.zeros((count, 4)) for name in PARENT}
    for frame, kind in enumerate(kinds):
        turns = _frame_of(rng, clips) if kind == "clip" else _posture(rng, str(kind))
        for name in PARENT:
            parts[name][frame] = turns[name].as_quat()
    clip = Clip({name: Rotation.from_quat(some) for name, some in parts.items()}, np.zeros((count, 3)))
    return Drawn(clip, kinds)


def _frame_of(rng: np.random.Generator, clips: list[Clip]) -> dict[str, Rotation]:
    clip = clips[rng.integers(len(clips))]
    frame = int(rng.integers(len(clip.place)))
    one = Clip({name: turn[frame] for name, turn in clip.turns.items()}, clip.place[frame])
    return one.mirrored().turns if rng.random() < 0.5 else one.turns


def _turn(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Rotation:
    return Rotation.from_rotvec([x, y, z])


def _raised(ahead: float, out: float) -> Rotation:
    return _turn(x=out) * _turn(y=-ahead)


def _posture(rng: np.random.Generator, kind: str) -> dict[str, Rotation]:
    """Turns of all segments against the ones before; legs as the floor sees them, or who lies."""
    n, u = rng.normal, rng.uniform
    root, chest = _turn(*n(0, 0.06, 3) * [1, 1, 0]), _turn(*n([0, 0.08, 0], [0.08, 0.12, 0.18]))
    neck = _turn(*n([0, 0.05, 0], [0.12, 0.22, 0.4]))
    seen_by_floor, arms = True, [int(rng.choice(len(ARMS), p=OFTEN)) for _ in range(2)]
    if rng.random() < 0.45:
        arms[1] = arms[0]
    legs = [[n(0, 0.08), n(0.06, 0.06), abs(n(0, 0.06))] for _ in range(2)]  # ahead, out, knee
    one = int(rng.integers(2))
    if kind == "walk":
        step, back = u(0.1, 0.65), u(0.1, 1.1)
        legs[one], legs[1 - one] = [step, n(0.03, 0.04), u(0, 0.35)], [-step, n(0.03, 0.04), back]
        if rng.random() < 0.6:
            arms = [0, 0]
    elif kind == "lunge":
        legs[one] = [u(-0.5, 1.6), u(-0.1, 0.8), u(0, 1.7)]
        legs[1 - one] = [u(-0.2, 0.5), u(0, 0.4), u(0, 0.7)]
    elif kind == "bend":
        root, chest = _turn(y=u(0.2, 1.1)), _turn(n(0, 0.15), u(0.1, 1.0), n(0, 0.25))
    elif kind == "squat":
        knee = u(1.0, 2.4)
        legs = [[n(0.7 * knee, 0.15), u(0.05, 0.5), knee] for _ in range(2)]
        root = _turn(y=u(0.1, 0.6))
    elif kind == "sit":
        root = _turn(y=u(-0.45, 0.3))
        legs = [[n(1.5, 0.14), n(0.13, 0.14), np.clip(n(1.5, 0.3), 0.2, 2.1)] for _ in range(2)]
        arms = [int(rng.choice([0, 1, 5, 6, 6, 6, 7, 9])) for _ in range(2)]
    elif kind == "floor":
        knee = rng.choice([0.2, 1.9, 1.6])
        out = 0.7 if knee == 1.9 else 0.13
        legs = [[n(1.6 + 0.2 * (knee > 1), 0.15), n(out, 0.12), abs(n(knee, 0.2))] for _ in range(2)]
        root = _turn(y=n(-0.15, 0.2))
    elif kind == "kneel":
        low = u(0, 2.0) if rng.random() < 0.4 else abs(n(0, 0.1))
        legs = [[n(0.8 * low, 0.1), n(0.1, 0.1), np.clip(1.55 + 0.45 * low, 1.4, 2.5)] for _ in range(2)]
        if rng.random() < 0.4:
            legs[one] = [n(1.5, 0.15), n(0.1, 0.1), n(1.5, 0.15)]
    elif kind == "crawl":
        root, neck = _turn(y=n(1.4, 0.15)), _turn(n(0, 0.1), n(-0.5, 0.3), n(0, 0.3))
        legs = [[n(0, 0.3), n(0.08, 0.1), np.clip(n(1.6, 0.2), 1.0, 2.3)] for _ in range(2)]
    elif kind in LIES:
        seen_by_floor = False
        arms = [int(rng.choice([0, 1, 5, 6, 6, 6, 7])) for _ in range(2)]
        if kind == "prone" and rng.random() < 0.75:  # the head to a side
            neck = _turn(z=rng.choice([-1, 1]) * n(1.0, 0.3))
        elif kind == "supine" and rng.random() < 0.5:  # on pillows
            chest, neck = chest * _turn(y=u(0, 0.5)), neck * _turn(y=u(0, 0.5))
        root = {"supine": _turn(y=-np.pi / 2), "prone": _turn(y=np.pi / 2), "side": _turn(x=np.pi / 2)}[kind]
        root = _turn(*n(0, 0.06, 3)) * (root if kind != "side" or one else _turn(x=-np.pi / 2))
        bent = u(0, 1.3) if kind == "side" else 0.0
        legs = [[n(bent, 0.15), abs(n(0.1, 0.1)), abs(n(1.2 * bent, 0.15))] for _ in range(2)]
        if rng.random() < 0.35:
            legs[one] = (
                [u(0.3, 1.0), n(0.15, 0.2), u(0.5, 1.8)] if kind != "prone" else [n(0, 0.1), u(0.2, 0.9), u(0, 1.2)]
            )
    elif kind == "any":
        seen_by_floor, root = False, Rotation.random(rng=rng)
        legs = [[u(-0.4, 2.0), u(-0.1, 0.8), u(0, 2.4)] for _ in range(2)]
    flat = kind == "prone" or (kind == "supine" and rng.random() < 0.5)  # arms in the plane of the trunk
    tucked = rng.random() < 0.5
    found = {"root": root, "chest": chest, "neck": neck}
    for side, sign, arm, (ahead, out, knee) in zip("lr", (1, -1), arms, legs):
        if kind == "crawl":
            forward, outward, inwards, elbow = n(1.45, 0.2), n(0.1, 0.1), n(0, 0.1), abs(n(0, 0.2))
        elif flat:
            outward, elbow = FLAT[rng.integers(len(FLAT))] + n(size=2) * [0.25, 0.3]
            forward, inwards = n(0, 0.1), -np.pi / 2
        else:
            forward, outward, inwards, elbow = n(*ARMS[arm].T)
        about = _turn(z=-sign * inwards)
        raised = _raised(forward, sign * max(outward, -0.15))
        found[f"{side}_upper_arm"] = raised if flat else about * raised
        found[f"{side}_forearm"] = about * _raised(float(np.clip(elbow, 0, 2.5)), 0) * about.inv()
        thigh = _raised(ahead, sign * out)
        if kind in LIES:  # toes fall outwards
            thigh = thigh * _turn(z=sign * n(0.3, 0.4))
        found[f"{side}_thigh"] = root.inv() * thigh if seen_by_floor else thigh
        found[f"{side}_shank"] = _turn(y=knee)
        if kind in ("crawl", "kneel"):  # on the toes, or on the back of the foot
            level = -abs(n(0.5, 0.4)) if tucked else n(0.9, 0.2)
        else:  # who lies points the toes
            level = min(ahead - knee, 0.6) if seen_by_floor else n(0.6, 0.3)
        found[f"{side}_foot"] = _turn(y=float(np.clip(level, -0.9, 1.1)))
    return found
