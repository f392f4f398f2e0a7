"""Depth from a calibrated pair of cameras, one pair of images at a time: rectification, block matching, points."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from voodoo_jax.records.messages import stride
from voodoo_jax.sensors.disparity import NOWHERE, Grey, Pixels, agreed, at_edges, brightness, mirror, places, refined
from voodoo_jax.sensors.stereo_rig import Rig

WIDEST = 1000  # pixels; wider images are halved before they are matched, until they are not
_BLOCK = 5  # pixels; larger ones swallow arms
_SHARE = 5  # the nearest thing that is matched is this share of the image's width apart in the two images
FARTHEST = 1.5  # pixels by which a disparity may be refined


class StereoMatcher:
    """Points from the images (rows, columns) of one rig, from `min_range` metres on or what is nearly as near."""

    def __init__(self, rig: Rig, shape: tuple[int, int], min_range: float):
        self.rig, self.shape = rig, shape
        self.shrink = 1
        while shape[1] / self.shrink > WIDEST:
            self.shrink *= 2
        width, reach = shape[1] // self.shrink, rig.focal / self.shrink * rig.baseline
        # from infinity on, whatever the farthest distance asked for: what is farther would be matched wrongly
        shift = rig.shift / self.shrink
        self._least = int(np.floor(-shift))
        most = min(reach / max(min_range, 1e-3), width / _SHARE) - shift
        count = max(16, int(np.ceil((most - self._least) / 16)) * 16)
        self._most = max(0, self._least + count)  # pixels
        self._match = cv2.StereoSGBM.create(
            minDisparity=self._least,
            numDisparities=count,
            blockSize=_BLOCK,
            P1=8 * _BLOCK**2,
            P2=32 * _BLOCK**2,
            disp12MaxDiff=1,  # left-right check, pixels
            uniquenessRatio=5,
            speckleWindowSize=100,
            speckleRange=2,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )

    def points(
        self, left: UInt8[np.ndarray, "row column 3"], right: UInt8[np.ndarray, "row column 3"], max_points: int
    ) -> Float[np.ndarray, "point 3"]:
        """At most about `max_points` points in the left camera's frame, metres. Raises ValueError for other sizes."""
        images = []
        for image, mapping in zip((left, right), self.rig.maps):
            if image.shape[:2] != self.shape:
                raise ValueError(f"an image of the pair has {image.shape[1]} x {image.shape[0]} pixels, "
                                 f"not {self.shape[1]} x {self.shape[0]}")  # fmt: skip
            grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
            if mapping is not None:
                grey = cv2.remap(grey, mapping[..., 0], mapping[..., 1], cv2.INTER_LINEAR)
            images.append(grey)
        k = stride(*self.shape, max_points)
        d = self._disparity(images[0], images[1], k)
        rows, columns = np.nonzero(d > 0)
        z = self.rig.focal * self.rig.baseline / d[rows, columns]
        x, y = ((at * k - c) / self.rig.focal for at, c in zip((columns, rows), self.rig.centre))
        return (np.column_stack([x, y, np.ones(len(z))]) * z[:, None]) @ self.rig.left_R_rectified.T

    def _gaps(self, d: Pixels, every: int) -> Bool[np.ndarray, "row column"]:
        """What lies, in either image, where the rectified image shows nothing."""
        inside = []
        for mapping in self.rig.maps:
            full = np.ones(self.shape, np.float32)
            if mapping is not None:
                full = cv2.remap(full, mapping[..., 0], mapping[..., 1], cv2.INTER_LINEAR)
            block = np.ones((_BLOCK * self.shrink, _BLOCK * self.shrink), np.uint8)
            inside.append(cv2.erode(full, block, borderType=cv2.BORDER_REPLICATE))
        v, u = places(d) * every
        there = cv2.remap(inside[1], u - d, v, cv2.INTER_LINEAR)
        return (inside[0][::every, ::every] < 0.99) | (np.asarray(there) < 0.99)

    def _disparity(self, left: Grey, right: Grey, every: int) -> Float32[np.ndarray, "some_row some_column"]:
        """Pixels from the left to the right image, as if the principal points were the same; 0 where there is none. Of
        every so many-th row and column."""
        small = self._shrunk(left), self._shrunk(right)
        blocks = self._matched(*small), self._matched(mirror(small[1]), mirror(small[0]))
        a, b = (image.astype(np.float32) for image in (left, right))
        gain, offset = brightness(*small, blocks[0])
        b = gain * b + offset
        raw = agreed(self._shrunk(a), self._shrunk(b), *blocks)
        if self.shrink > 1:
            raw = np.where(raw > NOWHERE, raw * self.shrink, NOWHERE).astype(np.float32)
            raw = np.asarray(cv2.resize(raw, left.shape[::-1], interpolation=cv2.INTER_NEAREST))
        d, edge = refined(a, b, raw, every), at_edges(raw, self.shrink)[::every, ::every]
        raw = raw[::every, ::every]
        good = (raw > NOWHERE) & (np.abs(d - raw) <= FARTHEST * self.shrink) & ~edge & ~self._gaps(d, every)
        return np.where(good, np.maximum(d + self.rig.shift, 0), 0).astype(np.float32)

    def _shrunk(self, image: np.ndarray) -> np.ndarray:
        scale = 1 / self.shrink
        return image if scale == 1 else cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)

    def _matched(self, left: Grey, right: Grey) -> Pixels:
        """Disparities of the left image by block matching; NOWHERE where there is none."""
        # sensor noise is what block matching suffers from most
        smooth = [cv2.GaussianBlur(image, (0, 0), 1.2) for image in (left, right)]
        # what would be matched outside of the other image is not found, nor all else that is so near the border
        a, b = (cv2.copyMakeBorder(i, 0, 0, self._most, 0, cv2.BORDER_REPLICATE) for i in smooth)
        raw = self._match.compute(a, b)[:, self._most :].astype(np.float32) / 16
        return np.where(raw >= self._least, raw, NOWHERE).astype(np.float32)
