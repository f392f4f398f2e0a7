"""A fixed work of the kinds that a replay is made of: python experiments/bench/calibration.py

Many small calls of NumPy, few large ones, a compiled scan, decompression, and OpenCV: some third of a second each on a
processor of 2023. Prints the processor seconds of each, as JSON. What a replay costs is told as so many times their
sum, measured in the same minutes, so that other machines and what else they do cancel. It must stay as it is: who
changes it begins a new history.
"""

import json
import time
import zlib

import cv2
import jax
import jax.numpy as jnp
import numpy as np

RNG = np.random.default_rng(0)
XLA_FRAMES, XLA_POINTS, XLA_LIMBS = 1800, 1024, 12


def small_calls() -> None:
    """What finders do: thousands of calls on some hundred numbers."""
    points, grown = RNG.normal(size=(400, 3)).astype(np.float32), {}
    for turn in range(8000):
        cells = np.floor(points * np.float32(1 + turn % 7)).astype(np.int32)
        keys = np.unique((cells[:, 0] * 73 + cells[:, 1]) * 31 + cells[:, 2])
        near = np.flatnonzero(np.einsum("ni,ni->n", points, points) < 1.0)
        grown[turn % 50] = tuple(sorted((len(keys), int(near[0]), turn)))
        points[near] += np.float32(1e-6)


def large_calls() -> None:
    """Arithmetic on images as large as depth cameras have."""
    depth = RNG.uniform(1.0, 4.0, (576, 640)).astype(np.float32)
    rays = RNG.normal(size=(3, depth.size)).astype(np.float32)
    for _ in range(28):
        points = rays * depth.ravel()
        keep = np.flatnonzero((points[2] > 0.1) & (points[0] < 2.0))
        some = points[:, keep]
        np.argsort(np.floor(some[0] * 20).astype(np.int32), kind="stable")


def compiled_scan(points: jax.Array, places: jax.Array) -> jax.Array:
    """Points to the nearest of some axes, frame by frame, each from the one before."""

    def frame(state, offset):
        away = points[:, None] + offset - state
        weight = jax.nn.softmax(-jnp.sum(away**2, -1), -1)
        return state + 0.1 * jnp.einsum("pl,plk->lk", weight, away) / points.shape[0], jnp.sum(weight)

    return jax.lax.scan(frame, places, jnp.linspace(0, 1, XLA_FRAMES)[:, None])[1]


def unpacked(image: bytes, block: bytes) -> None:
    """Images and chunks of logs."""
    for _ in range(28):
        cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_UNCHANGED)
        zlib.decompress(block)


def regions() -> None:
    """Connected regions, smoothed images, other sizes."""
    image = cv2.GaussianBlur(RNG.integers(0, 255, (576, 640), dtype=np.uint8), (0, 0), 3)
    columns, rows = np.indices(image.shape, np.float32)[::-1]
    for _ in range(75):
        _, binary = cv2.threshold(image, 127, 255, cv2.THRESH_BINARY)
        cv2.connectedComponentsWithStats(binary, connectivity=4)
        cv2.remap(cv2.medianBlur(image, 5), columns, rows, cv2.INTER_LINEAR)


def main() -> None:
    """Measures each, compilation left out."""
    steps = np.cumsum(RNG.integers(-3, 4, (576, 640)), axis=1).astype(np.uint16)
    image, block = cv2.imencode(".png", steps)[1].tobytes(), zlib.compress(steps.tobytes() * 4)
    points, places = (jnp.asarray(RNG.normal(size=(n, 3)), jnp.float32) for n in (XLA_POINTS, XLA_LIMBS))
    scan = jax.jit(compiled_scan)
    scan(points, places).block_until_ready()
    work = {
        "small calls": small_calls,
        "large calls": large_calls,
        "compiled scan": lambda: scan(points, places).block_until_ready(),
        "unpacked": lambda: unpacked(image, block),
        "regions": regions,
    }
    spent = {}
    for name, one in work.items():
        began = time.process_time()
        one()
        spent[name] = round(time.process_time() - began, 4)
    print(json.dumps(spent))


if __name__ == "__main__":
    main()
