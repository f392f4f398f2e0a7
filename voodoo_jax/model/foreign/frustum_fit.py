"""The tapered elliptic cylinder nearest to a surface."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

SIDE = 0.7  # cosine of 45 degrees: faces that look along the axis by more are ends
FEW = 30  # points on the sides below which all are taken for sides
THIN = 0.003  # metres: no semi-axis is smaller
OUTLIERS = 0.01  # metres from which a point counts less (soft L1): handles, screws, cables
PREFERRED = 0.8  # what a named direction's distance counts: of two that fit alike the joints' own is taken


class Frustum(NamedTuple):
    """Centres of both end ellipses, directions and sizes of their axes, and the distance of the surface; metres."""

    bottom: Float[np.ndarray, "3"]
    top: Float[np.ndarray, "3"]
    x_axis: Float[np.ndarray, "3"]
    bottom_axes: Float[np.ndarray, "2"]
    top_axes: Float[np.ndarray, "2"]
    off: float  # root mean square


def fit_frustum(
    points: Float[np.ndarray, "point 3"], normals: Float[np.ndarray, "point 3"], hints: Iterable[np.ndarray] = ()
) -> Frustum:
    """The frustum nearest to points that are evenly spread over a surface, along one of its principal directions or of
    `hints`, such as the line between two joints."""
    own = np.linalg.svd(points - points.mean(0), full_matrices=False)[2]
    named = [hint / np.linalg.norm(hint) for hint in hints if np.linalg.norm(hint) > THIN]
    found = [(PREFERRED, _along(points, normals, axis)) for axis in named]
    found += [(1.0, _along(points, normals, axis)) for axis in own]
    return min(found, key=lambda one: one[0] * one[1].off)[1]


def _along(points: np.ndarray, normals: np.ndarray, z: np.ndarray) -> Frustum:
    """Ends at the extremes along z; centres and axes of both ellipses by least squares on the sides."""
    along = points @ z
    low, high = float(along.min()), max(float(along.max()), float(along.min()) + 2 * THIN)
    across = points - np.outer(along, z)
    middle = across.mean(0)
    x = np.linalg.svd(across - middle, full_matrices=False)[2][0]
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    flat = np.stack([(across - middle) @ x, (across - middle) @ y], 1)
    share = (along - low) / (high - low)
    side = np.abs(normals @ z) < SIDE
    side = side if side.sum() >= FEW else np.ones(len(points), bool)
    # points on an ellipse have half of its squared semi-axis as mean square
    first = np.log(np.maximum(np.sqrt(2) * flat[side].std(0), THIN))
    start = np.concatenate([np.zeros(4), first, first])

    def gaps(p: np.ndarray, of: np.ndarray = side) -> np.ndarray:
        s = share[of][:, None]
        centre, axes = p[:2] + (p[2:4] - p[:2]) * s, _between(p, s)
        return (np.linalg.norm((flat[of] - centre) / axes, axis=1) - 1) * axes.mean(1)

    p = least_squares(gaps, start, loss="soft_l1", f_scale=OUTLIERS).x
    ends = np.minimum(along - low, high - along)[~side]
    off = float(np.sqrt(np.mean(np.concatenate([gaps(p), ends]) ** 2)))
    at = lambda centre, height: middle + centre[0] * x + centre[1] * y + height * z  # noqa: E731
    return Frustum(at(p[:2], low), at(p[2:4], high), x, np.exp(p[4:6]), np.exp(p[6:8]), off)


def _between(p: np.ndarray, share: np.ndarray) -> np.ndarray:
    first, last = np.maximum(np.exp(p[4:6]), THIN), np.maximum(np.exp(p[6:8]), THIN)
    return first + (last - first) * share
