"""Disparities between rectified images, from those of block matching: sharp edges, agreed on, to fractions of a pixel.

Lucas and Kanade 1981; the images' disparities against each other: Hirschmueller 2008, doi:10.1109/TPAMI.2007.1166.
"""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

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
