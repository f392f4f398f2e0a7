"""Edges of depth images that a camera's own filters have smeared, as against sharp ones, and the points in them. NumPy.

Stereo cameras smooth their depth: between a person and the wall behind them there is a sheet of points that nothing
is at, which joins both. A sharp edge has at most a pixel or two of them (flying pixels).
"""

import numpy as np
from jaxtyping import Bool, Float32

WIDE = 10  # pixels across which an edge is looked at; measured: smeared ones of a RealSense D435 are 8 to 14 wide
JUMP, FARTHEST = 0.3, 6.0  # metres: a depth edge, and how far it is at most, for noise is less than that there; by hand
EDGES = 300  # pixels at edges, to tell; by hand
BETWEEN = 0.15  # of the jump from either side: what is there is neither the one thing nor the other; by hand
SMEARED = 0.3  # of the pixels across an edge are between; measured: D435 0.66, simulated cameras below 0.03
# pixels to either side along which a slope is taken: the camera's filters leave pixels alike in twos; measured
STEP = 2
STEEP = float(
    np.tan(np.radians(78))
)  # a surface seen so obliquely, or a sheet; measured: 75 degrees does alike, 82 not
REACH = 48  # pixels to either side: a plane is as oblique up to there, and a sheet has ended; by hand


def between_edges(depth: Float32[np.ndarray, "row column"]) -> float:
    """Mean share of the pixels across a depth edge that lie between its two sides; 0 where there are too few edges.

    **Arguments:** `depth` of all pixels, metres; 0 or NaN: nothing seen.
    """
    edges, between = 0, 0.0
    for z in (depth, depth.T):
        if z.shape[1] <= 3 * WIDE:
            continue
        outer, side, other, behind = (z[:, k * WIDE : z.shape[1] + (k - 3) * WIDE] for k in range(4))
        with np.errstate(invalid="ignore"):
            jump = np.abs(other - side)
            flat = (np.abs(side - outer) < jump / 3) & (np.abs(behind - other) < jump / 3)
            seen = (outer > 0) & (side > 0) & (other > 0) & (behind > 0) & (np.minimum(side, other) < FARTHEST)
        row, column = np.nonzero((jump > JUMP) & flat & seen)
        column += WIDE
        if not len(row):
            continue
        across = z[row[:, None], column[:, None] + np.arange(1, WIDE)]
        begin, end = z[row, column][:, None], z[row, column + WIDE][:, None]
        share = (across - begin) / (end - begin)
        one_way = (np.diff(share, axis=1) > -BETWEEN).all(1)  # noise goes back and forth
        inside = (across > 0) & (share > BETWEEN) & (share < 1 - BETWEEN)
        edges, between = edges + int(one_way.sum()), between + float(inside.mean(1)[one_way].sum())
    return between / edges if edges >= EDGES else 0.0


def on_sheets(depth: Float32[np.ndarray, "row column"], angle: float, every: int) -> Bool[np.ndarray, "row column"]:
    """True for pixels in a smeared edge: steeper than visible surfaces, and soon at an end. A floor or a wall at the
    same angle continues: the inverse of its depth is linear in the image.

    **Arguments:** `depth` metres, of each `every`-th row and column; 0 or NaN: no measurement; `angle` between these
    rows, radians.
    """
    z = np.where(depth > 0, depth, np.float32(np.nan))
    near, far = max(1, round(STEP / every)), round(REACH / every)
    slopes, ended = [], []
    with np.errstate(invalid="ignore"):
        for a in (z, z.T):
            back, on = _shifted(a, -near), _shifted(a, near)
            reached = np.abs(1 / _shifted(a, far) - 1 / _shifted(a, -far))
            slope = np.abs(on - back)
            goes_on = reached > slope / (back * on) * np.float32(far / near / 2)
            slopes.append(np.nan_to_num(slope, copy=False))
            ended.append(~goes_on)
        across, down = slopes[0], slopes[1].T
        steep = np.hypot(across, down) > np.float32(2 * near * STEEP * angle) * z
        return steep & np.where(across > down, ended[0], ended[1].T)


def _shifted(z: Float32[np.ndarray, "row column"], by: int) -> Float32[np.ndarray, "row column"]:
    """For each pixel, the one that many columns further on; NaN beyond the border."""
    out = np.full(z.shape, np.float32(np.nan))
    if by > 0:
        out[:, :-by] = z[:, by:]
    else:
        out[:, -by:] = z[:, :by]
    return out
