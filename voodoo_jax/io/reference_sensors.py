"""Selects the depth sensors that give frames: those dense enough to track a person by a single one."""

import numpy as np

from voodoo_jax.io.calibrations import calibration_of
from voodoo_jax.io.topic import Topic
from voodoo_jax.records.messages import Colour, Image, stride

_CELL = 0.1  # of azimuth and sine of the elevation: 0.01 steradians
_THIN = 1 / 3  # of the densest sensor's density; a spinning scanner of 16 lines has a quarter of a small depth camera's


def dense(topics: dict[str, Topic], names: list[str], max_points: int) -> list[str]:
    """Those of the depth topics that are about as dense as the densest of them (points per solid angle)."""
    density = {name: _density(topics, name, max_points) for name in names}
    most = max((d for d in density.values() if np.isfinite(d)), default=0.0)
    return [name for name in names if density[name] >= _THIN * most]


def _density(topics: dict[str, Topic], name: str, max_points: int) -> float:
    """Points per steradian where the sensor sees anything; inf if the first message does not tell."""
    sample = topics[name].sample
    if isinstance(sample, Image | Colour):  # Colour: the left one of a stereo pair
        c = calibration_of(topics, name)
        if c is None:
            return np.inf
        height, width = sample.shape if any(sample.shape) else (c.height, c.width)
        scale = (width / c.width) * (height / c.height) if c.width and c.height else 1.0
        return float(c.K[0, 0] * c.K[1, 1] * scale) / stride(height, width, max_points) ** 2
    points = sample.points(max_points)
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.linalg.norm(points, axis=1)
        points, distance = points[(distance > 0) & (distance < 1e4)], distance[(distance > 0) & (distance < 1e4)]
    cells = np.column_stack([np.arctan2(points[:, 1], points[:, 0]), points[:, 2] / distance])
    seen = len(np.unique(np.floor(cells / _CELL), axis=0))
    return len(points) / (seen * _CELL**2) if seen else np.inf
