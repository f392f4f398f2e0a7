"""Finds the calibration and the coordinate frame of a topic."""

import re
from dataclasses import replace

import numpy as np

from voodoo_jax.io.decode.registry import DEPTH_KINDS
from voodoo_jax.io.topic import Topic
from voodoo_jax.records.messages import RAYS, Calibration, Image

BODY_OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # from optical axes to those of a body (REP 103)


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
