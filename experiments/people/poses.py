"""Clips made of key poses drawn at random: exercises, sitting down and standing up, sitting all the time."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.people.motions import PARENT, RATE, Clip, turned

Pose = dict[str, Rotation]
# each arm: forwards, outwards, turned inwards about the vertical, elbow; radians
HANGS, SIDE, UP = (0, 0.15, 0, 0.2), (0, 1.5, 0, 0.05), (0, 2.9, 0, 0.1)
ON_HIP, WAVES, PRAYS = (-0.4, 0.7, 1.2, 1.6), (0, 1.5, -1.2, 2.0), (0.6, 0.1, 0.7, 1.9)
AHEAD, BEHIND = (1.5, 0.05, 0, 0.1), (-0.5, 0.2, 0.8, 1.2)
ARMS = (
    (HANGS, HANGS), (SIDE, SIDE), (UP, UP), (AHEAD, AHEAD), (ON_HIP, ON_HIP), (PRAYS, PRAYS), (BEHIND, BEHIND),
    ((0.6, 0.15, 1, 1.9), (0.7, 0.15, 1, 1.8)), (HANGS, WAVES), (WAVES, HANGS), (HANGS, (0.7, 0.4, 0.3, 2.4)),
    ((1.4, 0.5, 0, 0.1), HANGS), (HANGS, (1, 0.2, 0.4, 2.2)),
)  # fmt: skip
# each leg: forwards, outwards, knee
STANDS = (0, 0.05, 0)
LUNGES, KNEELS = ((1.2, 0.05, 1.2), (-0.4, 0.05, 0.8)), ((1.5, 0.1, 1.6), (0.1, 0.05, 1.6))
SITS, HALF_WAY = (1.5, 0.12, 1.5), (0.8, 0.1, 1.1)
CROUCHES, STEPS_ASIDE = (1.6, 0.3, 1.9), (0, 0.5, 0)
BODIES: tuple[dict[str, tuple[float, float, float]], ...] = (
    {}, dict(root=(0, 0.5, 0), left=CROUCHES, right=CROUCHES), dict(left=LUNGES[0], right=LUNGES[1]),
    dict(left=LUNGES[1], right=LUNGES[0]), dict(root=(0, 0.8, 0), chest=(0, 0.7, 0)),
    dict(root=(-0.15, 0, 0), chest=(-0.5, 0, 0)), dict(root=(0.15, 0, 0), chest=(0.5, 0, 0)),
    dict(chest=(0, 0, 0.7), neck=(0, 0, 0.3)), dict(chest=(0, 0, -0.7), neck=(0, 0, -0.3)), dict(left=(1.6, 0.1, 1.6)),
    dict(right=(1.6, 0.1, 1.6)), dict(left=STEPS_ASIDE, right=STEPS_ASIDE),
    dict(root=(0, 1.2, 0), right=(-1.2, 0.05, 0.1)), dict(left=KNEELS[0], right=KNEELS[1]),
    dict(left=(0.2, 0.1, 1.7), right=(0.2, 0.1, 1.7)),
    dict(root=(0.15, 0, 0), left=(0, 0.9, 0)), dict(neck=(0, 0.3, 0.6)),
)  # fmt: skip


def pose(root=(0, 0, 0), chest=(0, 0, 0), neck=(0, 0, 0), left=STANDS, right=STANDS, arms=ARMS[0]) -> Pose:
    """Turns of all segments from those of root, chest and neck (rotation vectors: x forward, y left, z up) and what
    arms and legs do; legs are told as the floor sees them, feet are level."""
    found = {name: Rotation.from_rotvec(turn) for name, turn in (("root", root), ("chest", chest), ("neck", neck))}
    for side, sign, (ahead, out, inwards, elbow), leg in (("l", 1, arms[0], left), ("r", -1, arms[1], right)):
        turned = Rotation.from_rotvec([0, 0, -sign * inwards])
        found[f"{side}_upper_arm"] = turned * _raised(ahead, sign * out)
        found[f"{side}_forearm"] = turned * _raised(elbow, 0) * turned.inv()
        found[f"{side}_thigh"] = found["root"].inv() * _raised(leg[0], sign * leg[1])
        found[f"{side}_shank"] = Rotation.from_rotvec([0, leg[2], 0])
        found[f"{side}_foot"] = Rotation.from_rotvec([0, leg[0] - leg[2], 0])
    return found


def _raised(ahead: float, out: float) -> Rotation:
    return Rotation.from_rotvec([out, 0, 0]) * Rotation.from_rotvec([0, -ahead, 0])


def sequence(poses: Sequence[Pose], between: np.ndarray, held: np.ndarray) -> Clip:
    """From pose to pose in so many seconds, each held for so many; the hips stay where they are."""
    turns: dict[str, list[Rotation]] = {name: [] for name in PARENT}
    for k, there in enumerate(poses):
        for name, turn in there.items():
            if k:
                share = np.linspace(0, 1, max(2, int(between[k] * RATE)) + 1)[1:]
                turns[name].append(turned(poses[k - 1][name], turn, share))
            turns[name].append(Rotation.concatenate([turn] * max(1, int(held[k] * RATE))))
    whole = {name: Rotation.concatenate(parts) for name, parts in turns.items()}
    return Clip(whole, np.zeros((len(whole["root"]), 3)))


def exercise(rng: np.random.Generator, from_standing: bool) -> Clip:
    """Eight poses of body and arms."""
    poses = [pose()] if from_standing else []
    while len(poses) < 8:
        poses.append(pose(**BODIES[rng.integers(len(BODIES))], arms=ARMS[rng.integers(len(ARMS))]))
    held = rng.uniform(0, 0.4, 8)
    held[0] = 0.7 if from_standing else 0.1
    return sequence(poses, rng.uniform(0.35, 0.9, 8), held)


def sitting(rng: np.random.Generator, all_the_time: bool) -> Clip:
    """Arms and the trunk move; else somebody sits down first and stands up in the end."""
    lean = rng.uniform(-0.15, 0.35, 6)
    poses = [pose((0, by, 0), left=SITS, right=SITS, arms=ARMS[rng.integers(len(ARMS))]) for by in lean]
    if not all_the_time:
        half_way = pose((0, 0.5, 0), left=HALF_WAY, right=HALF_WAY)
        poses = [pose(), half_way, *poses[:4], half_way, pose()]
    held = rng.uniform(0.1, 0.5, len(poses))
    held[0] = 0.7
    return sequence(poses, rng.uniform(0.5, 1, len(poses)), held)


def planted(vertices: np.ndarray, joints: np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and joints [frame, ., 3] moved level so that the foot that is lower does not slide."""
    ankles = joints[:, [names.index("l_ankle"), names.index("r_ankle")]]
    weight = np.exp(-(ankles[..., 2] - ankles[..., 2].min(1, keepdims=True)) / 0.05)
    weight /= weight.sum(1, keepdims=True)
    slid = np.einsum("fa,fai->fi", (weight[1:] + weight[:-1]) / 2, np.diff(ankles, axis=0))
    back = np.zeros((len(joints), 1, 3))
    back[1:, 0, :2] = -np.cumsum(slid, 0)[:, :2]
    return vertices + back.astype(np.float32), joints + back


def chair(
    vertices: np.ndarray, joints: np.ndarray, names: Sequence[str], with_back: bool
) -> list[tuple[float, float, tuple[float, float, float]]]:
    """Place and size of what is under who sits facing x: a box, and its back."""
    hips = joints[:, [names.index("l_hip"), names.index("r_hip")]].mean(1)
    lowest = int(np.argmin(hips[:, 2]))
    x, y = hips[lowest, :2]
    under = np.linalg.norm(vertices[lowest, :, :2] - [x + 0.05, y], axis=1) < 0.2
    height = max(0.2, float(vertices[lowest, under, 2].min()) - 0.01)
    seat = (x - 0.02, y, (0.42, 0.44, height))
    return [seat, (x - 0.27, y, (0.06, 0.44, height + 0.45))] if with_back else [seat]
