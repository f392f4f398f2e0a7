"""Depth from a calibrated pair of cameras, one pair of images at a time: rectification, block matching, points.

The room is matched quickly (see `quick_stereo`). Only where something stands that a body may be it is matched finely:
to do that everywhere takes five times as long, and walls are no better for it.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from voodoo_jax.records.messages import stride
from voodoo_jax.sensors.quick_stereo import (
    AROUND,
    EVERY,
    NOWHERE,
    Grey,
    Pixels,
    agreed,
    at_edges,
    brightness,
    mirror,
    places,
    quick_disparity,
    refined,
)
from voodoo_jax.sensors.stereo_rig import Rig

WIDEST = 1000  # pixels; wider images are halved before they are matched, until they are not
_BLOCK = 5  # pixels; larger ones swallow arms
_SHARE = 5  # the nearest thing that is matched is this share of the image's width apart in the two images
FARTHEST = 1.5  # pixels by which a disparity may be refined
_COARSE = 4  # by hand: times smaller images tell which disparities there are
_NEARER = 1.25, 8.0  # by hand: times the disparity of what is nearest there, and pixels more, are looked for
_ABOVE = 0.1  # by hand: metres above the floor, from which on something stands
_STEP = 0.03  # by hand: of the distance, between neighbours: another thing
_BODY = (0.3, 2.4), 2.0  # by hand: metres that a body is high, or a part of it that is seen, and wide at most
_FEWEST = 100  # by hand: pixels of the quick disparities that a thing has
MARGIN = max(AROUND) + _BLOCK  # pixels around a window that what is in it depends on
UPWARDS = np.array([0.0, -1.0, 0.0])  # in an optical frame, as OpenCV has it: y is downwards
_RIM = 0.25  # by hand: metres around a thing: its hands and feet, and what is hidden by it in one of the images


class StereoMatcher:
    """Points from the images (rows, columns) of one rig, from about `min_range` metres on."""

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
        self._count = max(16, int(np.ceil((most - self._least) / 16)) * 16)  # pixels
        self._gap = [self._outside(mapping) for mapping in self.rig.maps]

    def points(
        self,
        left: UInt8[np.ndarray, "row column 3"],
        right: UInt8[np.ndarray, "row column 3"],
        max_points: int,
        up: Float[np.ndarray, "3"] = UPWARDS,
    ) -> Float[np.ndarray, "point 3"]:
        """At most about `max_points` points in the left camera's frame, metres. Raises ValueError for other sizes.

        **Arguments:** `up` unit vector in the left camera's frame."""
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
        every, used = EVERY * self.shrink, self._used(images[0], images[1])
        room = self._room(images[0], images[1], used)
        things = self._things(room, up @ self.rig.left_R_rectified)
        room[things] = 0
        more = -(-k // every)
        found = [self._placed(room[::more, ::more], 0, 0, every * more)]
        if things.any():
            rows, columns = ((np.flatnonzero(things.any(axis)) * every).tolist() for axis in (1, 0))
            v0, u0 = rows[0] // k * k, columns[0] // k * k
            window = v0, u0, rows[-1] + every, columns[-1] + every
            fine = self._disparity(images[0], images[1], k, window, used)
            v, u = (((at + np.arange(n) * k) // every).clip(max=m - 1)
                    for at, n, m in zip((v0, u0), fine.shape, things.shape))  # fmt: skip
            found.append(self._placed(np.where(things[np.ix_(v, u)], fine, 0), v0, u0, k))
        x, y, z = (axis[:, None] for axis in np.concatenate(found).T)
        turn = self.rig.left_R_rectified
        return x * turn[:, 0] + y * turn[:, 1] + z * turn[:, 2]  # a product of so few columns would wake threads

    def _placed(
        self, d: Float32[np.ndarray, "some_row some_column"], row: int, column: int, every: int
    ) -> Float[np.ndarray, "point 3"]:
        """Points of disparities, of every so many-th row and column from an offset on, in the rectified left camera's
        frame."""
        rows, columns = np.nonzero(d > 0)
        z = self.rig.focal * self.rig.baseline / d[rows, columns]
        x, y = ((at * every + first - c) / self.rig.focal
                for at, first, c in zip((columns, rows), (column, row), self.rig.centre))  # fmt: skip
        return np.column_stack([x, y, np.ones(len(z))]) * z[:, None]

    def _used(self, left: Grey, right: Grey) -> int:
        """Number of disparities of the shrunk images, from the least on, by the nearest object."""
        shrunk, small = 1 / _COARSE, (self._shrunk(left), self._shrunk(right))
        tiny = [cv2.resize(image, None, fx=shrunk, fy=shrunk, interpolation=cv2.INTER_AREA) for image in small]
        shift, count = self.rig.shift / self.shrink, -(-self._count // (16 * _COARSE)) * 16
        nearest = np.inf
        if tiny[0].shape[1] > 2 * count:  # else all are looked for
            d = quick_disparity(tiny[0], tiny[1], shift * shrunk, self._least // _COARSE, count)
            nearest = _NEARER[0] * float(np.max(d)) * _COARSE + _NEARER[1] - shift - self._least
        return int(np.clip(np.ceil(min(nearest, self._count) / 16) * 16, 16, self._count))

    def _room(self, left: Grey, right: Grey, used: int) -> Float32[np.ndarray, "some_row some_column"]:
        """Disparities as of `_disparity`, matched quickly, of every EVERY-th row and column of the shrunk images."""
        small, shift = (self._shrunk(left), self._shrunk(right)), self.rig.shift / self.shrink
        rows, columns = small[0].shape
        if columns <= used + 32:  # fewer than one may be apart in the two images
            return np.zeros((-(-rows // EVERY), -(-columns // EVERY)), np.float32)
        d = quick_disparity(small[0], small[1], shift, self._least, used, narrow=EVERY) * np.float32(self.shrink)
        v, u = places(d) * np.float32(EVERY * self.shrink)
        return np.where(self._hidden(v, u, d - np.float32(self.rig.shift)), np.float32(0), d)

    def _things(
        self, d: Float32[np.ndarray, "row column"], up: Float[np.ndarray, "3"]
    ) -> Bool[np.ndarray, "row column"]:
        """Rectangles of the quick disparities with an object on the floor that may be a body."""
        f, every = self.rig.focal, EVERY * self.shrink
        z = np.where(d > 0, f * self.rig.baseline / np.maximum(d, 1e-3), 0).astype(np.float32)
        v, u = places(d) * every
        (cx, cy), (x, y, forward) = self.rig.centre, up
        height = z * (((u - cx) * x + (v - cy) * y) / f + forward)
        there = z > 0
        if not there.any():
            return there
        stands = there & (height > np.percentile(height[there], 5) + _ABOVE)
        cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
        apart = cv2.dilate(z, cross) - cv2.erode(np.where(there, z, np.float32(1e6)), cross) > _STEP * z
        count, label, box, _ = cv2.connectedComponentsWithStats((stands & ~apart).astype(np.uint8), connectivity=4)
        things = np.zeros(d.shape, bool)
        for k in range(1, count):
            left, top, wide, high, pixels = box[k]
            if pixels < _FEWEST:
                continue
            metre = f / every / float(np.median(z[label == k]))
            (low, tall), broad = _BODY
            if low * metre < high < tall * metre and wide < broad * metre:
                rim = int(_RIM * metre)
                rows, columns = (slice(max(0, at - rim), at + size + rim) for at, size in ((top, high), (left, wide)))
                things[rows, columns] = True
        return things

    def _outside(self, mapping: np.ndarray | None) -> Float32[np.ndarray, "row column"]:
        """1 where the rectified image has content, less where it has none, and around that."""
        full = np.ones(self.shape, np.float32)
        if mapping is not None:
            full = cv2.remap(full, mapping[..., 0], mapping[..., 1], cv2.INTER_LINEAR)
        block = np.ones((_BLOCK * self.shrink, _BLOCK * self.shrink), np.uint8)
        return np.asarray(cv2.erode(full, block, borderType=cv2.BORDER_REPLICATE))

    def _hidden(self, v: Pixels, u: Pixels, d: Pixels) -> Bool[np.ndarray, "row column"]:
        """Mask of rows and columns, with their disparities, that lie outside the content of either rectified image."""
        rows, columns = self.shape
        here = self._gap[0][np.minimum(v.astype(int), rows - 1), np.minimum(u.astype(int), columns - 1)]
        there = cv2.remap(self._gap[1], u - d, v, cv2.INTER_LINEAR)
        return (here < 0.99) | (np.asarray(there) < 0.99)

    def _disparity(
        self, left: Grey, right: Grey, every: int, window: tuple[int, int, int, int], used: int
    ) -> Float32[np.ndarray, "some_row some_column"]:
        """Pixels from the left to the right image, for equal principal points; 0 where unknown. Of every so many-th row
        and column of a window: its first row and column, and those behind the last."""
        s, (v0, u0, v1, u1) = self.shrink, window
        # room for what edges take from around, and for the columns that the right image is shifted by
        top, before = (max(0, at - by) // (every * s) * every * s for at, by in
                       ((v0, MARGIN * s), (u0, (MARGIN + self._least + used) * s)))  # fmt: skip
        left, right = (image[top : v1 + MARGIN * s, before : u1 + MARGIN * s] for image in (left, right))
        small = self._shrunk(left), self._shrunk(right)
        blocks = self._matched(*small, used), self._matched(mirror(small[1]), mirror(small[0]), used)
        a, b = (image.astype(np.float32) for image in (left, right))
        gain, offset = brightness(*small, blocks[0])
        b = gain * b + offset
        raw = agreed(self._shrunk(a), self._shrunk(b), *blocks)
        if s > 1:
            raw = np.where(raw > NOWHERE, raw * s, NOWHERE).astype(np.float32)
            raw = np.asarray(cv2.resize(raw, left.shape[::-1], interpolation=cv2.INTER_NEAREST))
        d, edge = refined(a, b, raw, every), at_edges(raw, s)[::every, ::every]
        raw = raw[::every, ::every]
        v, u = places(d) * np.float32(every)
        gone = self._hidden(v + np.float32(top), u + np.float32(before), d)
        good = (raw > NOWHERE) & (np.abs(d - raw) <= FARTHEST * s) & ~edge & ~gone
        rows, columns = (slice((a - first) // every, -(-(b - first) // every)) for a, b, first in
                         ((v0, v1, top), (u0, u1, before)))  # fmt: skip
        return np.where(good, np.maximum(d + self.rig.shift, 0), 0).astype(np.float32)[rows, columns]

    def _shrunk(self, image: np.ndarray) -> np.ndarray:
        scale = 1 / self.shrink
        return image if scale == 1 else cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)

    def _matched(self, left: Grey, right: Grey, used: int) -> Pixels:
        """Disparities of the left image by block matching; NOWHERE where unknown."""
        match = cv2.StereoSGBM.create(
            minDisparity=self._least,
            numDisparities=used,
            blockSize=_BLOCK,
            P1=8 * _BLOCK**2,
            P2=32 * _BLOCK**2,
            disp12MaxDiff=1,  # left-right check, pixels
            uniquenessRatio=5,
            speckleWindowSize=100,
            speckleRange=2,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )
        # sensor noise is what block matching suffers from most
        smooth = [cv2.GaussianBlur(image, (0, 0), 1.2) for image in (left, right)]
        most = max(0, self._least + used)
        # what would be matched outside of the other image is not found, nor all else that is so near the border
        a, b = (cv2.copyMakeBorder(i, 0, 0, most, 0, cv2.BORDER_REPLICATE) for i in smooth)
        raw = match.compute(a, b)[:, most:].astype(np.float32) / 16
        return np.where(raw >= self._least, raw, NOWHERE).astype(np.float32)
