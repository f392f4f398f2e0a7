"""Ragged frames to padded, masked arrays: the only place where array shapes are decided."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from voodoo_jax.kernels.correspond import Points
from voodoo_jax.person import PersonFrame

# Point capacities; a program is compiled once for each that occurs.
BUCKETS = (256, 512, 1024, 2048, 4096, 8192)


class Chunk(NamedTuple):
    """Some consecutive frames, padded to a fixed number of frames and points."""

    points: Points  # leading axis: frame
    seconds: np.ndarray  # [frame] float32 since the frame before; 0 for padding
    valid: np.ndarray  # [frame] bool: False for padding
    left_out: int  # points beyond the capacity, over all frames


def bucket(count: int) -> int:
    """Smallest capacity that holds `count` points, or the largest there is."""
    return next((b for b in BUCKETS if b >= count), BUCKETS[-1])


def pad_frames(
    frames: list[PersonFrame], capacity: int, length: int, previous_ns: int | None, sensors: int, seed: int = 0
) -> Chunk:
    """Pads `frames` to `length` frames of `capacity` points each.

    More points than the capacity are thinned at random, the same way on every run; how many is counted. Padded points
    lie on the first sensor with weight zero (pitfall P7: finite, never NaN).
    """
    xyz = np.zeros((length, capacity, 3), np.float32)
    weight = np.zeros((length, capacity), np.float32)
    sensor = np.zeros((length, capacity), np.int32)
    origins = np.zeros((length, sensors, 3), np.float32)
    seconds, valid = np.zeros(length, np.float32), np.zeros(length, bool)
    left_out = 0
    for i, frame in enumerate(frames):
        n = len(frame.points)
        chosen = np.arange(n)
        if n > capacity:
            # seeded by the stamp: the choice does not depend on how a recording is cut into chunks
            rng = np.random.default_rng((seed, frame.time_ns & 0xFFFFFFFFFFFF))
            chosen = np.sort(rng.permutation(n)[:capacity])
            left_out += n - capacity
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
