"""Features of images for the filters: edges, motion, colour, depth (Hecht et al. 2009, sec. III). Host side.

Images are shrunk to WIDTH columns; depth has the same grid.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8, UInt16

from voodoo_jax.records.recording import Frame, Picture
from voodoo_jax.sensors.quick_stereo import EVERY, quick_depth

WIDTH = 320  # columns of all features: a forearm at 3 m is six pixels wide, set by hand
COARSE = 4  # by hand: rows and columns of features per row and column of motion and of the occlusion map
_GRADIENT, _DIFFERENCE = 18.0, 9.0  # grey levels above which edges and motion count: above the noise of JPEG, measured
_BINS = 64  # bins of Cr and of Cb in the skin model, by hand
# weights of a colour's frequency on clothes and in the room against that on the face; frequency below which a colour is
# too rare to decide. Measured: 1 for clothes is 0.5 cm worse; 1 for the room without rare ones is 4 cm worse in an
# exercise
_CLOTHES, _ROOM, _RARE = 2.0, 2.0, 0.002
NEAREST = 1.0  # metres, by hand: closer people do not fit into the image


class Features(NamedTuple):
    """Features of one frame. The camera's parameters are those of the shrunk image."""

    colour: UInt8[np.ndarray, "row column 3"]  # blue, green, red
    cell: UInt16[np.ndarray, "row column"]  # of the skin model, by Cr and Cb
    edge: UInt8[np.ndarray, "row column"]  # 255: strongest moving edge
    motion: UInt8[np.ndarray, "coarse_row coarse_column"]  # 255: all around moves
    depth: Float32[np.ndarray, "row column"]  # along the optical axis, metres; 0: unknown
    focal: Float32[np.ndarray, "4"]  # fx, fy, cx, cy, pixels
    turn: Float32[np.ndarray, "3 3"]  # rotation from the fixed frame to the camera
    shift: Float32[np.ndarray, "3"]  # metres
    pair: UInt8[np.ndarray, "eye pair_row pair_column"]  # grey, for the face's depth alone; empty: depth is dense
    rig: Float64[np.ndarray, "2"]  # of `pair`: disparity at 1 m, and offset of disparities; pixels


class Window(NamedTuple):
    """The region in which depth is measured."""

    nearest: float  # metres: least depth
    box: tuple[int, int, int, int] | None  # first row and column of the features, end of rows and columns; None: all


class Near(NamedTuple):
    """The region within `margin` of points."""

    points: Float32[np.ndarray, "point 3"]  # fixed frame, metres
    margin: float  # metres

    def window(
        self, K: Float[np.ndarray, "3 3"], T_camera_fixed: Float[np.ndarray, "4 4"], size: tuple[int, int]
    ) -> Window:
        """The window of this region in an image of `size` columns and rows."""
        q = self.points @ T_camera_fixed[:3, :3].T.astype(np.float32) + T_camera_fixed[:3, 3].astype(np.float32)
        nearest = max(float(q[:, 2].min()) - self.margin, NEAREST)
        z = np.maximum(q[:, 2:], nearest)
        focal = np.array([K[0, 0], K[1, 1]])
        at, around = q[:, :2] / z * focal + K[:2, 2], self.margin / z * focal
        low, high = (at - around).min(0).astype(int), (at + around).max(0).astype(int) + 1
        (u0, v0), (u1, v1) = (np.clip(corner, 0, size) for corner in (low, high))
        seen = u0 < u1 and v0 < v1
        return Window(nearest, (int(v0), int(u0), int(v1), int(u1)) if seen else None)


