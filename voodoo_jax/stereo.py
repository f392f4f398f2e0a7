"""Depth from a calibrated pair of cameras, one pair of images at a time: rectification, block matching, points."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from voodoo_jax.io.camera import distort, undistort
from voodoo_jax.io.contents import Calibration, stride

Map = Float32[np.ndarray, "row column 2"]
WIDEST = 800  # pixels; wider images are halved before they are matched, until they are not
_BLOCK = 5  # pixels; larger ones swallow arms
_SHARE = 5  # the nearest thing that is matched is this share of the image's width apart in the two images


@dataclass(frozen=True)
class Rig:
    """Two cameras side by side, as their rectified images: one pinhole camera, moved by `baseline` to the right."""

    focal: float  # pixels
    centre: tuple[float, float]  # principal point, pixels
    baseline: float  # metres
    shift: float  # pixels added to the disparity, where the principal points differ
    left_R_rectified: Float[np.ndarray, "3 3"]  # to the left camera's own frame
    maps: tuple[Map | None, Map | None]  # for cv2.remap; None: the image is rectified already


def projected_rig(left: Calibration, right: Calibration, rectified: bool) -> Rig:
    """The pair whose rectification stands in its calibrations (R and P). `rectified`: the images are so already.

    By ROS custom the left camera's frame is that of its rectified image. Raises ValueError if it cannot be.
    """
    P, Q = left.P, right.P
    if not (P[0, 0] > 0 and Q[0, 0] > 0):
        raise ValueError("its projection matrices have no focal length")
    if not np.allclose(P[:2, 0:2], Q[:2, 0:2], rtol=1e-3, atol=1e-3) or abs(P[1, 2] - Q[1, 2]) > 0.5:
        raise ValueError("its projection matrices are not of one rectified pair")
    baseline = float(P[0, 3] / P[0, 0] - Q[0, 3] / Q[0, 0])
    _check_baseline(baseline, np.array([baseline, 0.0, 0.0]))
    maps = (None, None) if rectified else (_map(left, left.R, P[:, :3]), _map(right, right.R, Q[:, :3]))
    centre = float(P[0, 2]), float(P[1, 2])
    return Rig(float(P[0, 0]), centre, baseline, float(Q[0, 2] - P[0, 2]), np.eye(3), maps)


def posed_rig(
    left: Calibration,
    right: Calibration,
    left_R_right: Float[np.ndarray, "3 3"],
    left_t_right: Float[np.ndarray, "3"],
    rectified: bool,
) -> Rig:
    """The pair from the right camera's pose in the left camera's frame (metres). Raises ValueError if it cannot be.

    `rectified`: the images have no lens left, as `rect` in their names says.
    """
    _check_baseline(float(left_t_right[0]), left_t_right)
    cameras = [(c.P[:, :3], np.zeros(0)) if rectified and c.P[0, 0] > 0 else (c.K, c.D) for c in (left, right)]
    if not all(K[0, 0] > 0 and K[1, 1] > 0 for K, _ in cameras):
        raise ValueError("a camera of it is not calibrated (focal length 0)")
    baseline = float(np.linalg.norm(left_t_right))
    x = left_t_right / baseline
    z = left_R_right[:, 2] + [0.0, 0.0, 1.0]  # between the two optical axes
    y = np.cross(z, x)
    y /= np.linalg.norm(y)
    left_R = np.column_stack([x, y, np.cross(x, y)])  # rectified to left
    focal = float(np.mean([K[1, 1] for K, _ in cameras]))
    at = np.mean([K[:2, 2] for K, _ in cameras], axis=0)
    K = np.array([[focal, 0.0, at[0]], [0.0, focal, at[1]], [0.0, 0.0, 1.0]])
    maps = tuple(
        None if not np.any(D) and np.allclose(k, K, atol=0.05) and np.allclose(R, np.eye(3), atol=1e-4)
        else _map(c, R, K, k, D)
        for c, (k, D), R in zip((left, right), cameras, (left_R.T, left_R.T @ left_R_right))
    )  # fmt: skip
    return Rig(focal, (float(at[0]), float(at[1])), baseline, 0.0, left_R, (maps[0], maps[1]))


def _check_baseline(x: float, t: np.ndarray) -> None:
    length = float(np.linalg.norm(t))
    if not 0.005 <= length <= 2.0 or x < 0.8 * length:
        raise ValueError(
            f"the right camera must be 0.005 to 2 m to the right of the left one; by the calibration it is at "
            f"x = {t[0]:.3g}, y = {t[1]:.3g}, z = {t[2]:.3g} m of it"
        )


def _map(c: Calibration, R: np.ndarray, to: np.ndarray, K: np.ndarray | None = None, D: np.ndarray | None = None):
    """For each pixel of the rectified camera `to` (turned by R) where it lies in the raw image; -1: nowhere."""
    K, D = c.K if K is None else K, c.D if D is None else D
    rays = undistort(np.stack(np.meshgrid(np.arange(c.width), np.arange(c.height)), -1).astype(float), to, np.zeros(0),
                     "plumb_bob")  # fmt: skip
    turned = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], -1) @ R
    ahead = turned[..., 2] > 0.05
    rays = turned[..., :2] / np.where(ahead, turned[..., 2], 1.0)[..., None]
    D = np.pad(D, (0, max(0, 4 - len(D))))
    at = np.concatenate([distort(rays, D, c.model), np.ones((*rays.shape[:2], 1))], -1) @ K.T
    # far off the axis the lens function folds back: there the picture would be seen twice
    back = undistort(at[::8, ::8, :2], K, D, c.model)
    with np.errstate(invalid="ignore"):
        good = (np.abs(back - rays[::8, ::8]).max(-1) < 1e-3).astype(np.uint8)
    good = cv2.resize(good, (c.width, c.height), interpolation=cv2.INTER_NEAREST).astype(bool)
    return np.where((ahead & good)[..., None], at[..., :2], -1.0).astype(np.float32)


class StereoMatcher:
    """Points from the images (rows, columns) of one rig, from `min_range` metres on or what is nearly as near."""

    def __init__(self, rig: Rig, shape: tuple[int, int], min_range: float):
        self.rig, self.shape = rig, shape
        self.shrink = 1
        while shape[1] / self.shrink > WIDEST:
            self.shrink *= 2
        width, reach = shape[1] // self.shrink, rig.focal / self.shrink * rig.baseline
        # from infinity on, whatever the farthest distance asked for: what is farther would be matched wrongly
        self._shift = rig.shift / self.shrink
        self._least = int(np.floor(-self._shift))
        most = min(reach / max(min_range, 1e-3), width / _SHARE) - self._shift
        count = max(16, int(np.ceil((most - self._least) / 16)) * 16)
        self._match = cv2.StereoSGBM.create(
            minDisparity=self._least,
            numDisparities=count,
            blockSize=_BLOCK,
            P1=24 * _BLOCK**2,  # thrice OpenCV's customary values: clothes and walls have little texture
            P2=96 * _BLOCK**2,
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
            if self.shrink > 1:
                grey = cv2.resize(grey, None, fx=1 / self.shrink, fy=1 / self.shrink, interpolation=cv2.INTER_AREA)
            images.append(cv2.GaussianBlur(grey, (0, 0), 1.2))  # sensor noise is what block matching suffers from most
        d = self._disparity(*images)
        k = stride(d.shape[0], d.shape[1], max_points)
        rows, columns = np.nonzero(d[::k, ::k] > 0)
        rows, columns = rows * k, columns * k
        s = self.shrink
        z = self.rig.focal * self.rig.baseline / (d[rows, columns] * s)
        # centre of the first pixel is 0, 0, in the full image as in the shrunken one
        x = ((columns + 0.5) * s - 0.5 - self.rig.centre[0]) / self.rig.focal
        y = ((rows + 0.5) * s - 0.5 - self.rig.centre[1]) / self.rig.focal
        return (np.column_stack([x, y, np.ones(len(z))]) * z[:, None]) @ self.rig.left_R_rectified.T

    def _gaps(self, d: Float32[np.ndarray, "row column"]) -> Bool[np.ndarray, "row column"]:
        """What lies, in either image, where the rectified image shows nothing."""
        inside = []
        for mapping in self.rig.maps:
            full = np.ones(self.shape, np.float32)
            if mapping is not None:
                full = cv2.remap(full, mapping[..., 0], mapping[..., 1], cv2.INTER_LINEAR)
            small = cv2.resize(full, (d.shape[1], d.shape[0]), interpolation=cv2.INTER_AREA)
            inside.append(cv2.erode(small, np.ones((_BLOCK, _BLOCK), np.uint8), borderType=cv2.BORDER_REPLICATE))
        v, u = np.mgrid[0 : d.shape[0], 0 : d.shape[1]].astype(np.float32)
        there = cv2.remap(inside[1], u - d, v, cv2.INTER_LINEAR)
        return (inside[0] < 0.99) | (np.asarray(there) < 0.99)

    def _disparity(self, left: np.ndarray, right: np.ndarray) -> Float32[np.ndarray, "row column"]:
        """Pixels from the left to the right image, as if the principal points were the same; 0 where there is none."""
        raw = self._match.compute(left, right).astype(np.float32) / 16
        seen = raw >= self._least
        d = cv2.bilateralFilter(raw, 9, 1.0, 4.0)  # smooths surfaces, mixes nothing across edges of over a pixel or so
        d = cv2.bilateralFilter(_refined(left, right, d), 9, 1.0, 4.0)
        good = seen & (np.abs(d - raw) <= 1) & ~_at_edges(raw) & ~self._gaps(d)
        return np.where(good, np.maximum(d + self._shift, 0), 0).astype(np.float32)


def _refined(left: np.ndarray, right: np.ndarray, d: np.ndarray) -> np.ndarray:
    """One Lucas-Kanade step: block matching prefers whole pixels, brightness differences do not."""
    a, b = left.astype(np.float32), right.astype(np.float32)
    v, u = np.mgrid[0 : d.shape[0], 0 : d.shape[1]].astype(np.float32)
    slope = [cv2.Sobel(x, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8) for x in (a, b)]
    moved = cv2.remap(b, u - d, v, cv2.INTER_CUBIC)
    g = (slope[0] + cv2.remap(slope[1], u - d, v, cv2.INTER_LINEAR)) / 2
    e = a - moved
    g[np.abs(e) > 30] = 0  # hidden in one of the images
    around = lambda x: cv2.GaussianBlur(x, (0, 0), 5.0)  # noqa: E731
    # with the image's noise as damping: where there is no texture the step is small
    return d - np.clip(around(g * e) / (around(g * g) + 4.0), -0.5, 0.5)


def _at_edges(d: np.ndarray) -> np.ndarray:
    """True where a farther thing is near: there the nearer one is drawn too wide, by up to half a block."""
    near = cv2.erode(d, np.ones((3, 3), np.uint8))
    return d - near > 1.5
