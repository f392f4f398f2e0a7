"""Ragged frames to padded, masked arrays: the only place where array shapes are decided."""

from typing import NamedTuple

import jax
import numpy as np

from voodoo_jax.kernels.correspondences import FREE, Points
from voodoo_jax.kernels.landmarks import Features
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.solve.names import FeatureNames, PartNames

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


def pad_features(
    frames: list[BodyObservation], length: int, capacity: int, names: FeatureNames, choices: int = 1
) -> Features | None:
    """Named features of `frames`, padded to [length, capacity], more are left out; None where the capacity is zero."""
    if capacity == 0:
        return None
    point = np.zeros((length, capacity, choices), np.int32)
    origin, direction = np.zeros((2, length, capacity, 3), np.float32)
    weight = np.zeros((length, capacity), np.float32)
    looked_up: dict[tuple[str, ...], tuple[list[int], list[tuple[int, ...]], list[float]]] = {}
    for i, frame in enumerate(frames):
        rays, pairs = frame.rays, frame.pairs
        said = (*rays.names, *pairs.names)  # mostly those of the frame before
        if said not in looked_up:
            found = [(k, *f) for k, n in enumerate(said) if (f := names.find(n))][:capacity]
            # the first one again where a name stands for fewer points than another
            padded = [(rows + rows[:1] * choices)[:choices] for _, rows, _ in found]
            looked_up[said] = [k for k, *_ in found], padded, [w for *_, w in found]
        kept, rows, own = looked_up[said]
        if not kept:
            continue
        at = slice(len(kept))
        sources = [np.ones(len(some.names)) if some.weights is None else some.weights for some in (rays, pairs)]
        source = np.concatenate(sources)[kept]
        point[i, at], weight[i, at] = rows, np.array(own, source.dtype) * source
        origin[i, at] = np.concatenate([rays.origins, pairs.points])[kept]
        direction[i, at] = np.concatenate([rays.directions, np.zeros_like(pairs.points)])[kept]
    return Features(*jax.device_put((point, origin, direction, weight)))


# 7 parameters: the shapes that are decided here, each once
def pad_frames(
    frames: list[BodyObservation],
    capacity: int,
    length: int,
    previous_ns: int | None,
    sensors: int,
    most: int | None = None,
    parts: PartNames | None = None,
) -> Chunk:
    """Pads `frames` to `length` frames of `capacity` points each.

    More points than `most` (the capacity) are thinned at random, the same way on every run, and counted. Padded points
    lie on the first sensor with weight zero (docs/numerics.md#padding: finite, never NaN). `parts` None: all points are
    free.
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
