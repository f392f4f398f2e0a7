"""A simulated person with what the simulator does not have: a neck, key poses, feet that stay in their place."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import Body
from voodoo_jax.model.body_file import format_body, parse_body
from voodoo_jax.simulate.motion import Motion, eased, grounded, motion_of_turns, pose_body

RATE = 30.0  # frames per second
Pose = dict[str, tuple[float, float, float]]  # rotation vectors of joints about the body frame's axes, radians


def turned(*angles: tuple[str, float]) -> tuple[float, float, float]:
    """Rotation vector of turns about x, y, z one after the other, the last one first: ("y", -1.0), ("z", 0.5)."""
    whole = Rotation.identity()
    for axis, angle in angles:
        whole = whole * Rotation.from_euler(axis, angle)
    x, y, z = whole.as_rotvec().tolist()
    return x, y, z


def bend(angle: float) -> tuple[float, float, float]:
    """The limb swings forward."""
    return 0.0, -angle, 0.0


RELAXED: Pose = {"l_elbow": bend(0.15), "r_elbow": bend(0.15), "l_shoulder": (0.1, 0, 0), "r_shoulder": (-0.1, 0, 0)}
# not joints: "lean", the root about the middle of the hips; "at", how far it is from where it was, metres
SITTING = RELAXED | {
    "l_hip": bend(1.5), "r_hip": bend(1.5), "l_knee": bend(-1.45), "r_knee": bend(-1.45),
    "l_shoulder": turned(("y", -0.45)), "r_shoulder": turned(("y", -0.45)), "l_elbow": bend(0.9), "r_elbow": bend(0.9),
}  # fmt: skip
# half way down: over the feet
STOOPED = RELAXED | {
    "l_hip": bend(1.3), "r_hip": bend(1.3), "l_knee": bend(-1.1), "r_knee": bend(-1.1), "lean": (0, 0.5, 0),
    "l_ankle": bend(0.3), "r_ankle": bend(0.3), "l_shoulder": bend(0.6), "r_shoulder": bend(0.6),
}  # fmt: skip
CROUCHED = RELAXED | {
    "l_hip": bend(1.9), "r_hip": bend(1.9), "l_knee": bend(-2.1), "r_knee": bend(-2.1), "lean": (0, 0.45, 0),
    "l_ankle": bend(0.6), "r_ankle": bend(0.6), "l_shoulder": bend(0.9), "r_shoulder": bend(0.9),
}  # fmt: skip
RAISED: Pose = {"r_shoulder": turned(("x", -1.7), ("z", -np.pi / 2)), "r_elbow": bend(1.3)}
CROSSED = RELAXED | {
    "l_shoulder": turned(("y", -0.45), ("z", -1.2)), "r_shoulder": turned(("y", -0.75), ("z", 1.2)),
    "l_elbow": bend(1.75), "r_elbow": bend(1.75),
}  # fmt: skip
DRAWN = RELAXED | {"r_shoulder": bend(-0.4), "r_elbow": bend(2.1), "l_shoulder": bend(0.6), "l_elbow": bend(1.6)}
PUNCHED = DRAWN | {"r_shoulder": bend(1.5), "r_elbow": bend(0.1)}
SWORD_UP = RELAXED | {
    "l_shoulder": bend(2.5), "r_shoulder": bend(2.6), "l_elbow": bend(0.9), "r_elbow": bend(0.8),
    "lean": (0, -0.1, 0.3),
}  # fmt: skip
SWORD_DOWN = RELAXED | {
    "l_shoulder": turned(("y", -0.6), ("x", -0.4)), "r_shoulder": turned(("y", -0.7), ("x", 0.3)), "r_elbow": bend(0.2),
    "waist": (0, 0.35, -0.3), "lean": (0, 0.15, -0.4), "l_hip": bend(0.5), "l_knee": bend(-0.6), "r_hip": bend(-0.3),
}  # fmt: skip
SPREAD: Pose = {"l_shoulder": (1.5, 0, 0), "r_shoulder": (-1.5, 0, 0), "l_elbow": bend(0.1), "r_elbow": bend(0.1)}
LEG_ASIDE = SPREAD | {"l_hip": (0.7, 0, 0), "l_knee": bend(-0.3)}
HIGH: Pose = {"l_shoulder": (2.6, 0, 0), "r_shoulder": (-2.6, 0, 0), "l_elbow": bend(0.3), "r_elbow": bend(0.3)}
KNEES_BENT = RELAXED | {
    "l_hip": bend(0.9), "r_hip": bend(0.9), "l_knee": bend(-1.3), "r_knee": bend(-1.3), "lean": (0, 0.25, 0),
    "l_ankle": bend(0.5), "r_ankle": bend(0.5), "l_shoulder": bend(-0.6), "r_shoulder": bend(-0.6),
}  # fmt: skip
IN_THE_AIR = HIGH | {"at": (0, 0, 0.35)}
KICK_BACK = RELAXED | {"r_hip": bend(-0.45), "r_knee": bend(-0.9)}
KICKED = RELAXED | {"r_hip": bend(1.35), "r_knee": bend(-0.1)}


def posed(body: Body, keys: list[tuple[float, Pose]], ground: bool = False) -> Motion:
    """Through key poses: (seconds to get there, pose), the first at once. `ground`: both feet stay where they are."""
    ends = np.cumsum([seconds for seconds, _ in keys])
    time = np.arange(round(ends[-1] * RATE)) / RATE
    turns, still = {}, (0.0, 0.0, 0.0)
    for name in {name for _, pose in keys for name in pose}:
        value = np.tile(np.array(keys[0][1].get(name, still), float), (len(time), 1))
        for k, (_, pose) in enumerate(keys[1:], 1):
            share = eased(time, ends[k - 1], ends[k])[:, None]
            value += share * (np.array(pose.get(name, still)) - np.array(keys[k - 1][1].get(name, still)))
        turns[name] = value
    lean, at = turns.pop("lean", None), turns.pop("at", 0.0)
    motion = motion_of_turns(body, time, turns, lean=lean)
    return _moved(_on_its_feet(body, grounded(body, motion)) if ground else motion, at)


def turning(body: Body, angle: float, seconds: float) -> Motion:
    """Standing relaxed, turned in place by `angle` (radians, to the left)."""
    time = np.arange(round(seconds * RATE)) / RATE
    lean = eased(time, 0, seconds)[:, None] * np.array([0.0, 0.0, angle])
    turns = {name: np.tile(np.array(v), (len(time), 1)) for name, v in RELAXED.items()}
    return motion_of_turns(body, time, turns, lean=lean)


def running(body: Body, keys: list[tuple[float, float]]) -> Motion:
    """Through key speeds: (seconds to get there, metres per second), the first at once. Steps grow with the speed."""
    ends = np.cumsum([seconds for seconds, _ in keys])
    time = np.arange(round(ends[-1] * RATE)) / RATE
    speed = np.interp(time, ends, [metres for _, metres in keys])
    reach = np.minimum(speed / 6.0, 1.0)
    stride = 2 * np.pi * np.cumsum((0.8 + 0.16 * speed) * (speed > 0)) / RATE
    zero, turns = np.zeros_like(time), {}
    vector = lambda x, y, z: np.stack([x + zero, y + zero, z + zero], -1)  # noqa: E731
    for side, sign, phase in (("l", 1, stride), ("r", -1, stride + np.pi)):
        turns[f"{side}_hip"] = vector(0, -reach * (0.2 + 0.75 * np.sin(phase)), 0)
        turns[f"{side}_knee"] = vector(0, reach * (0.3 + 1.6 * np.maximum(np.cos(phase + 0.3), 0) ** 2), 0)
        turns[f"{side}_ankle"] = vector(0, 0.3 * reach * np.sin(phase), 0)
        turns[f"{side}_shoulder"] = vector(0.1 * sign, reach * 0.7 * np.sin(phase), 0)
        turns[f"{side}_elbow"] = vector(0, -0.15 - 1.3 * reach, 0)
    motion = grounded(body, motion_of_turns(body, time, turns, lean=vector(0, 0.22 * reach, 0)))
    return _moved(motion, vector(np.cumsum(speed) / RATE, 0, 0))


def _moved(motion: Motion, by: np.ndarray | float) -> Motion:
    """Moves the root, metres: [frame, 3]."""
    shift = jnp.asarray(by, jnp.float32)
    return replace(motion, root=Poses(motion.root.rotation, motion.root.translation + shift))


def _on_its_feet(body: Body, motion: Motion) -> Motion:
    """Moves the root level, so that the middle of the ankles stays in its place."""
    feet = [body.topology.limbs.index(n) for n in ("l_foot", "r_foot")]
    at = np.asarray(pose_body(body, motion.root, motion.rotations).translation, float)[:, feet].mean(1)
    shift = (at[0] - at) * [1, 1, 0]
    return replace(motion, root=Poses(motion.root.rotation, motion.root.translation + jnp.asarray(shift, jnp.float32)))


def with_neck(body: Body) -> Body:
    """The body with a neck: it is the tracker's own else, and its head hangs in the air."""
    low, high, joint = 0.785, 0.87, 0.81  # of the stature
    neck = f"""
[[limb]]
name = "throat"
bottom = [0.0, 0.0, {low}]
top = [0.006, 0.0, {high}]
bottom_axes = [0.033, 0.033]
top_axes = [0.032, 0.032]
[[joint]]
name = "throat"
parent = "chest"
child = "throat"
at = [0.0, 0.0, {joint}]
axes = [0.0, 0.0]
"""
    return parse_body(format_body(body) + neck, "with a neck")
