"""Depth from a rectified pair of images in an eighth of the time that `stereo_matching` takes: semi-global matching
once, of every pair of rows as one, Lucas-Kanade steps to fractions of a pixel, no search for sharp edges.

Disparities of block matching are made sharp at edges, agreed on, to fractions of a pixel, for both: Lucas and Kanade
1981; the images' disparities against each other: Hirschmueller 2008, doi:10.1109/TPAMI.2007.1166.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from voodoo_jax.geometry.robust import geman_mcclure

Grey = UInt8[np.ndarray, "row column"]
Pixels = Float32[np.ndarray, "row column"]  # grey levels, or disparities: columns to the left in the right image
NOWHERE = -1000.0  # pixels: the disparity of what is not found
STEP = 1.5  # pixels of disparity between neighbours that make an edge
AROUND = (4, 12, 30)  # pixels, within which another disparity is looked for beside edges
OWN = 0.9  # of what a pixel's own disparity costs: what another one has to be below
DARKEST, BRIGHTEST = 8, 247  # grey levels: beyond, a camera is at its limits
SOME = 4  # of so many pixels each way one is asked how bright it is
OUTLIER = 20.0  # grey levels, of 255, beyond which a difference says nothing
AGREE = 1.5  # pixels of disparity by which both images' may differ
STEPS = 4  # of Lucas and Kanade
EVERY = 2  # by hand: rows and columns: each second one is refined and given
_BLOCK = 3  # pixels, with half of the rows: smaller than in stereo_matching, or arms are lost; by hand
_ALIKE, _NEIGHBOURS = 0.5, 5  # pixels of disparity, and how many of eight neighbours: by hand
_STEP = 16  # disparities come in so many, by OpenCV


def agreed(left: Pixels, right: Pixels, raw: Pixels, mirrored: Pixels) -> Pixels:
    """Disparities with sharp edges on which both images agree; else NOWHERE."""
    # what is hidden in one of the images is taken for what hides it, in either image on another side
    raw, other = sharp(left, right, raw), mirror(sharp(mirror(right), mirror(left), mirrored))
    v, u = places(raw)
    there = cv2.remap(other, u - raw, v, cv2.INTER_NEAREST, borderValue=NOWHERE)
    return np.where((raw > NOWHERE) & (np.abs(there - raw) <= AGREE), raw, NOWHERE).astype(np.float32)


def mirror(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[:, ::-1])


def places(image: np.ndarray) -> Float32[np.ndarray, "2 row column"]:
    """Row and column of each pixel."""
    rows, columns = image.shape
    out = np.empty((2, rows, columns), np.float32)  # np.mgrid takes ten times as long
    out[0], out[1] = np.arange(rows)[:, None], np.arange(columns)
    return out


def brightness(left: Grey, right: Grey, raw: Pixels) -> tuple[float, float]:
    """Gain and offset that map the right camera's grey levels to the left one's: exposures differ."""
    left, (v, u), raw = left[::SOME, ::SOME], places(raw)[:, ::SOME, ::SOME], raw[::SOME, ::SOME]
    there = cv2.remap(right, u - raw, v, cv2.INTER_NEAREST)
    both = (raw > NOWHERE) & (np.minimum(left, there) > DARKEST) & (np.maximum(left, there) < BRIGHTEST)
    if both.sum() < 100:
        return 1.0, 0.0
    a, b = left[both].astype(float), there[both].astype(float)
    gain = float(np.clip(a.std() / max(b.std(), 1e-3), 0.5, 2.0))
    return gain, float(np.median(a - gain * b))


def sharp(left: Pixels, right: Pixels, raw: Pixels) -> Pixels:
    """The disparities with edges at those of the pictures: blocks and smoothness widen near objects. Beside an edge
    each pixel takes the one of the disparities around it (the least, the greatest or its own) that a few pixels match
    best."""
    a, b = (cv2.GaussianBlur(image, (0, 0), 0.5) for image in (left, right))
    v, u = places(raw)

    def cost(d):
        off = np.abs(a - cv2.remap(b, u - d, v, cv2.INTER_LINEAR))
        return cv2.GaussianBlur(np.minimum(off, OUTLIER), (0, 0), 1.0)

    seen = raw > NOWHERE
    high, best, found = np.where(seen, raw, np.float32(u.shape[1])), OWN * cost(raw), raw.copy()
    for reach in AROUND:
        kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        for other in (cv2.erode(high, kernel), cv2.dilate(raw, kernel)):
            edge = seen & (np.abs(other - raw) > STEP)
            costs = cost(np.where(edge, other, raw))
            better = edge & (costs < best)
            found[better], best = other[better], np.where(better, costs, best)
    return found


def refined(left: Pixels, right: Pixels, raw: Pixels, every: int) -> Float32[np.ndarray, "some_row some_column"]:
    """Lucas-Kanade steps, because block matching prefers whole pixels and brightness differences do not; and smoothed
    surfaces. Of every so many-th row and column."""
    images = [cv2.GaussianBlur(image, (0, 0), 1.0) for image in (left, right)]
    slopes = [cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8) for image in images]
    some = slice(None, None, every)
    v, u, a, slope, d = (np.ascontiguousarray(x[some, some]) for x in (*places(raw), images[0], slopes[0], raw))
    around = lambda x: cv2.GaussianBlur(x, (0, 0), 3.0 / every)  # noqa: E731
    # mixes nothing across edges of over a pixel
    smooth = lambda d: cv2.bilateralFilter(d, 2 * (4 // every) + 1, 1.0, 4.0 / every)  # noqa: E731
    d = smooth(d)
    for _ in range(STEPS):
        # cubic interpolation would pull to whole pixels
        moved, other = (cv2.remap(x, u - d, v, cv2.INTER_LINEAR) for x in (images[1], slopes[1]))
        g, e = (slope + other) / 2, a - moved
        weight = g * geman_mcclure(e**2, OUTLIER / 2)  # what is hidden in one of the images differs
        # with the image's noise as damping: where there is no texture the step is small
        d = d - np.clip(around(weight * e) / (around(weight * g) + 1.0), -0.5, 0.5)
    return smooth(d)


def at_edges(d: np.ndarray, shrink: int) -> np.ndarray:
    """True near something farther away, or near pixels without a disparity: such a pixel may show both."""
    around = np.ones((2 * shrink + 1, 2 * shrink + 1), np.uint8)
    return d - cv2.erode(d, around) > STEP * shrink


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
