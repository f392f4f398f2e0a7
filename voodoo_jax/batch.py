"""Ragged frames to padded, masked arrays: the only place where array shapes are decided."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from voodoo_jax.body import Topology
from voodoo_jax.kernels.correspond import Points
from voodoo_jax.kernels.features import Features
from voodoo_jax.person import PersonFrame
from voodoo_jax.settings import FeatureSettings, check_pairs

# Point capacities; a program is compiled once for each that occurs.
BUCKETS = (256, 512, 1024, 2048, 4096, 8192)
FEATURE_BUCKETS = (0, 8, 64, 512)


class Chunk(NamedTuple):
    """Some consecutive frames, padded to a fixed number of frames and points."""

    points: Points  # leading axis: frame
    seconds: np.ndarray  # [frame] float32 since the frame before; 0 for padding
    valid: np.ndarray  # [frame] bool: False for padding
    left_out: int  # points beyond the capacity, over all frames


def bucket(count: int, buckets: tuple[int, ...] = BUCKETS) -> int:
    """Smallest capacity that holds `count` entries, or the largest there is."""
    return next((b for b in buckets if b >= count), buckets[-1])


class FeatureNames:
    """Which point of the body each name in a log is, and what it weighs; names that are neither are counted."""

    def __init__(self, topology: Topology, settings: FeatureSettings):
        points = {name: i for i, name in enumerate((*topology.sites, *topology.centres))}
        # a site and a joint centre of one name: the centre, which tracks report
        alias = check_pairs("features.names", settings.names, numbers=False)
        self.point = {**points, **{name: points[target] for name, target in alias.items() if target in points}}
        self.weights = {
            name: float(value) for name, value in check_pairs("features.weights", settings.weights, True).items()
        }
        self.weight = settings.weight
        self.unknown: dict[str, int] = {}  # name -> how often it came
        self.left_out = 0  # features beyond the capacity

    def find(self, name: str) -> tuple[int, float] | None:
        """Row of kernels.features.named_points and weight; None for a name that the body does not have."""
        name = V1_NAMES.get(name, name)
        if name not in self.point:
            self.unknown[name] = self.unknown.get(name, 0) + 1
            return None
        return self.point[name], self.weights.get(name, self.weight)


# H-Anim v1 names that logs still use
V1_NAMES = {
    "l_wrist": "l_radiocarpal",
    "r_wrist": "r_radiocarpal",
    "l_ankle": "l_talocrural",
    "r_ankle": "r_talocrural",
    "skull_tip": "skull_vertex",
}


def pad_features(frames: list[PersonFrame], length: int, capacity: int, names: FeatureNames) -> Features | None:
    """Named features of `frames`, padded to [length, capacity]; None where the capacity is zero."""
    if capacity == 0:
        return None
    point = np.zeros((length, capacity), np.int32)
    origin, direction = np.zeros((2, length, capacity, 3), np.float32)
    weight = np.zeros((length, capacity), np.float32)
    for i, frame in enumerate(frames):
        rays, pairs = frame.rays, frame.pairs
        rows = [(n, rays.origins[k], rays.directions[k]) for k, n in enumerate(rays.names)]
        rows += [(n, pairs.points[k], np.zeros(3)) for k, n in enumerate(pairs.names)]
        known = [(found, o, d) for n, o, d in rows if (found := names.find(n)) is not None]
        names.left_out += max(0, len(known) - capacity)
        for k, ((row, w), o, d) in enumerate(known[:capacity]):
            point[i, k], weight[i, k], origin[i, k], direction[i, k] = row, w, o, d
    return Features(jnp.asarray(point), jnp.asarray(origin), jnp.asarray(direction), jnp.asarray(weight))


def pad_frames(
    frames: list[PersonFrame],
    capacity: int,
    length: int,
    previous_ns: int | None,
    sensors: int,
    most: int | None = None,
) -> Chunk:
    """Pads `frames` to `length` frames of `capacity` points each.

    More points than `most` (the capacity) are thinned at random, the same way on every run, and counted. Padded points
    lie on the first sensor with weight zero (pitfall P7: finite, never NaN).
    """
    most = capacity if most is None else min(most, capacity)
    xyz = np.zeros((length, capacity, 3), np.float32)
    weight = np.zeros((length, capacity), np.float32)
    sensor = np.zeros((length, capacity), np.int32)
    origins = np.zeros((length, sensors, 3), np.float32)
    seconds, valid = np.zeros(length, np.float32), np.zeros(length, bool)
    left_out = 0
    for i, frame in enumerate(frames):
        n = len(frame.points)
        chosen = np.arange(n)
        if n > most:
            # seeded by the stamp: the choice does not depend on how a recording is cut into chunks
            rng = np.random.default_rng(frame.time_ns & 0xFFFFFFFFFFFF)
            chosen = np.sort(rng.permutation(n)[:most])
            left_out += n - most
        m = len(chosen)
        origins[i] = frame.origins
        xyz[i] = frame.origins[0]
        xyz[i, :m] = frame.points[chosen]
        weight[i, :m] = 1.0
        sensor[i, :m] = frame.sensor[chosen]
        valid[i] = True
        if previous_ns is not None:
            seconds[i] = (frame.time_ns - previous_ns) / 1e9
        previous_ns = frame.time_ns
    points = Points(jnp.asarray(xyz), jnp.asarray(weight), jnp.asarray(sensor), jnp.asarray(origins))
    return Chunk(points, seconds, valid, left_out)
