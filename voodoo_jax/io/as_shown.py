"""Checks a log's metadata against planes in its first images: poses of frames, kinds of distances."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from voodoo_jax.io.calibrations import BODY_OPTICAL
from voodoo_jax.io.image_planes import TELLING, flat_share, planes, seen_pixels
from voodoo_jax.io.which_depth import calibrated

if TYPE_CHECKING:
    from voodoo_jax.io.log_reader import LogReader

LEVEL = np.cos(np.radians(15))  # so near to upwards a normal is a floor's; by hand
# degrees, or 2 centimetres, by which a floor is off level at most where transforms are right; and the probability that
# they are where two contradict each other and nothing tells; by hand
FITS, TORN = 2.5, 0.5


def with_settled_frames(reader: LogReader) -> LogReader:
    """The reader with one of the two poses of each frame about which two publishers disagree: the one with a level
    floor at height 0, if visible."""
    for child, both in reader.scan.tree.torn.items():
        count = 2 * min(len(e.stamps) for e in both)
        off, lines = zip(*((off_level(reader), line) for line in (reader.scan.tree.choose(child, k) for k in (0, 1))))
        best = int(np.argmin(off))
        reader.scan.tree.choose(child, best)
        decisive = is_decisive(off[best], off[1 - best])
        reader.sure *= 1.0 if decisive else TORN
        why = "the floor is level with the one that is used" if decisive else "it is unknown which one is right"
        reader.say(
            f"Frame '{child}' jumps between two poses, {count} times: two publishers disagree about it; {why}. "
            f'--read.transform "{lines[best]}" says so, "{lines[1 - best]}" that it is the other.'
        )
    return reader


def is_decisive(best: float, other: float) -> bool:
    """Whether the better of two poses of a sensor is right, by `off_level` of both."""
    return best < FITS and other > 2 * max(best, FITS / 4)


def with_images_as_shown(reader: LogReader) -> LogReader:
    """The reader with depth images interpreted as their planes show: as distances along the rays, or as optical images
    in a frame of a camera's body."""
    for topic in reader.sensors:
        if not reader.is_image(topic) or (found := calibrated(reader.scan.topics, topic)) is None:
            continue
        xy, values = found
        if topic not in reader.measuring.radial and flat_share(xy, values)[1]:
            reader.measuring.radial[topic] = True
            reader.say(
                f"'{topic}' has distances along the rays, not along the optical axis, as its planes show "
                f"(read.radial={topic}=yes; =no says that they are depths)."
            )
        if in_body_frame(reader, topic, xy, values):
            reader.measuring.of_body |= {topic}
            reader.say(
                f"'{topic}' is given in '{reader.frame_name(topic)}', in which its floor would be upright: that is "
                "the frame of a camera's body. Its images are treated as optical (z forwards, x to the right) there. "
                "To override, give the transform of an optical frame, or set read.up."
            )
    return reader


def off_level(reader: LogReader, topic: str = "") -> float:
    """Deviation of the floor in a depth camera's first image from level at height 0 of the fixed frame, in units of a
    degree or 2 centimetres; the best of all cameras, or that of one; infinite without a floor. Deviations of walls from
    the axes of the frame count a tenth: rooms are often measured along them."""
    least = np.inf
    for name in (topic,) if topic else reader.sensors:
        found = calibrated(reader.scan.topics, name) if reader.is_image(name) else None
        at = int(reader.stamps(name)[0])
        pose = reader.scan.tree.lookup(reader.fixed_frame, reader.frame_name(name), at, hold_ns=None)
        if found is None or pose is None:
            continue
        ways, value = seen_pixels(*found)
        seen = planes(ways, value) if len(value) >= TELLING else None
        if seen is None or not len(seen.shares):
            continue
        normals = seen.normals @ pose[0].T
        level = normals @ reader.up
        walls = normals[np.abs(level) < 0.2]
        aside = np.degrees(np.arccos(np.clip(np.abs(walls).max(1), 0, 1))).mean() if len(walls) else 0.0
        heights = float((pose[1] + reader.origin) @ reader.up) - seen.distances
        off = np.degrees(np.arccos(np.clip(level, -1, 1))) + np.abs(heights) / 0.02
        least = min(least, float(off[level > LEVEL].min(initial=np.inf)) + 0.1 * float(aside))
    return least


def in_body_frame(reader: LogReader, topic: str, xy: np.ndarray, values: np.ndarray) -> bool:
    """Whether the floor in a topic's first image is level, by the transforms, only if its frame is that of a camera's
    body."""
    frame, tree = reader.frame_name(topic), reader.scan.tree
    pose = tree.lookup(reader.fixed_frame, frame, int(reader.stamps(topic)[0]), hold_ns=None)
    if reader.up_is_given or pose is None or frame == tree.root(frame) or "optical" in frame.lower():
        return False
    ways, value = seen_pixels(xy, values)
    if len(value) < TELLING:
        return False
    length = np.linalg.norm(ways, axis=1) if reader.measuring.radial.get(topic) else 1.0
    normals = planes(ways, value / length).normals
    stated, body = (np.max(normals @ turn.T @ reader.up, initial=-1.0) for turn in (pose[0], pose[0] @ BODY_OPTICAL))
    return bool(stated < LEVEL < body)
