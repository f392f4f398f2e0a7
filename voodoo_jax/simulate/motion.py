"""Motions of any body: rotations of the joints and a pose of the root over time, forward kinematics."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Float32, Float64
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rigid import Poses, apply, compose, inverse, quat_exp, quat_multiply, unrotate
from voodoo_jax.model.body import Body, tree_order

MOTIONS = ("stand", "wave", "bow", "walk", "swing")


# Motion: rotations of the joints and a pose of the root over time
@dataclass(frozen=True)
class Motion:
    """A body's motion. `root` is T_body_root from the functions here, T_fixed_root after `placed`."""

    time: Float64[np.ndarray, " frame"]  # seconds from the start
    root: Poses  # [frame] of limb 0, metres
    rotations: Float[np.ndarray, "frame joint 3"]  # rotation vectors in the joints' frames, radians; zero: rest pose

    def __len__(self) -> int:
        return len(self.time)


def pose_body(body: Body, root: Poses, rotations: Float[np.ndarray, "*frame joint 3"]) -> Poses:
    """Forward kinematics: poses [*frame, limb] in the frame of `root` [*frame]; NumPy, leading axes are free.

    Each child is hung on its parent with the two anchors together, turned by the joint's rotation vector (radians, in
    the joint's frame). All rotations zero gives the rest pose if the anchors coincide in it.
    """
    # not JAX: compiled for the CPU, the chain of quaternion products is fused without end (minutes)
    t = body.topology
    rotations = np.asarray(rotations, np.float64)
    turns = Rotation.from_rotvec(rotations.reshape(-1, 3)).as_matrix().reshape(*rotations.shape, 3)
    (parent_turn, parent_at), (child_turn, child_at) = as_arrays(body.parent_anchor), as_arrays(body.child_anchor)
    found = {0: as_arrays(root)}
    for j in tree_order(t):
        turn, at = found[t.parents[j]]
        at = at + turn @ parent_at[j]
        turn = turn @ parent_turn[j] @ turns[..., j, :, :] @ child_turn[j].T
        found[t.children[j]] = turn, at - turn @ child_at[j]
    turns, places = (np.stack([found[i][k] for i in range(len(t.limbs))], -2 - (k == 0)) for k in (0, 1))
    quaternions = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_quat(scalar_first=True, canonical=True)
    return Poses(jnp.asarray(quaternions.reshape(*turns.shape[:-2], 4), jnp.float32), jnp.asarray(places, jnp.float32))


def make_motion(body: Body, name: str, seconds: float = 3.0, rate: float = 30.0) -> Motion:
    """One of MOTIONS at `rate` frames per second, in the body frame; starts and ends in the relaxed pose.

    "swing" moves every joint of any body about its free axes; the others turn the joints of a person that the body has,
    by name. Raises ValueError for an unknown name.
    """
    time = np.arange(round(seconds * rate)) / rate
    if name == "swing":
        return motion_of_turns(body, time, {}, _swing_rotations(body, time))
    one, zero = np.ones_like(time), np.zeros_like(time)
    window = eased(time, 0, min(0.7, seconds / 3)) * (1 - eased(time, seconds - min(0.7, seconds / 3), seconds))
    vector = lambda x, y, z: np.stack([x * one, y * one, z * one], -1)  # noqa: E731
    bend = lambda angle: vector(0, -angle, 0)  # noqa: E731  limb swings forward, about the axis to the right
    mix = lambda relaxed, target: relaxed + window[:, None] * (target - relaxed)  # noqa: E731
    # relaxed: arms slightly off the trunk, elbows slightly bent
    turns = {"l_elbow": bend(0.15), "r_elbow": bend(0.15)}
    turns |= {"l_shoulder": vector(0.1, 0, 0), "r_shoulder": vector(-0.1, 0, 0)}
    if name == "stand":
        return motion_of_turns(body, time, turns)
    if name == "wave":
        # upper arm to the side, turned about itself so that the bent elbow points the forearm up
        lifted = (Rotation.from_rotvec([-1.7, 0, 0]) * Rotation.from_rotvec([0, 0, -np.pi / 2])).as_rotvec()
        turns["r_shoulder"] = mix(turns["r_shoulder"], vector(*lifted))
        turns["r_elbow"] = mix(turns["r_elbow"], bend(1.2 + 0.4 * np.sin(2 * np.pi * 1.5 * time)))
        return motion_of_turns(body, time, turns)
    if name == "bow":
        angle = 0.75 * window
        share = 0.5 if "waist" in body.topology.joints else 1.0  # of the pelvis; the waist does the rest
        turns |= {"waist": bend(-(1 - share) * angle), "neck": bend(-0.3 * angle)}
        turns |= {"l_hip": bend(share * angle), "r_hip": bend(share * angle)}
        turns["l_shoulder"] = turns["l_shoulder"] + bend(0.9 * angle)
        turns["r_shoulder"] = turns["r_shoulder"] + bend(0.9 * angle)
        return grounded(body, motion_of_turns(body, time, turns, lean=bend(-share * angle)))
    if name == "walk":
        for side, phase in (("l", 0.0), ("r", np.pi)):
            stride = 2 * np.pi * 0.9 * time + phase
            hip = 0.05 + 0.42 * np.sin(stride)
            knee = 0.12 + 0.75 * np.maximum(np.cos(stride + 0.3), 0) ** 2  # bends while the leg comes forward
            turns[f"{side}_hip"], turns[f"{side}_knee"] = bend(window * hip), bend(-window * knee)
            turns[f"{side}_ankle"] = bend(window * 0.6 * np.clip(knee - hip, -0.3, 0.3))
            turns[f"{side}_shoulder"] = turns[f"{side}_shoulder"] + bend(-window * 0.35 * np.sin(stride))
            turns[f"{side}_elbow"] = bend(0.15 + 0.2 * window)
        return grounded(body, motion_of_turns(body, time, turns, lean=vector(zero, 0.06 * window, zero)), rolling=True)
    raise ValueError(f"no motion named '{name}'; there are {', '.join(MOTIONS)}")


