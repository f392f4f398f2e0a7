"""Checks a log's metadata against planes in its first images (floor, walls, tables): poses of frames, kinds of
distances, and which of several images of depth's type are depth: brightness, amplitude and confidence have the same
sizes, frames and encodings. Planes decide, then the decrease of one with the other, then names. Host side, NumPy.

On a plane the inverse depth is linear in pixel coordinates. For distances along the ray instead of along the optical
axis, this holds only after conversion to depths.
"""

import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from voodoo_jax.geometry import lens
from voodoo_jax.io.calibrations import bare, calibration_of, fitted
from voodoo_jax.io.decode.depth import DISPARITY
from voodoo_jax.io.decode.image_codec import raw_of
from voodoo_jax.io.decode.registry import DECODE_ERRORS
from voodoo_jax.io.topic import Topic
from voodoo_jax.records.messages import Image

SOME = 1500  # pixels that are looked at; by hand
TELLING = 100  # pixels or points with data, that suffice to show something; by hand
PLANES, TRIALS = 3, 100  # that are looked for one after the other, and draws for each; by hand
NEAR = 0.01  # of the distance: so near to a plane a pixel is on it, with the noise of depth cameras; by hand
WIDE = 0.08  # share of the pixels that make a plane; by hand
CLEARLY = 1.3  # times as many pixels on planes one way as the other, at least; by hand
FLAT = PLANES * WIDE  # share of the pixels on planes, at least, that tells something: derived, of the smallest ones
OTHER = {
    "ir", "infra", "infra1", "infra2", "infrared", "amplitude", "amp", "intensity", "brightness", "confidence", "conf",
    "noise", "gray", "grey", "quality", "reflectivity", "mask", "ambient", "signal",
}  # fmt: skip
DEPTH = {"depth", "distance", "range", "dist"}
FEWER = 0.5  # times the planes of the best image: who has no more is no depth; by hand
FALLS = -0.5  # correlation of the logarithms: brightness falls with the distance; by hand
FLAGS = 16  # different values that an image of flags or labels has at most; by hand
STEP = 4  # every so many-th row and column is looked at


class Planes(NamedTuple):
    """The planes of an image, the one with the most pixels first, in the sensor's optical frame."""

    normals: Float[np.ndarray, "plane 3"]  # unit vectors, towards the sensor
    distances: Float[np.ndarray, " plane"]  # of the sensor from it, in the image's unit
    shares: Float[np.ndarray, " plane"]  # of the pixels


def planes(ways: Float[np.ndarray, "pixel 3"], depth: Float[np.ndarray, " pixel"]) -> Planes:
    """Planes of the points `depth` times `ways` (to a depth of 1), by random samples."""
    rng = np.random.default_rng(0)
    left, inverse = np.arange(len(depth)), 1 / depth
    normals, distances, shares = [], [], []
    for _ in range(PLANES):
        if len(left) < WIDE * len(depth) or len(left) < 3:
            break
        x, y = ways[left], inverse[left]
        picked = rng.integers(0, len(left), (TRIALS, 3))
        corners = x[picked]
        good = np.abs(np.linalg.det(corners)) > 1e-4
        if not good.any():
            break
        found = np.linalg.solve(corners[good], y[picked[good]][..., None])[..., 0]
        on = np.abs(found @ x.T - y) < NEAR * y
        best = on[int(on.sum(1).argmax())]
        plane = found[0]
        for _ in range(2):
            if best.sum() < 3:
                break
            plane = np.linalg.lstsq(x[best], y[best], rcond=None)[0]
            best = np.abs(x @ plane - y) < NEAR * y
        if best.sum() < max(3, WIDE * len(depth)):
            break
        length = float(np.linalg.norm(plane))
        normals.append(-plane / length)
        distances.append(1 / length)
        shares.append(best.sum() / len(depth))
        left = left[~best]
    return Planes(np.array(normals).reshape(-1, 3), np.array(distances), np.array(shares))


