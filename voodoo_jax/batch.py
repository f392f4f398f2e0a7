"""Ragged frames to padded, masked arrays: the only place where array shapes are decided."""

from typing import NamedTuple

import jax
import numpy as np

from voodoo_jax.config.options import FeatureSettings
from voodoo_jax.config.toml import check_pairs
from voodoo_jax.kernels.correspondences import FREE, ON_BODY, Points
from voodoo_jax.kernels.landmarks import Features
from voodoo_jax.model.body import Topology
from voodoo_jax.model.marker_sets import PLUG_IN_GAIT, plain_name
from voodoo_jax.records.observation import PersonFrame

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
    """Which point of the body each name in a log is, and what it weighs."""

    def __init__(self, topology: Topology, settings: FeatureSettings):
        points = {name: i for i, name in enumerate((*topology.sites, *topology.centres))}
        # a site and a joint centre of one name: the centre, which tracks report
        alias = PLUG_IN_GAIT | check_pairs("features.names", settings.names, numbers=False)
        self.rows: dict[str, tuple[int, ...]] = {name: (row,) for name, row in points.items()}
        for name, targets in alias.items():
            known = tuple(points[target] for target in targets.split("|") if target in points)
            if known:
                self.rows[name] = known
        weights = check_pairs("features.weights", settings.weights, numbers=True)
        self.weights = {self.plain(name): float(value) for name, value in weights.items()}
        self.weight = settings.weight

    def choices(self, names: set[str]) -> int:
        """How many points of the body the most ambiguous of the names may stand for."""
        return max((len(self.look_up(n) or ()) for n in names), default=1) or 1

    def look_up(self, name: str) -> tuple[int, ...] | None:
        """Rows of kernels.features.named_points that a name may stand for; None: the body has no such name."""
        return self.rows.get(self.plain(name))

    def plain(self, name: str) -> str:
        """The name under which a feature is looked up, whatever standard and prefix the log has it from."""
        name = V1_NAMES.get(name, name)
        return name if name in self.rows else plain_name(name)

    def find(self, name: str) -> tuple[tuple[int, ...], float] | None:
        """Rows of kernels.features.named_points, of which the feature is one, and weight; None for a name that the
        body does not have."""
        name = self.plain(name)
        if name not in self.rows:
            return None
        return self.rows[name], self.weights.get(name, self.weight)


class PartNames:
    """Limb of each part that a segmentation of the log names."""

    def __init__(self, topology: Topology):
        self.limbs = {name: i for i, name in enumerate(topology.limbs)}
        self.unknown: set[str] = set()  # parts that the body does not have: their points count as on the body

    def rows(self, frame: PersonFrame) -> np.ndarray:
        """Limb, ON_BODY or FREE of each point [point], int32."""
        if frame.part is None:
            return np.full(len(frame.points), FREE, np.int32)
        self.unknown |= {p for p in frame.parts if p != "body" and p not in self.limbs}
        table = np.array([*(self.limbs.get(p, ON_BODY) for p in frame.parts), FREE], np.int32)
        return table[frame.part]  # -1, free, is the last entry


# H-Anim v1 names that logs still use
V1_NAMES = {
    "l_wrist": "l_radiocarpal",
    "r_wrist": "r_radiocarpal",
    "l_ankle": "l_talocrural",
    "r_ankle": "r_talocrural",
    "skull_tip": "skull_vertex",
}


def pad_features(
    frames: list[PersonFrame], length: int, capacity: int, names: FeatureNames, choices: int = 1
) -> Features | None:
    """Named features of `frames`, padded to [length, capacity], more are left out; None where the capacity is zero."""
    if capacity == 0:
        return None
    point = np.zeros((length, capacity, choices), np.int32)
    origin, direction = np.zeros((2, length, capacity, 3), np.float32)
    weight = np.zeros((length, capacity), np.float32)
    for i, frame in enumerate(frames):
        rays, pairs = frame.rays, frame.pairs
        ones = np.ones(len(rays.names) + len(pairs.names))
        sources = [ones[: len(rays.names)] if rays.weights is None else rays.weights]
        sources += [ones[len(rays.names) :] if pairs.weights is None else pairs.weights]
        rows = [(n, rays.origins[k], rays.directions[k]) for k, n in enumerate(rays.names)]
        rows += [(n, pairs.points[k], np.zeros(3)) for k, n in enumerate(pairs.names)]
        known = [(*f, s, o, d) for (n, o, d), s in zip(rows, np.concatenate(sources)) if (f := names.find(n))]
        for k, (found, w, source, o, d) in enumerate(known[:capacity]):
            # the first one again where a name stands for fewer points than another
            point[i, k] = (found + found[:1] * choices)[:choices]
            weight[i, k], origin[i, k], direction[i, k] = w * source, o, d
    return Features(*jax.device_put((point, origin, direction, weight)))


def pad_frames(
    frames: list[PersonFrame],
    capacity: int,
    length: int,
    previous_ns: int | None,
    sensors: int,
    most: int | None = None,
    parts: PartNames | None = None,
) -> Chunk:
    """Pads `frames` to `length` frames of `capacity` points each.

    More points than `most` (the capacity) are thinned at random, the same way on every run, and counted. Padded points
    lie on the first sensor with weight zero (pitfall P7: finite, never NaN). `parts` None: all points are free.
    """
    most = capacity if most is None else min(most, capacity)
    xyz = np.zeros((length, capacity, 3), np.float32)
    weight, doubt = np.zeros((length, capacity), np.float32), np.ones(length, np.float32)
    sensor = np.zeros((length, capacity), np.int32)
    origins = np.zeros((length, sensors, 3), np.float32)
    limb = np.full((length, capacity), FREE, np.int32)
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
        weight[i, :m] = 1.0 if frame.weight is None else frame.weight[chosen]
        if parts is not None:
            limb[i, :m] = parts.rows(frame)[chosen]
        sensor[i, :m] = frame.sensor[chosen]
        valid[i], doubt[i] = True, frame.doubt
        if previous_ns is not None:
            seconds[i] = (frame.time_ns - previous_ns) / 1e9
        previous_ns = frame.time_ns
    points = Points(*jax.device_put((xyz, weight, sensor, origins, None if parts is None else limb, doubt)))
    return Chunk(points, seconds, valid, left_out)
