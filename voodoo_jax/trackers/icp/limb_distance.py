"""How far points are from a limb, on the host: every point and limb, where kernels.frustum has one of each."""

import numpy as np
from jaxtyping import Float


def signed_distance(size: Float[np.ndarray, "5"], points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, " point"]:
    """From the surface of a limb with flat caps to points in its frame, metres; negative inside, to the side there.

    Across the limb by the ratio of its ellipse: exact on its surface and for round limbs.
    """
    a0, b0, a1, b1, length = size
    x, y, z = points.T
    along = np.clip(z / max(length, 1e-6), 0, 1)
    a, b = a0 + (a1 - a0) * along, b0 + (b1 - b0) * along
    off, ratio = np.hypot(x, y), np.hypot(x / a, y / b)
    across = np.where(ratio > 0, off * (1 - 1 / np.maximum(ratio, 1e-6)), -np.minimum(a, b))
    beyond = np.maximum(np.maximum(-z, z - length), 0)
    return np.where(beyond > 0, np.hypot(np.maximum(across, 0), beyond), across)
