"""Rotations of tables of poses on the host: ends of limbs, turns of directions, SciPy rotations of quaternions wxyz."""

import numpy as np
from jaxtyping import Float, Float32
from scipy.spatial.transform import Rotation


def limb_ends(
    rotation: Float32[np.ndarray, "frame limb 4"],
    translation: Float32[np.ndarray, "frame limb 3"],
    lengths: Float[np.ndarray, " limb"],
) -> Float[np.ndarray, "2 frame limb 3"]:
    """Where both ends of every limb's axis are, metres."""
    return np.stack([translation, translation + lengths[None, :, None] * axis_of(rotation)])


def rotations(q: np.ndarray) -> Rotation:
    """Rotations of quaternions wxyz; NaN becomes the identity."""
    flat = q.reshape(-1, 4).astype(float)
    there = np.all(np.isfinite(flat), 1, keepdims=True)
    return Rotation.from_quat(np.where(there, flat, [1.0, 0, 0, 0]), scalar_first=True)


def axis_of(q: np.ndarray) -> np.ndarray:
    return rotations(q).apply([0.0, 0.0, 1.0]).reshape(*q.shape[:-1], 3)


def unit(v: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3"]:
    """Vectors of the length 1; zero stays zero."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)


def shortest_turns(a: Float[np.ndarray, "frame 3"], b: Float[np.ndarray, "frame 3"]) -> Rotation:
    """The shortest turns from some directions to others, of any length; opposite ones turn about any axis between."""
    a, b = unit(a), unit(b)
    axis, aside = np.cross(a, b), np.cross(a, np.where(np.abs(a[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = unit(np.where(sine > 1e-6, axis, aside))
    return Rotation.from_rotvec(axis * np.arctan2(sine, np.sum(a * b, 1, keepdims=True)))


def half_turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternions xyzw that turn unit vectors a halfway to b: by construction half of the smallest turn."""
    middle = a + b
    length = np.linalg.norm(middle, axis=-1, keepdims=True)
    middle = np.where(length > 1e-6, middle / np.maximum(length, 1e-6), a)
    w = 1 + np.sum(a * middle, -1, keepdims=True)
    q = np.concatenate([np.cross(a, middle), w], -1)
    return q / np.linalg.norm(q, axis=-1, keepdims=True)