def sequence(*motions: Motion) -> Motion:
    """Motions of one body one after the other; each starts where the one before it ended. At least one."""
    time, root, rotations = [motions[0].time], [motions[0].root], [motions[0].rotations]
    for motion in motions[1:]:
        step = motion.time[1] - motion.time[0] if len(motion) > 1 else 1 / 30
        time.append(motion.time + time[-1][-1] + step)
        root.append(compose(compose(root[-1][-1], inverse(motion.root[0])), motion.root))
        rotations.append(motion.rotations)
    joined = Poses(*(jnp.concatenate(x) for x in zip(*((p.rotation, p.translation) for p in root))))
    return Motion(np.concatenate(time), joined, np.concatenate(rotations))


def placed(motion: Motion, x: float, y: float, yaw: float) -> Motion:
    """The motion of a body that stands at x, y (metres) in the fixed frame and faces `yaw` (radians from +x to +y)."""
    place = Poses(quat_exp(jnp.array([0.0, 0.0, yaw])), jnp.array([x, y, 0.0]))
    return replace(motion, root=compose(place, motion.root))


def eased(t, start: float, end: float):
    s = np.clip((t - start) / max(end - start, 1e-9), 0, 1)
    return s * s * (3 - 2 * s)


def motion_of_turns(body: Body, time, turns: Mapping[str, np.ndarray], rotations=None, lean=None) -> Motion:
    """From rotation vectors about the body frame's axes; `lean` [frame, 3] turns the root about the hips' middle."""
    t, count = body.topology, len(time)
    rotations = np.zeros((count, len(t.joints), 3), np.float32) if rotations is None else rotations
    for j, name in enumerate(t.joints):
        if name in turns:
            frame = quat_multiply(body.rest.rotation[t.parents[j]], body.parent_anchor.rotation[j])
            rotations[:, j] = np.asarray(unrotate(frame, jnp.asarray(turns[name], jnp.float32)))
    lean = np.zeros((count, 3), np.float32) if lean is None else lean
    hips = [j for j, name in enumerate(t.joints) if name in ("l_hip", "r_hip")]
    at = [apply(body.rest[t.parents[j]], body.parent_anchor.translation[j]) for j in hips] or [jnp.zeros(3)]
    pivot = jnp.mean(jnp.stack(at), 0)
    turn = Poses(quat_exp(jnp.asarray(lean, jnp.float32)), jnp.broadcast_to(pivot, (count, 3)))
    return Motion(time, compose(compose(turn, Poses(jnp.array([1.0, 0, 0, 0]), -pivot)), body.rest[0]), rotations)


def _swing_rotations(body: Body, time) -> Float32[np.ndarray, "frame joint 3"]:
    """Universal joints turn about all axes, hinges about their ellipse's axis, elliptic (stiff) ones a little."""
    axes = np.asarray(body.axes) > 0
    free = np.where(axes.any(1, keepdims=True), np.concatenate([axes, np.zeros_like(axes[:, :1])], 1), True)
    amplitude = np.where(axes.all(1), 0.12, np.where(axes.any(1), 0.5, 0.3))[:, None] * free
    # golden ratio: no two joints or axes in step
    phase = 2 * np.pi * ((np.arange(amplitude.size) * 0.6180339887) % 1).reshape(amplitude.shape)
    wave = np.sin(2 * np.pi * 0.4 * time[:, None, None] + phase) * eased(time, 0, 0.7)[:, None, None]
    return (amplitude * wave).astype(np.float32)


def grounded(body: Body, motion: Motion, rolling: bool = False) -> Motion:
    """Moves the root up or down so that the lowest point stays at its height in the rest pose.

    rolling: also forward, so that the lowest limb end does not slide over the floor.
    """
    ends, heights = _limb_ends(body, pose_body(body, motion.root, motion.rotations))
    _, rest_heights = _limb_ends(body, body.rest)
    shift = np.zeros((len(motion), 3))
    shift[:, 2] = rest_heights.min() - heights.min(-1)
    if rolling:
        low, frames = heights.argmin(-1), np.arange(len(motion) - 1)
        # never backwards: a person who stops draws the rear leg up
        shift[1:, 0] = np.cumsum(np.maximum(ends[frames, low[:-1], 0] - ends[frames + 1, low[:-1], 0], 0))
    root = Poses(motion.root.rotation, motion.root.translation + jnp.asarray(shift, jnp.float32))
    return replace(motion, root=root)


def _limb_ends(body: Body, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Centres [..., 2 limb, 3] of all end ellipses and the height of each ellipse's lowest point [..., 2 limb]."""
    sizes, (rotation, translation) = np.asarray(body.sizes, np.float64), as_arrays(poses)
    top = translation + rotation[..., 2] * sizes[:, 4:]
    drop = lambda a, b: np.hypot(a * rotation[..., 2, 0], b * rotation[..., 2, 1])  # noqa: E731
    heights = [translation[..., 2] - drop(sizes[:, 0], sizes[:, 1]), top[..., 2] - drop(sizes[:, 2], sizes[:, 3])]
    return np.concatenate([translation, top], -2), np.concatenate(heights, -1)


def as_arrays(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Rotation matrices [..., 3, 3] and translations [..., 3] in float64."""
    q = np.asarray(poses.rotation, np.float64)
    matrix = Rotation.from_quat(q.reshape(-1, 4), scalar_first=True).as_matrix()
    return matrix.reshape(*q.shape[:-1], 3, 3), np.asarray(poses.translation, np.float64)