def seen_pixels(
    xy: Float[np.ndarray, "row column 2"], image: Float[np.ndarray, "row column"]
) -> tuple[Float[np.ndarray, "pixel 3"], Float[np.ndarray, " pixel"]]:
    """Ways to a depth of 1, and the values, of some of the pixels that have one."""
    value = image.ravel().astype(float)
    there = np.flatnonzero(np.isfinite(value) & (value > 0))
    there = there[:: len(there) // SOME + 1]
    flat = xy.reshape(-1, 2)[there]
    fine = np.isfinite(flat).all(1)
    return np.column_stack([flat, np.ones(len(flat))])[fine], value[there][fine]


def flat_share(xy: Float[np.ndarray, "row column 2"], image: Float[np.ndarray, "row column"]) -> tuple[float, bool]:
    """Share of an image's pixels that lie on its larger planes, and whether its values are distances along the rays:
    only the right interpretation has planes. Brightness and confidence have none."""
    ways, value = seen_pixels(xy, image)
    if len(value) < TELLING:
        return 0.0, False
    depth, ray = (planes(ways, v).shares for v in (value, value / np.linalg.norm(ways, axis=1)))
    along = ray.sum() > max(FLAT, CLEARLY * depth.sum()) and ray[0] > CLEARLY * depth.max(initial=0)
    return float(ray.sum() if along else depth.sum()), bool(along)


def word(name: str) -> int:
    """Meaning of an image's name: -1 no depth, 1 depth, 0 unknown."""
    last = [{*re.split(r"[^a-z0-9]+", part)} for part in bare(name).lower().replace("_", " ").split("/") if part]
    for words in last[::-1]:  # what stands last says most
        if words & DEPTH:
            return 1
        if words & OTHER:
            return -1
    return 0


def calibrated(topics: dict[str, Topic], name: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Rays to a depth of 1 [row, column, 2] of some pixels of a topic's first image, and the values there, in its unit;
    None if unknown."""
    image = topics[name].sample
    try:
        raw = raw_of(image) if isinstance(image, Image) else None
    except DECODE_ERRORS:  # said when it is read
        return None
    calibration = calibration_of(topics, name)
    if raw is None or calibration is None:
        return None
    try:
        c = fitted(calibration, image.shape)[0]
        xy = lens.pixel_rays(c.K, c.D, c.model, image.shape[1], image.shape[0], STEP)
    except ValueError:
        return None
    values = raw[::STEP, ::STEP].astype(float) * image.unit
    return xy.reshape(*values.shape, 2), values


def compared(topics: dict[str, Topic], names: list[str]) -> tuple[dict[str, str], dict[str, int]]:
    """Of images of depth's type: those without depth, and why; and the rank of the others of one camera, the best
    first."""
    if len(names) < 2:
        return {}, {}
    shown = {name: calibrated(topics, name) for name in names}
    flags = {name: found is not None and _flags(found[1]) for name, found in shown.items()}
    share = {n: 0.0 if found is None or flags[n] else flat_share(*found)[0] for n, found in shown.items()}
    order = sorted(names, key=lambda n: (-word(n) - round(4 * share[n]), topics[n].sample.encoding == DISPARITY, n))
    none: dict[str, str] = {}
    for name in names:
        for best in order:
            same = topics[best].sample.frame == topics[name].sample.frame
            if best == name or share[best] < FLAT or share[name] > FEWER * share[best]:
                continue
            if same or word(name) < 0 or flags[name] or _falls(shown[name], shown[best]):
                text = "no depth, judged by its content: planes such as floor and walls are in"
                none[name] = f"{text} '{best}' ({100 * share[best]:.0f} % of the pixels), and not in it"
                break
    return none, {name: place for place, name in enumerate(order)}


def _flags(values: np.ndarray) -> bool:
    """Whether an image has so few different values that it is none of depth beside another one: each of them would be a
    plane straight ahead, as a wall may be."""
    return len(np.unique(values[np.isfinite(values) & (values > 0)])) <= FLAGS


def _falls(one: tuple[np.ndarray, np.ndarray] | None, other: tuple[np.ndarray, np.ndarray] | None) -> bool:
    """Whether the values of one image fall where those of another one rise, pixel by pixel."""
    if one is None or other is None or one[1].shape != other[1].shape:
        return False
    a, b = one[1].ravel(), other[1].ravel()
    both = np.isfinite(a) & np.isfinite(b) & (a > 0) & (b > 0)
    if both.sum() < TELLING:
        return False
    return bool(np.corrcoef(np.log(a[both]), np.log(b[both]))[0, 1] < FALLS)
