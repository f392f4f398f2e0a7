"""Regions of skin colour in images, one image at a time (Knoop 2006, sec. III-A). NumPy and OpenCV."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

WIDTH = 640  # pixels; wider images are shrunk to it
MOST = 12  # regions per image: the largest
_CR, _CB, _DARK = (134, 175), (77, 127), 35  # skin of all complexions lies within, in daylight and in lamplight
_SMALLEST, _LARGEST = 2e-4, 0.06  # area as a share of the image: a hand at 6 m, a face at arm's length
_BIN = 2  # levels of Cr and Cb in one cell of the model
_FORGET = 0.1  # share of an image in the model


@dataclass(frozen=True)
class Regions:
    """Candidates for skin in one image. A long region (a bare forearm) is given as its two ends."""

    centres: Float[np.ndarray, "region 2"]  # pixels, u right, v down; the centre of the first pixel is 0, 0
    areas: Float[np.ndarray, " region"]  # pixels of the whole region
    scores: Float[np.ndarray, " region"]  # 0 to 1: how sure the model is that the colour is skin


class SkinFinder:
    """Finds skin by chrominance (YCrCb), with a model that follows light and complexion from image to image.

    What is within the range of skin colours and of plausible size is a candidate, and learned as skin; what is larger
    (wooden floors, brick walls) is learned as background. A hand before such a background is found where its colour was
    seen more often on skin than on background.
    """

    def __init__(self):
        centre = np.array([154.0, 106.0])  # where the literature's skin samples are densest
        cells = (np.stack(np.meshgrid(*[np.arange(256 // _BIN)] * 2, indexing="ij"), -1) + 0.5) * _BIN
        start = np.exp(-0.5 * np.sum(((cells - centre) / [9.0, 9.0]) ** 2, -1))
        self._skin = (1e-3 * start / start.sum()).astype(np.float32)  # counts, as shares of an image
        self._other = np.zeros_like(self._skin)

    def find(self, image: UInt8[np.ndarray, "row column 3"]) -> Regions:
        """Regions in an image (blue, green, red); updates the model."""
        scale = max(1.0, image.shape[1] / WIDTH)
        if scale > 1:
            image = np.asarray(cv2.resize(image, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA))
        size = image.shape[0] * image.shape[1]
        smooth = cv2.GaussianBlur(image, (0, 0), 1.2)
        y, cr, cb = np.moveaxis(np.asarray(cv2.cvtColor(smooth, cv2.COLOR_BGR2YCrCb)), 2, 0)
        within = (y > _DARK) & (cr >= _CR[0]) & (cr <= _CR[1]) & (cb >= _CB[0]) & (cb <= _CB[1])
        cell = cr // _BIN, cb // _BIN
        large = self._learn(within, cell, size)
        sure = (self._skin / np.maximum(self._skin + self._other, 1e-9))[cell]
        label, area, box = _components(within & (~large | (sure > 0.5)))
        good = (area >= _SMALLEST * size) & (area <= _LARGEST * size) & (area > 0.15 * box)
        good[0] = False  # what is no region
        chosen = sorted(np.flatnonzero(good).tolist(), key=lambda i: -area[i])[:MOST]
        found = []
        for i in chosen:
            v, u = np.nonzero(label == i)
            score = float(sure[v, u].mean())
            found += [(*end, float(area[i]) * scale**2, score) for end in _ends(np.column_stack([u, v]).astype(float))]
        table = np.array(found, float).reshape(-1, 4)
        return Regions((table[:, :2] + 0.5) * scale - 0.5, table[:, 2], table[:, 3])

    def _learn(self, within: Bool[np.ndarray, "row column"], cell: tuple, size: int) -> Bool[np.ndarray, "row column"]:
        """Updates the model by an image. Returns the pixels of regions too large for skin."""
        label, area, _ = _components(within)
        plausible = (area >= _SMALLEST * size) & (area <= _LARGEST * size)
        large = area > _LARGEST * size
        plausible[0] = large[0] = False
        for model, which in ((self._skin, plausible), (self._other, large)):
            seen = which[label]
            counts = np.zeros(model.shape, np.float32)
            np.add.at(counts, (cell[0][seen], cell[1][seen]), 1 / size)
            counts = cv2.GaussianBlur(counts, (0, 0), 0.7)
            if seen.any():  # an image without skin teaches nothing about it
                model += _FORGET * (counts - model)
        return large[label]


def _components(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Labels [row, column] of the connected parts of a mask, without specks and small holes; area of each part and of
    its bounding box, pixels. Part 0 is the background."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
    clean = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel)
    clean = cv2.morphologyEx(clean, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5)))
    _, label, stats, _ = cv2.connectedComponentsWithStats(clean, connectivity=8)
    stats = np.asarray(stats)
    box = stats[:, cv2.CC_STAT_WIDTH] * stats[:, cv2.CC_STAT_HEIGHT]
    return np.asarray(label), stats[:, cv2.CC_STAT_AREA], box


def _ends(pixels: Float[np.ndarray, "pixel 2"]) -> list[Float[np.ndarray, "2"]]:
    """The centre of a region; of a long one the middles of both ends, one of which may be the hand."""
    centre = pixels.mean(0)
    spread, axes = np.linalg.eigh(np.cov(pixels.T) + 1e-9 * np.eye(2))
    width, length = 4 * np.sqrt(spread)  # of an ellipse with these moments
    if length < 2.5 * width:
        return [centre]
    return [centre + side * (length / 2 - width) * axes[:, 1] for side in (-1, 1)]
