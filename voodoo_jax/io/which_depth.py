"""Finds the depth images among several of depth's type: brightness, amplitude and confidence have the same sizes,
frames and encodings. Planes decide, then the decrease of one with the other, then names.
"""

import re

import numpy as np

from voodoo_jax.geometry import lens
from voodoo_jax.io.calibrations import bare, calibration_of
from voodoo_jax.io.decode.depth import DISPARITY
from voodoo_jax.io.decode.depth_codec import raw_of
from voodoo_jax.io.decode.registry import DECODE_ERRORS
from voodoo_jax.io.image_fit import fitted
from voodoo_jax.io.image_planes import FLAT, TELLING, flat_share
from voodoo_jax.io.topic import Topic
from voodoo_jax.records.messages import Image

OTHER = {
    "ir", "infra", "infra1", "infra2", "infrared", "amplitude", "amp", "intensity", "brightness", "confidence", "conf",
    "noise", "gray", "grey", "quality", "reflectivity", "mask", "ambient", "signal",
}  # fmt: skip
DEPTH = {"depth", "distance", "range", "dist"}
FEWER = 0.5  # times the planes of the best image: who has no more is no depth; by hand
FALLS = -0.5  # correlation of the logarithms: brightness falls with the distance; by hand
STEP = 4  # every so many-th row and column is looked at


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
    share = {name: flat_share(*found)[0] if found is not None else 0.0 for name, found in shown.items()}
    order = sorted(names, key=lambda n: (-word(n) - round(4 * share[n]), topics[n].sample.encoding == DISPARITY, n))
    none: dict[str, str] = {}
    for name in names:
        for best in order:
            same = topics[best].sample.frame == topics[name].sample.frame
            if best == name or share[best] < FLAT or share[name] > FEWER * share[best]:
                continue
            if same or word(name) < 0 or _falls(shown[name], shown[best]):
                text = "no depth, judged by its content: planes such as floor and walls are in"
                none[name] = f"{text} '{best}' ({100 * share[best]:.0f} % of the pixels), and not in it"
                break
    return none, {name: place for place, name in enumerate(order)}


def _falls(one: tuple[np.ndarray, np.ndarray] | None, other: tuple[np.ndarray, np.ndarray] | None) -> bool:
    """Whether the values of one image fall where those of another one rise, pixel by pixel."""
    if one is None or other is None or one[1].shape != other[1].shape:
        return False
    a, b = one[1].ravel(), other[1].ravel()
    both = np.isfinite(a) & np.isfinite(b) & (a > 0) & (b > 0)
    if both.sum() < TELLING:
        return False
    return bool(np.corrcoef(np.log(a[both]), np.log(b[both]))[0, 1] < FALLS)
