"""A simulated person with what the simulator does not have: a neck, key poses, feet that stay in their place."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from voodoo_jax.body import Body
from voodoo_jax.io.body_file import format_body, parse_body
from voodoo_jax.pose import Poses
from voodoo_jax.simulate import Motion, _ease, _grounded, _motion, pose_body

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
# "lean" is not a joint: the root about the middle of the hips
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
            share = _ease(time, ends[k - 1], ends[k])[:, None]
            value += share * (np.array(pose.get(name, still)) - np.array(keys[k - 1][1].get(name, still)))
        turns[name] = value
    lean = turns.pop("lean", None)
    motion = _motion(body, time, turns, lean=lean)
    return _on_its_feet(body, _grounded(body, motion)) if ground else motion


def turning(body: Body, angle: float, seconds: float) -> Motion:
    """Standing relaxed, turned in place by `angle` (radians, to the left)."""
    time = np.arange(round(seconds * RATE)) / RATE
    lean = _ease(time, 0, seconds)[:, None] * np.array([0.0, 0.0, angle])
    turns = {name: np.tile(np.array(v), (len(time), 1)) for name, v in RELAXED.items()}
    return _motion(body, time, turns, lean=lean)


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
