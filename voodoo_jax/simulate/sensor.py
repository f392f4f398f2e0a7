"""A depth camera and its noise.

Optical frame: z forward, x right, y down. Host side, NumPy.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int, UInt16
from scipy.spatial.transform import Rotation


# Camera, room and noise
@dataclass(frozen=True)
class Camera:
    """Pinhole depth camera without distortion; pixel centres at integer coordinates. Pose T_fixed_optical."""

    width: int
    height: int
    fx: float  # pixels
    fy: float
    cx: float
    cy: float
    position: tuple[float, float, float] = (0.0, 0.0, 1.2)  # metres
    pitch: float = 0.0  # radians downwards
    yaw: float = 0.0  # radians from +x to +y
    roll: float = 0.0  # radians about where it looks, clockwise as it sees

    @property
    def rotation(self) -> Float64[np.ndarray, "3 3"]:
        """Rotation matrix of T_fixed_optical: columns are the optical x (right), y (down), z (forward)."""
        (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (self.pitch, self.yaw))
        forward, right = np.array([cp * cy, cp * sy, -sp]), np.array([sy, -cy, 0.0])
        level = np.stack([right, np.cross(forward, right), forward], -1)
        return level @ Rotation.from_euler("z", self.roll).as_matrix() if self.roll else level

    def rays(self, pixels: Int[np.ndarray, " pixel"] | None = None) -> Float64[np.ndarray, "pixel 3"]:
        """Directions through the centres of pixels (numbers; none given: all), row by row, in the fixed frame; one
        metre of optical z long."""
        v, u = np.divmod(np.arange(self.width * self.height) if pixels is None else pixels, self.width)
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones(u.size)], -1) @ self.rotation.T


def tof_camera(height: float = 1.2, pitch: float = 0.07) -> Camera:
    """A time-of-flight camera of 160 x 124 pixels and 47.5 x 39.6 degrees, `height` metres above the floor."""
    fx, fy = 80 / np.tan(np.radians(47.5 / 2)), 62 / np.tan(np.radians(39.6 / 2))
    return Camera(160, 124, float(fx), float(fy), 79.5, 61.5, (0.0, 0.0, height), pitch)


def kinect_camera(height: float = 1.2, pitch: float = 0.07) -> Camera:
    """A Kinect v1 read at every second pixel: 320 x 240 pixels, focal length 290 pixels."""
    return Camera(320, 240, 290.0, 290.0, 159.5, 119.5, (0.0, 0.0, height), pitch)


@dataclass(frozen=True)
class Noise:
    """sigma(d) = constant + quadratic d^2 along the ray, metres; see TOF_NOISE, KINECT_NOISE, NO_NOISE."""

    constant: float = 0.0
    quadratic: float = 0.0  # per metre
    flying: float = 0.0  # share of the pixels at depth edges that mix both depths
    dropout: float = 0.0  # share of pixels lost anywhere
    grazing: float = 0.0  # cosine of the incidence below which pixels begin to get lost
    disparity: float = 0.0  # focal length x baseline / disparity step, metres; 0: none. Depth is quantised in 1 / z
    edge: float = 0.05  # step between neighbours that makes a depth edge, metres
    max_range: float = 60.0  # metres of optical z


NO_NOISE = Noise()
TOF_NOISE = Noise(0.004, 0.0015, flying=0.5, dropout=0.005, grazing=0.15, max_range=7.5)
KINECT_NOISE = Noise(0.0, 1.425e-3, flying=0.1, dropout=0.01, grazing=0.2, disparity=580 * 0.075 * 8, max_range=8.0)


def add_noise(
    depth: Float64[np.ndarray, "row column"],
    cosine: Float64[np.ndarray, "row column"],
    camera: Camera,
    noise: Noise,
    rng: np.random.Generator,
) -> UInt16[np.ndarray, "row column"]:
    """The camera's output: optical z in millimetres, 0 for no measurement."""
    height, width = depth.shape
    # flying pixels: a random one of the four neighbours shares the pixel
    side, share, flies = rng.integers(0, 4, depth.shape), rng.random(depth.shape), rng.random(depth.shape)
    row, column = np.mgrid[:height, :width]
    row = np.clip(row + np.array([0, 0, -1, 1])[side], 0, height - 1)
    column = np.clip(column + np.array([-1, 1, 0, 0])[side], 0, width - 1)
    neighbour = depth[row, column]
    seen = np.isfinite(depth) & (depth < noise.max_range)
    z, other = np.where(seen, depth, 1.0), np.where(np.isfinite(neighbour), neighbour, 1.0)
    mixed = (flies < noise.flying) & np.isfinite(neighbour) & (np.abs(z - other) > noise.edge)
    z = np.where(mixed, z + share * (other - z), z)
    stretch = np.linalg.norm(camera.rays(), axis=1).reshape(depth.shape)  # range per optical z
    z = z + rng.standard_normal(depth.shape) * (noise.constant + noise.quadratic * (z * stretch) ** 2) / stretch
    if noise.disparity:
        z = noise.disparity / np.maximum(np.round(noise.disparity / np.maximum(z, 1e-3)), 1)
    lost = rng.random(depth.shape) < noise.dropout
    lost |= rng.random(depth.shape) > cosine / max(noise.grazing, 1e-9)
    millimetres = np.round(z * 1000)
    return np.where(seen & ~lost & (millimetres > 0) & (z < noise.max_range), millimetres, 0).astype(np.uint16)
