"""Distances of points from limbs, on the host: of every point and limb, where kernels.frustum has one of each."""

import numpy as np
from jaxtyping import Float, Float32


def signed_distance(
    size: Float[np.ndarray, "*limb 5"], points: Float[np.ndarray, "*point 3"]
) -> Float[np.ndarray, "*point"]:
    """Distances of points, in limb frames, from limbs with flat caps, metres; inside negative and to the side.

    Across the limb by the ratio of its ellipse: exact on its surface and for round limbs.

    **Arguments:** `size` of one limb, or of several, as can be broadcast to the points.
    """
    a0, b0, a1, b1, length = np.moveaxis(size, -1, 0)
    x, y, z = np.moveaxis(points, -1, 0)
    along = np.clip(z / np.maximum(length, 1e-6), 0, 1)
    a, b = a0 + (a1 - a0) * along, b0 + (b1 - b0) * along
    off, ratio = np.hypot(x, y), np.hypot(x / a, y / b)
    across = np.where(ratio > 0, off * (1 - 1 / np.maximum(ratio, 1e-6)), -np.minimum(a, b))
    beyond = np.maximum(np.maximum(-z, z - length), 0)
    return np.where(beyond > 0, np.hypot(np.maximum(across, 0), beyond), across)


def body_distance(
    sizes: Float32[np.ndarray, "limb 5"],
    rotation: Float32[np.ndarray, "limb 4"],
    translation: Float32[np.ndarray, "limb 3"],
    points: Float32[np.ndarray, "point 3"],
    most: float = np.inf,
) -> Float[np.ndarray, " point"]:
    """Distances of points from the surface of the nearest limb, inside or outside, metres; at most `most`.

    **Arguments:** `rotation`, `translation` of the limbs, unit quaternions wxyz and metres; limbs without a pose are
    left out.
    """
    out = np.full(len(points), min(most, 1e3))
    there = np.isfinite(translation).all(-1)
    if not there.any() or not len(points):
        return out
    reach = min(most, 1e3) + float(np.max(sizes))  # a limb is no longer than the longest
    low, high = np.min(translation[there], 0) - reach, np.max(translation[there], 0) + reach
    near = np.flatnonzero(np.all((points > low) & (points < high), 1))
    some = points[near]
    best = out[near]
    for limb in np.flatnonzero(there):
        best = np.minimum(best, np.abs(signed_distance(sizes[limb], _into(rotation[limb], some - translation[limb]))))
    out[near] = best
    return out


def _into(turn: Float32[np.ndarray, "4"], v: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, "point 3"]:
    """Vectors in a limb's frame; `turn` unit quaternion wxyz of the limb."""
    w, axis = turn[0], turn[1:]
    twice = 2 * np.cross(-axis, v)
    return v + w * twice + np.cross(-axis, twice)
