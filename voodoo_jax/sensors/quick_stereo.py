"""Depth from a rectified pair of images in an eighth of the time that `stereo_matching` takes: semi-global matching
once, of every pair of rows as one, Lucas-Kanade steps to fractions of a pixel, no search for sharp edges.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from voodoo_jax.sensors.disparity import NOWHERE, Grey, Pixels, at_edges, brightness, refined

EVERY = 2  # by hand: rows and columns: each second one is refined and given
_BLOCK = 3  # pixels, with half of the rows: smaller than in stereo_matching, or arms are lost; by hand
_ALIKE, _NEIGHBOURS = 0.5, 5  # pixels of disparity, and how many of eight neighbours: by hand
_STEP = 16  # disparities come in so many, by OpenCV


def quick_depth(
    left: UInt8[np.ndarray, "row column 3"],
    right: UInt8[np.ndarray, "row column 3"],
    focal_baseline: float,
    shift: float,
    nearest: float,
    window: tuple[int, int, int, int] | None = None,
) -> Float32[np.ndarray, "some_row some_column"]:
    """Depth of every second row and column of the left image, metres; 0 where unknown.

    **Arguments:** `focal_baseline` pixels times metres; `shift` see Rig; `nearest` metres: what is nearer is not found;
    `window` the first row and column of the left image that are looked at, and those behind the last; None: all.
    """
    least = int(np.floor(-shift))
    most = min(focal_baseline / max(nearest, 1e-3), left.shape[1] / 5) - shift
    count = max(_STEP, int(np.ceil((most - least) / _STEP)) * _STEP)
    if window is None:
        return _depth(left, right, focal_baseline, shift, least, count)
    v0, u0, v1, u1 = window
    # as many columns more as the right image is shifted by: what has no partner there is not found
    v0, u0 = (max(at, 0) // EVERY * EVERY for at in (v0, u0 - least - count))
    z = _depth(left[v0:v1, u0:u1], right[v0:v1, u0:u1], focal_baseline, shift, least, count)
    out = np.zeros([-(-size // EVERY) for size in left.shape[:2]], np.float32)
    out[v0 // EVERY :, u0 // EVERY :][: z.shape[0], : z.shape[1]] = z
    return out


# 6 parameters: those of `quick_depth`
def _depth(
    left: np.ndarray, right: np.ndarray, focal_baseline: float, shift: float, least: int, count: int
) -> Float32[np.ndarray, "some_row some_column"]:
    """`quick_depth` with `count` disparities from `least` on."""
    grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in (left, right)]
    d = quick_disparity(grey[0], grey[1], shift, least, count)
    return np.where(d > 0, focal_baseline / np.where(d > 0, d, 1.0), 0.0).astype(np.float32)


def quick_disparity(  # 6 parameters: those of `quick_depth`
    left: Grey, right: Grey, shift: float, least: int, count: int, narrow: int = 1
) -> Float32[np.ndarray, "some_row some_column"]:
    """Disparities of every second row and column plus `shift`, of `count` from `least` on; 0 where unknown. `narrow`:
    the factor by which fewer columns are matched, which is coarser."""
    grey = [cv2.GaussianBlur(image, (0, 0), 1.0) for image in (left, right)]
    raw = _matched(grey[0], grey[1], least, count, narrow)
    gain, offset = brightness(grey[0], grey[1], raw)
    fine = refined(grey[0].astype(np.float32), gain * grey[1].astype(np.float32) + np.float32(offset), raw, EVERY)
    some = raw[::EVERY, ::EVERY]
    d = fine + shift
    good = (some > NOWHERE) & (np.abs(fine - some) <= 1.5) & ~at_edges(raw, 1)[::EVERY, ::EVERY] & (d > 0.5)
    return np.where(_supported(np.where(good, d, NOWHERE)), d, np.float32(0))


def _matched(left: Grey, right: Grey, least: int, count: int, narrow: int) -> Pixels:
    """Disparities by semi-global matching of images with half of the rows, in half of the time; with half of the
    columns too, it would be coarser than limbs are (3.6 cm instead of 3.46). NOWHERE where unknown."""
    across, down = 1 / narrow, 1 / EVERY
    low = [cv2.resize(image, None, fx=across, fy=down, interpolation=cv2.INTER_AREA) for image in (left, right)]
    least, count = least // narrow, -(-count // (_STEP * narrow)) * _STEP
    matcher = cv2.StereoSGBM.create(
        minDisparity=least, numDisparities=count, blockSize=_BLOCK, P1=8 * _BLOCK**2, P2=32 * _BLOCK**2,
        disp12MaxDiff=1, uniquenessRatio=5, speckleWindowSize=50, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    raw = matcher.compute(low[0], low[1]).astype(np.float32) / 16
    raw = np.where(raw >= least, raw * narrow, NOWHERE).astype(np.float32)
    return np.asarray(cv2.resize(raw, left.shape[::-1], interpolation=cv2.INTER_NEAREST))


def _supported(d: Float32[np.ndarray, "row column"]) -> Bool[np.ndarray, "row column"]:
    """Whether enough neighbours of a pixel have nearly its disparity: edges of legs before a floor cause speckles."""
    alike = np.zeros(d.shape, np.uint8)
    padded = np.pad(d, 1, constant_values=NOWHERE)
    rows, columns = d.shape
    for dv, du in ((0, 1), (0, 0), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1), (2, 2)):
        alike += np.abs(padded[dv : dv + rows, du : du + columns] - d) < _ALIKE
    return (alike >= _NEIGHBOURS) & (d > NOWHERE)
