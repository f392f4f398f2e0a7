"""Finds planes in depth images (floor, walls, tables), which show the kind of its values. Host side, NumPy.

On a plane the inverse depth is linear in pixel coordinates. For distances along the ray instead of along the optical
axis, this holds only after conversion to depths.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

SOME = 1500  # pixels that are looked at; by hand
TELLING = 100  # pixels or points with data, that suffice to show something; by hand
PLANES, TRIALS = 3, 100  # that are looked for one after the other, and draws for each; by hand
NEAR = 0.01  # of the distance: so near to a plane a pixel is on it, with the noise of depth cameras; by hand
WIDE = 0.08  # share of the pixels that make a plane; by hand
CLEARLY = 1.3  # times as many pixels on planes one way as the other, at least; by hand
FLAT = 0.25  # share of the pixels on planes, at least, that tells something; by hand


class Planes(NamedTuple):
    """The planes of an image, the one with the most pixels first, in the sensor's optical frame."""

    normals: Float[np.ndarray, "plane 3"]  # unit vectors, towards the sensor
    distances: Float[np.ndarray, " plane"]  # of the sensor from it, in the image's unit
    shares: Float[np.ndarray, " plane"]  # of the pixels


def planes(ways: Float[np.ndarray, "pixel 3"], depth: Float[np.ndarray, " pixel"]) -> Planes:
    """Planes of the points `depth` times `ways` (to a depth of 1), by random samples."""
    rng = np.random.default_rng(0)
    left, inverse = np.arange(len(depth)), 1 / depth
    normals, distances, shares = [], [], []
    for _ in range(PLANES):
        if len(left) < WIDE * len(depth) or len(left) < 3:
            break
        x, y = ways[left], inverse[left]
        picked = rng.integers(0, len(left), (TRIALS, 3))
        corners = x[picked]
        good = np.abs(np.linalg.det(corners)) > 1e-4
        if not good.any():
            break
        found = np.linalg.solve(corners[good], y[picked[good]][..., None])[..., 0]
        on = np.abs(found @ x.T - y) < NEAR * y
        best = on[int(on.sum(1).argmax())]
        plane = found[0]
        for _ in range(2):
            if best.sum() < 3:
                break
            plane = np.linalg.lstsq(x[best], y[best], rcond=None)[0]
            best = np.abs(x @ plane - y) < NEAR * y
        if best.sum() < max(3, WIDE * len(depth)):
            break
        length = float(np.linalg.norm(plane))
        normals.append(-plane / length)
        distances.append(1 / length)
        shares.append(best.sum() / len(depth))
        left = left[~best]
    return Planes(np.array(normals).reshape(-1, 3), np.array(distances), np.array(shares))


def seen_pixels(
    xy: Float[np.ndarray, "row column 2"], image: Float[np.ndarray, "row column"]
) -> tuple[Float[np.ndarray, "pixel 3"], Float[np.ndarray, " pixel"]]:
    """Ways to a depth of 1, and the values, of some of the pixels that have one."""
    value = image.ravel().astype(float)
    there = np.flatnonzero(np.isfinite(value) & (value > 0))
    there = there[:: len(there) // SOME + 1]
    flat = xy.reshape(-1, 2)[there]
    fine = np.isfinite(flat).all(1)
    return np.column_stack([flat, np.ones(len(flat))])[fine], value[there][fine]


def flat_share(xy: Float[np.ndarray, "row column 2"], image: Float[np.ndarray, "row column"]) -> tuple[float, bool]:
    """Share of an image's pixels that lie on its larger planes, and whether its values are distances along the rays:
    only the right interpretation has planes. Brightness and confidence have none."""
    ways, value = seen_pixels(xy, image)
    if len(value) < TELLING:
        return 0.0, False
    depth, ray = (planes(ways, v).shares for v in (value, value / np.linalg.norm(ways, axis=1)))
    along = ray.sum() > max(FLAT, CLEARLY * depth.sum()) and ray[0] > CLEARLY * depth.max(initial=0)
    return float(ray.sum() if along else depth.sum()), bool(along)
