"""Opens MCAP logs, or reads them whole: depth images, point clouds and named features, found by type, as frames in one
fixed frame. Poses of frames and kinds of distances are checked against planes in the first images.
"""

from typing import NamedTuple

import numpy as np

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.as_shown import TELLING, calibrated, flat_share, planes, seen_pixels
from voodoo_jax.io.calibrations import BODY_OPTICAL
from voodoo_jax.io.container import LogError, LogFile, Place
from voodoo_jax.io.log_index import Scan
from voodoo_jax.io.log_summary import LogSurvey, TopicSurvey, damaged, survey
from voodoo_jax.io.opened_log import LogReader
from voodoo_jax.io.pose_rays import with_key_points
from voodoo_jax.io.read_plan import make_plan
from voodoo_jax.records.recording import Recording
from voodoo_jax.sensors.pose_net import check_pose_net

__all__ = ["LogError", "LogReader", "LogSurvey", "TopicSurvey", "open_log", "read_log", "survey"]

LEVEL = np.cos(np.radians(15))  # so near to upwards a normal is a floor's; by hand
# degrees, or 2 centimetres, by which a floor is off level at most where transforms are right; and the probability that
# they are where two contradict each other and nothing tells; by hand
FITS, TORN = 2.5, 0.5


class OffLevel(NamedTuple):
    """How far floor and walls are off, in units of a degree or 2 centimetres; the first of several is the best."""

    total: float
    floor: float  # a part of it; the rest is of walls


NOT_OFF, UNSEEN = OffLevel(0.0, 0.0), OffLevel(np.inf, np.inf)


def open_log(path: Place | LogFile, settings: ReadSettings | None = None) -> LogReader:
    """Scans a log and plans its frames; `frames()` of the result then yields them one by one.

    **Arguments:** `path` of a file, of a bag's folder, or those of several files that were recorded together.

    Raises LogError if the file cannot be read, holds neither usable depth data nor named features, or a name in
    `settings` is not in the log; ValueError if `settings.max_points` is less than 1; SettingsError if the networks of
    `settings.pose_net` are missing.
    """
    settings = settings or ReadSettings()
    if settings.max_points < 1:
        raise ValueError(
            f"max_points must be >= 1, not {settings.max_points}: it is how many points of a frame are kept"
        )
    if settings.pose_net:
        check_pose_net(settings.pose_net)
    scan = Scan(path, settings)
    if settings.pose_net:
        scan = with_key_points(scan, settings)
    try:
        return with_images_as_shown(with_settled_frames(scan, settings))
    except LogError as problem:
        raise LogError(f"{damaged(scan, problem)} {scan.part_of}".strip()) from problem


def read_log(path: Place, settings: ReadSettings | None = None) -> Recording:
    """Reads a whole log into memory: see `open_log`, `LogReader.frames` and `Recording`. Raises as `open_log`."""
    return read_whole(open_log(path, settings))


def read_whole(log: LogReader) -> Recording:
    """All frames of an opened log in memory. Raises as `LogReader.frames`."""
    frames = tuple(log.frames())
    return Recording(
        log.path, log.fixed_frame, log.up, log.sensors, frames, features=log.features, notes=log.notes,
        origin=log.origin, up_is_given=log.up_is_given, sure=log.sure,
    )  # fmt: skip


def with_settled_frames(scan: Scan, settings: ReadSettings) -> LogReader:
    """A log's reader with one of the poses, or parents, of each frame about which publishers disagree: the one with a
    level floor at height 0, if visible; else the first one."""
    reader = _planned(scan, settings)
    tree, sure, said = scan.tree, 1.0, []
    for child, ways in tree.torn.items():
        if reader.sensors and not any(child in tree.way(reader.frame_name(topic)) for topic in reader.sensors):
            continue
        lines, off = [], []
        for k in range(len(ways)):
            lines.append(f'"{tree.choose(child, k)}"')
            off.append(_off_level(scan, settings))
        best, *others = sorted(range(len(ways)), key=off.__getitem__)
        decisive = is_decisive(off[best], off[others[0]])
        best, *others = (best, *others) if decisive else range(len(ways))
        tree.choose(child, best)
        why = "the floor is level with the one that is used" if decisive else "it is unknown which one is right"
        parents = dict.fromkeys(way.parent for way in ways)
        if len(parents) > 1:
            names = " and ".join(f"'{name}'" for name in parents)
            said.append(f"Frame '{child}' has {len(parents)} parents, {names}; '{ways[best].parent}' is used: {why}.")
            continue
        sure *= 1.0 if decisive else TORN
        least = min(len(way.stamps) for way in ways)
        count = f", {2 * least} times" if least else ""
        rest = ", ".join(lines[k] for k in others)
        said.append(
            f"Frame '{child}' jumps between {len(ways)} poses{count}: publishers disagree about it; {why}. "
            f"--read.transform {lines[best]} says so, {rest} that it is another."
        )
    reader = _planned(scan, settings) if said else reader
    reader.sure *= sure
    for note in said:
        reader.say(note)
    return reader


def _planned(scan: Scan, settings: ReadSettings) -> LogReader:
    return LogReader(scan, make_plan(scan, settings), settings)


def _off_level(scan: Scan, settings: ReadSettings) -> OffLevel:
    """`off_level` with the poses of frames that are chosen now; infinite where no frames can be made with them."""
    try:
        return off_level(_planned(scan, settings))
    except LogError:
        return UNSEEN


def is_decisive(best: OffLevel, other: OffLevel) -> bool:
    """Whether the better of two poses of a sensor is right, by `off_level` of both. By how much all walls are off with
    either is how the room lies in the frame."""
    room = min(best.total - best.floor, other.total - other.floor) if np.isfinite(other.floor) else 0.0
    return best.floor < FITS and other.total - room > 2 * max(best.total - room, FITS / 4)


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


def off_level(reader: LogReader, topic: str = "") -> OffLevel:
    """Deviation of the floor in a depth camera's first image from level at height 0 of the fixed frame, in units of a
    degree or 2 centimetres; the best of all cameras, or that of one; infinite without a floor. Deviations of walls from
    the axes of the frame count a tenth: rooms are often measured along them."""
    least = UNSEEN
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
        floor = float(off[level > LEVEL].min(initial=np.inf))
        least = min(least, OffLevel(floor + 0.1 * float(aside), floor))
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