@dataclass
class SkinModel:
    """Colours of the face against clothes and the room, learnt from the first image (only Cr and Cb: light changes)."""

    share: Float32[np.ndarray, "bin bin"] = field(default_factory=lambda: np.zeros((_BINS,) * 2, np.float32))
    bare: Float32[np.ndarray, "bin bin"] = field(default_factory=lambda: np.zeros((_BINS,) * 2, np.float32))

    def learn(self, cell: UInt16[np.ndarray, "row column"], face: np.ndarray, clothes: np.ndarray) -> None:
        """Learns skin from the mask `face`, and other colours from the mask `clothes` and all other pixels."""
        counts = []
        for mask in (face, clothes, ~face & ~clothes):
            found = np.bincount(cell[mask], minlength=_BINS**2).reshape(_BINS, _BINS).astype(np.float32)
            counts.append(cv2.GaussianBlur(found / max(found.sum(), 1.0), (0, 0), 0.8))
        skin, worn, room = counts
        self.share = (skin / np.maximum(skin + _CLOTHES * worn + _ROOM * room, 1e-6)).astype(np.float32)
        self.bare = (skin / (skin + _CLOTHES * worn + _RARE)).astype(np.float32)

    def map(self, cell: UInt16[np.ndarray, "row column"]) -> Float32[np.ndarray, "row column"]:
        """Probability that each pixel is skin, 0..1."""
        return self.share.ravel()[cell]

    def on_person(self, cell: UInt16[np.ndarray, "row column"]) -> UInt8[np.ndarray, "row column"]:
        """Probability that each pixel is skin if it belongs to the person, 0..255."""
        return (255 * self.bare.ravel()).astype(np.uint8)[cell]


