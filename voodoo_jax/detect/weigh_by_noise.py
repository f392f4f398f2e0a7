"""Measures the noise of a sensor's distances from the points on the body; noisier points weigh less.

Host side, NumPy; one frame at a time, no look ahead. It needs no data of the sensor: a time-of-flight camera errs by 1
cm at 2 m and 4 cm at 5 m, a stereo pair by more, a laser scanner by 2 cm anywhere.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float32
from scipy.spatial import KDTree

from voodoo_jax.detect.stage import Target
from voodoo_jax.detect.visibility import has_far_sides
from voodoo_jax.geometry.point_cloud import quantile
from voodoo_jax.records.observation import BodyObservation

MOST, ASKED = 3000, 150  # points that neighbours are looked for among, and points whose neighbours are looked at
NEIGHBOURS = 9  # of a point, itself among them: a plane has three numbers
FEWEST = 60  # points of a sensor from which its noise can be told
# metres among nearest neighbours in space: noise that alone looks like far sides leaves more (measured: 0.023 of 0.06)
CLEAN = 0.02
EVERY = 30  # frames after which it is measured again


@dataclass(frozen=True)
class WeighByNoise:
    """Reduces the weight of noisy points; without this stage, noise is unknown."""

    name: ClassVar = "weigh_by_noise"
    looks_ahead: ClassVar = False
    needs: ClassVar = frozenset()

    def __call__(self, frames: Iterable[BodyObservation], target: Target) -> Iterator[BodyObservation]:
        return weighed(frames, target.settings.noise)


def range_noise(
    points: Float32[np.ndarray, "point 3"], origin: Float32[np.ndarray, "3"], joined: bool = False
) -> float:
    """Standard deviation of the points' distances from their sensor, metres: median residual of planes fitted to each
    point's neighbours in the image.

    **Arguments:** points of one sensor on a body or another surface, `origin` of the sensor; `joined`: the points are
    on all sides of it, so that neighbours in its image need not be neighbours on the surface.

    Overestimated where neighbours are so far apart that the surface is curved between them. NaN for fewer than FEWEST
    points.
    """
    if len(points) < FEWEST:
        return float("nan")
    rays = (points[:: len(points) // MOST + 1] - origin).astype(float)
    distance = np.linalg.norm(rays, axis=1)
    rays /= np.maximum(distance, 1e-6)[:, None]
    axes = np.linalg.svd(rays.mean(0)[None])[2][1:]  # across the direction that the points are in
    places = rays @ axes.T
    found_by = rays * distance[:, None] if joined else places
    near = KDTree(found_by).query(found_by[:: len(found_by) // ASKED + 1], k=NEIGHBOURS)[1]
    across, along = places[near], distance[near]
    across = across - across.mean(1, keepdims=True)
    along = along - along.mean(1, keepdims=True)
    across /= np.maximum(np.sqrt(np.mean(across**2, axis=(1, 2), keepdims=True)), 1e-9)
    normal = np.einsum("nki,nkj->nij", across, across) + 1e-6 * np.eye(2)  # a single row of points is no plane
    slope = np.linalg.solve(normal, np.einsum("nki,nk->ni", across, along)[..., None])[..., 0]
    left = along - np.einsum("nki,ni->nk", across, slope)
    return float(np.median(np.sqrt(np.sum(left**2, 1) / (NEIGHBOURS - 3))))


def _noise_of(frame: BodyObservation, points: Float32[np.ndarray, "point 3"], origin: np.ndarray) -> float:
    """The noise of one sensor's points in a frame, which may be those of several whose clouds were joined."""
    if has_far_sides([frame]) and (noise := range_noise(points, origin, joined=True)) < CLEAN:
        return noise
    return range_noise(points, origin)


def weighed(frames: Iterable[BodyObservation], usual: float) -> Iterator[BodyObservation]:
    """The frames with the noise of their points, and with weights: 1 for points with a noise of `usual` metres or less,
    less for others, in inverse proportion to their variance; times the weight that they have already.

    Between measurements noise grows with the square of the distance. `usual` 0: weights are unchanged.
    """
    growth: dict[int, float] = {}  # of each sensor: noise over the square of the distance, 1/metres
    for number, frame in enumerate(frames):
        noise = np.zeros(len(frame.points), np.float32)
        sensors = (
            np.flatnonzero(np.bincount(frame.sensor)).tolist() if len(frame.origins) > 1 else [0] * bool(len(noise))
        )
        for sensor in sensors:
            mine = frame.sensor == sensor if len(sensors) > 1 else slice(None)
            points, origin = frame.points[mine], frame.origins[sensor]
            # of all together: by its own distance, a point that errs towards the sensor would weigh more
            some = points[:: len(points) // ASKED + 1].T - origin[:, None]
            square = float(quantile(np.einsum("ij,ij->j", some, some), 0.5))
            if sensor not in growth or number % EVERY == 0:
                found = _noise_of(frame, points, origin) / max(square, 1e-6)
                if np.isfinite(found):
                    growth[sensor] = found
            noise[mine] = growth.get(sensor, 0.0) * square
        if not len(noise):
            yield frame
            continue
        typical = float(np.median(noise)) if len(sensors) > 1 else float(noise[0])
        if usual <= 0 or not (noise > usual).any():
            yield replace(frame, noise=typical)
            continue
        given = np.ones(len(noise), np.float32) if frame.weight is None else frame.weight
        weight = given * np.minimum(1.0, (usual / np.maximum(noise, 1e-6)) ** 2).astype(np.float32)
        doubt = float(np.sum(given) / max(float(np.sum(weight)), 1e-9))
        yield replace(frame, noise=typical, weight=weight, doubt=doubt)
