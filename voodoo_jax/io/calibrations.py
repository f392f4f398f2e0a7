"""Finds the calibration and the coordinate frame of a topic, and adapts it to images of another size: scaled, cropped,
a region of interest, binning."""

import re
from dataclasses import replace

import numpy as np

from voodoo_jax.io.decode.registry import DEPTH_KINDS
from voodoo_jax.io.topic import Topic
from voodoo_jax.records.messages import RAYS, Calibration, Image

ALIKE = 0.02  # of each other: rounding to whole pixels, as 424 x 240 from 1280 x 720, changes factors by no more
PARTS = (2, 3, 4)  # every second, third or fourth row is kept: as likely as a crop to so little
CROPPED = "assumed to be cropped about its centre (if not, give its calibration by read.camera)"
LEAST = 0.4  # of the picture: who crops to less has chosen a place, not the middle
BODY_OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # from optical axes to those of a body (REP 103)


def fitted(c: Calibration, shape: tuple[int, int]) -> tuple[Calibration, str]:
    """The calibration for images of this size, and the assumption as half a sentence; "" if none.

    Pixels stay square: if the two directions do not shrink alike, the image was cropped, about its centre. Raises
    ValueError if the change is ambiguous.
    """
    rows, columns = shape
    if not (c.width and c.height) or (c.height, c.width) == shape:
        return replace(c, width=columns, height=rows), ""
    for other in c.others:  # a region or binning that was stated, and not done
        if (other.height, other.width) == shape:
            return other, "its region of interest or binning does not fit the image, and is ignored"
    across, down = columns / c.width, rows / c.height
    if abs(across / down - 1) <= ALIKE:
        return scaled(c, shape), "scaled to fit"
    sizes = f"it is {columns} x {rows} pixels, its calibration is of {c.width} x {c.height}"
    ask = "give the right calibration by read.camera"
    if abs(columns / c.height / (rows / c.width) - 1) <= ALIKE:
        raise ValueError(f"{sizes}: the image was rotated by 90 degrees; {ask}")
    less = min(across, down) / max(across, down)
    if any(abs(less * part - 1) < 1e-6 for part in PARTS):
        raise ValueError(f"{sizes}: it was cropped, or rows or columns were left out; {ask}")
    if less < LEAST:
        raise ValueError(f"{sizes}: it was cropped, at an unknown place; {ask}")
    size = _uncropped(c, shape)
    whole = moved(scaled(c, size), ((columns - size[1]) / 2, (rows - size[0]) / 2))
    return replace(whole, width=columns, height=rows), CROPPED


def _uncropped(c: Calibration, shape: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of the image before it was cropped to `shape`."""
    factor = max(shape[1] / c.width, shape[0] / c.height)
    return round(c.height * factor), round(c.width * factor)


def leeway(c: Calibration, shape: tuple[int, int]) -> tuple[float, float]:
    """Largest offset (pixels across and down) of the centre of an image that `fitted` assumes to be cropped from that
    of the whole image; 0, 0 for others."""
    if fitted(c, shape)[1] != CROPPED:
        return 0.0, 0.0
    rows, columns = _uncropped(c, shape)
    return (columns - shape[1]) / 2, (rows - shape[0]) / 2


def moved(c: Calibration, by: tuple[float, float]) -> Calibration:
    """The calibration with its principal point moved by pixels to the right and down."""
    K, P = c.K.copy(), c.P.copy()
    for matrix in (K, P):
        matrix[:2, 2] += np.array(by) * matrix[2, 2]
    return replace(c, K=K, P=P)


def scaled(c: Calibration, shape: tuple[int, int]) -> Calibration:
    """The calibration for images of another size (rows, columns) that show the same."""
    rows, columns = shape
    if not (c.width and c.height) or (c.height, c.width) == shape:
        return replace(c, width=columns, height=rows)
    scale = np.array([columns / c.width, rows / c.height])
    K, P = c.K.copy(), c.P.copy()
    for matrix in (K, P):
        matrix[:2] *= scale[:, None]
        matrix[:2, 2] += 0.5 * scale - 0.5
    return replace(c, width=columns, height=rows, K=K, P=P)


def bare(topic: str) -> str:
    """Topic of the raw image, without the suffix of image_transport for a compressed one."""
    return topic.removesuffix("/compressedDepth").removesuffix("/compressed")


def rectified(topic: str) -> bool:
    """By ROS convention images are undistorted if their topic has `rect` in its name."""
    return re.search(r"(^|[/_])(image_)?rect(ified)?([/_]|$)", topic) is not None


def lens_of(topic: str, c: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """K and D of a topic's pixels."""
    return (c.P[:, :3].copy(), np.zeros(0)) if rectified(topic) and c.P[0, 0] > 0 else (c.K.copy(), c.D)


def calibration_of(topics: dict[str, Topic], name: str) -> Calibration | None:
    """The calibration of the same frame, else of the same namespace; of several, the one of the same size."""
    image: Image = topics[name].sample
    if topics[name].given is not None:
        return topics[name].given
    if isinstance(image, Image) and image.calibration is not None:
        return image.calibration
    space = bare(name).rsplit("/", 1)[0]
    found = []
    for other, topic in topics.items():
        c = topic.calibration
        if c is not None and (c.frame == image.frame or other.rsplit("/", 1)[0] == space):
            key = (c.frame != image.frame, (c.height, c.width) != image.shape, other.rsplit("/", 1)[0] != space, other)
            found.append((key, c))
    best = min(found, key=lambda pair: pair[0])[1] if found else None
    return topics[name].fallback or best if best is None or best.K[0, 0] <= 0 else best


def camera_of(topics: dict[str, Topic], name: str, frame: str) -> Calibration | None:
    """The camera of 2D features: that of the same frame, else of the same namespace; without a frame also the only one
    that is not a depth sensor, or the only one."""
    if (given := topics[name].given) is not None:
        return replace(given, frame=frame or given.frame)
    found = _camera_of(topics, name, frame)
    fallback = topics[name].fallback
    return replace(fallback, frame=frame or fallback.frame) if found is None and fallback is not None else found


def _camera_of(topics: dict[str, Topic], name: str, frame: str) -> Calibration | None:
    space = name.rsplit("/", 1)[0]
    known = {other: t.calibration for other, t in sorted(topics.items()) if t.calibration is not None}
    near = {other: c for other, c in known.items() if other.rsplit("/", 1)[0] == space}
    same = [c for c in (*near.values(), *known.values()) if frame and c.frame == frame]
    if same or near or frame:
        return next(iter([*same, *near.values()]), None)
    depth = [n for n, t in topics.items() if t.kind in DEPTH_KINDS and t.sample is not None]
    taken = {topics[n].sample.frame for n in depth}
    taken_topics = {n.rsplit("/", 1)[0] for n in depth}
    free = [c for o, c in known.items() if c.frame not in taken and o.rsplit("/", 1)[0] not in taken_topics]
    only = free if len(free) == 1 else list(known.values())
    return only[0] if len(only) == 1 else None


def frame_of(topics: dict[str, Topic], name: str) -> str:
    """Name of the coordinate frame in which the first measurement of a topic is given."""
    topic = topics[name]
    if topic.gathered is None:
        return topic.sample.frame
    frame = topic.gathered.frames[0]
    found = camera_of(topics, name, frame) if topic.kind == RAYS else None
    return frame or (found.frame if found else "")