def cells(image: UInt8[np.ndarray, "row column 3"]) -> UInt16[np.ndarray, "row column"]:
    """The cell of each pixel in the skin model: its Cr and Cb, slightly blurred."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    parts = np.asarray(cv2.cvtColor(smooth, cv2.COLOR_BGR2YCrCb)) // (256 // _BINS)
    return parts[..., 1] * np.uint16(_BINS) + parts[..., 2]


class Extractor:
    """Features of one camera's images in order; motion is the difference from the previous image."""

    def __init__(self):
        self._grey: np.ndarray | None = None

    def __call__(self, frame: Frame, picture: Picture, dense: bool, near: Near | None = None) -> Features:
        """Features of one of a frame's pictures. Raises ValueError for broken images.

        **Arguments:** `dense` with the depth of all pixels; `near` region to which the depth of stereo pairs is
        limited, None: all.
        """
        images = picture.unpack()
        rows, columns = images[0].shape[:2]
        scale = WIDTH / columns
        size = WIDTH, max(COARSE, round(rows * scale / COARSE) * COARSE)
        colour = np.asarray(cv2.resize(images[0], size, interpolation=cv2.INTER_AREA))
        K = picture.K.copy()
        K[0] *= size[0] / columns
        K[1] *= size[1] / rows
        K[0, 2] += 0.5 * size[0] / columns - 0.5
        K[1, 2] += 0.5 * size[1] / rows - 0.5
        inverse = np.linalg.inv(picture.T_fixed_camera)
        depth, pair, rig = np.zeros(size[::-1], np.float32), np.zeros((0, 0, 0), np.uint8), np.zeros(2)
        if len(images) == 2 and not dense:
            pair = np.stack([cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in as_wide(images, size)])
            rig = np.array([picture.K[0, 0] * picture.baseline, picture.shift]) * WIDTH * EVERY / columns
        elif dense and len(images) == 2:
            depth = pair_depth(picture, images, size, None if near is None else near.window(K, inverse, size))
        elif dense:
            depth = cloud_depth(_select_camera_points(frame, picture), K, inverse, size)
        grey = cv2.GaussianBlur(np.asarray(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)), (0, 0), 0.8)
        edge, motion = self._detect_motion(grey)
        return Features(
            colour, cells(colour), edge, motion, depth,
            np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]], np.float32),
            inverse[:3, :3].astype(np.float32), inverse[:3, 3].astype(np.float32), pair, rig,
        )  # fmt: skip

    def _detect_motion(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        dx, dy = (cv2.Sobel(grey, cv2.CV_32F, *d, ksize=3, scale=0.25) for d in ((1, 0), (0, 1)))
        gradient = (np.hypot(dx, dy) > _GRADIENT).astype(np.float32)
        small = grey.shape[1] // COARSE, grey.shape[0] // COARSE
        difference = np.zeros_like(gradient)
        if self._grey is not None and self._grey.shape == grey.shape:
            difference = (cv2.absdiff(grey, self._grey) > _DIFFERENCE).astype(np.float32)
        self._grey = grey
        near = cv2.dilate(difference, np.ones((3, 3), np.uint8))
        # Hecht requires both, which leaves no edges on a still limb (measured); here motion doubles the weight of edges
        edge = cv2.GaussianBlur(gradient * (0.5 + 0.5 * near), (0, 0), 1.5)
        edge = np.clip(edge / max(float(edge.max()), 0.25) * 255, 0, 255).astype(np.uint8)
        motion = cv2.GaussianBlur(np.asarray(cv2.resize(difference, small, interpolation=cv2.INTER_AREA)), (0, 0), 2.0)
        return edge, np.clip(motion * 255, 0, 255).astype(np.uint8)


def _select_camera_points(frame: Frame, picture: Picture) -> Float32[np.ndarray, "point 3"]:
    """The points of the depth camera nearest to a colour camera: other cameras see surfaces that are hidden from it."""
    if len(frame.origins) == 1:
        return frame.points
    apart = np.linalg.norm(frame.origins - picture.T_fixed_camera[:3, 3], axis=1)
    return frame.points[frame.sensor == np.nanargmin(apart)]


def as_wide(images: tuple[np.ndarray, ...], size: tuple[int, int]) -> tuple[np.ndarray, ...]:
    """Images for stereo matching: EVERY times the features' `size`, columns and rows."""
    wide = WIDTH * EVERY
    if images[0].shape[1] == wide:
        return images
    return tuple(np.asarray(cv2.resize(i, (wide, size[1] * EVERY), interpolation=cv2.INTER_AREA)) for i in images)


def pair_depth(
    picture: Picture, images: tuple[np.ndarray, ...], size: tuple[int, int], within: Window | None = None
) -> np.ndarray:
    """Depth of a rectified pair on the features' grid, metres: dense `within` a window, 0 elsewhere."""
    scale, images = WIDTH * EVERY / images[0].shape[1], as_wide(images, size)
    reach = picture.K[0, 0] * scale * picture.baseline
    nearest, box = (NEAREST, None) if within is None else within
    if box is not None:
        shrunk = images[0].shape[0] / size[1], images[0].shape[1] / size[0]
        box = (*np.floor(np.multiply(box[:2], shrunk)).astype(int), *np.ceil(np.multiply(box[2:], shrunk)).astype(int))
    found = quick_depth(images[0], images[1], reach, picture.shift * scale, nearest, box)
    return found[: size[1], : size[0]] if found.shape == size[::-1] else np.asarray(
        cv2.resize(found, size, interpolation=cv2.INTER_NEAREST)
    )  # fmt: skip


def cloud_depth(
    points: Float32[np.ndarray, "point 3"], K: Float[np.ndarray, "3 3"], T_camera_fixed: Float[np.ndarray, "4 4"],
    size: tuple[int, int],
) -> np.ndarray:  # fmt: skip
    """Depth of a depth camera's points on the features' grid, metres; gaps up to the spacing of the points are
    filled."""
    out = np.full(size[::-1], np.inf, np.float32)
    p = points @ T_camera_fixed[:3, :3].T.astype(np.float32) + T_camera_fixed[:3, 3].astype(np.float32)
    p = p[p[:, 2] > 0.1]
    u = np.round(p[:, 0] / p[:, 2] * K[0, 0] + K[0, 2]).astype(int)
    v = np.round(p[:, 1] / p[:, 2] * K[1, 1] + K[1, 2]).astype(int)
    inside = (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])
    np.minimum.at(out, (v[inside], u[inside]), p[inside, 2])
    share = max(float(np.isfinite(out).mean()), 1e-3)
    reach = int(np.clip(np.ceil(0.5 / np.sqrt(share)), 0, 4))
    if reach and share < 0.9:
        filled = cv2.erode(out, np.ones((2 * reach + 1,) * 2, np.uint8), borderType=cv2.BORDER_REPLICATE)
        out = np.where(np.isfinite(out), out, filled)
    return np.where(np.isfinite(out), out, 0.0).astype(np.float32)


def depth_points(f: Features) -> tuple[Float32[np.ndarray, "point 3"], np.ndarray]:
    """Points of the pixels with depth in the fixed frame, metres, and their pixel numbers."""
    at = np.flatnonzero(f.depth)
    rows, columns = f.depth.shape
    fx, fy, cx, cy = f.focal
    # rays per metre of depth as a sum by row and column, much cheaper than a matrix product for each point
    level = ((np.arange(columns, dtype=np.float32) - cx) / fx)[:, None] * f.turn[0]
    upright = ((np.arange(rows, dtype=np.float32) - cy) / fy)[:, None] * f.turn[1] + f.turn[2]
    ray = (upright[:, None] + level).reshape(-1, 3)
    return ray[at] * f.depth.ravel()[at, None] - f.shift @ f.turn, at
