"""Two cameras side by side, from their calibrations: geometry of their rectified images."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32

from voodoo_jax.geometry.lens import distort, undistort
from voodoo_jax.records.messages import Calibration

Map = Float32[np.ndarray, "row column 2"]


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
    """Position in the raw image of each pixel of the rectified camera `to` (turned by R); -1: outside."""
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
