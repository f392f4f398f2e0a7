"""Clocks that differ by a part of a second. Host side, NumPy.

Several computers': a moving object is at one place at a time; if stamps of two sensors differ, it seems to be at two,
whose distance is proportional to its speed. Transforms of a sensor that moves, stamped later or earlier than it was
there: what is at rest is seen at one place from everywhere, so the points of many messages fill the fewest voxels if
each is put where the sensor was (crispness of a cloud: Sheehan, Harrison, Newman 2012, doi:10.1177/0278364911429475).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import TELLING, Build
from voodoo_jax.detect.find_gravity import upright
from voodoo_jax.detect.motion import AWAY
from voodoo_jax.detect.scene import STEEPEST, find_scene
from voodoo_jax.detect.segmentation import BodySegmenter
from voodoo_jax.io.opened_log import LogReader

MESSAGES, ROOM_POINTS = 24, 3000  # of each sensor, and of each message: measured to tell 0.15 s to 0.01 s
VOXEL = 0.06  # metres: twice the noise of depth at 4 m (Khoshelham and Elberink 2012, doi:10.3390/s120201437)
FAR = 3.0  # metres: how far away what a turning sensor sees is, usually (measured: 2.5 to 5.5 in the recordings)
COARSE = 0.05  # seconds between offsets that are tried at first: measured, voxels fall from 0.3 s on all the way
FEWER = 0.9  # of the voxels without an offset: measured 0.68 with 0.15 s, 1.00 without
WINDOW, MOST = 15.0, 80  # seconds at the beginning, and messages of each sensor in them, that are looked at; by hand
POINTS = 8000  # of each message, and of those of opening.py; by hand
SHARE = 0.5  # of the messages have points of the body, at least; by hand
REACH, STEP = 1.0, 0.01  # seconds: so far offsets are looked for, and how finely; by hand
LEAST, BETTER, APART = 0.06, 0.5, 0.04  # seconds, share of the distance at no offset, metres less than that; by hand
CLOSE = 0.08  # metres: so near both must be then, measured 0.02 to 0.03; else it is not the same that they see


def late_transforms(reader: LogReader) -> dict[str, float]:
    """Seconds by which the stamps of transform topics are late, where the static room determines them. Sensors at rest,
    or hardly moving, determine none."""
    found: dict[str, float] = {}
    for topic in reader.sensors:
        topics = reader.moved_by(topic)
        if not topics or topics & found.keys():
            continue
        by = _late(reader.coarse(ROOM_POINTS), topic)
        found |= dict.fromkeys(topics, by) if by else {}
    return found


def _late(reader: LogReader, topic: str) -> float:
    tree, name, stamps = reader.scan.tree, reader.frame_name(topic), reader.stamps(topic)
    began = _moves_from(reader, topic)
    looks = []  # time and points in the sensor's frame
    ended = min(began + round(WINDOW * 1e9), int(stamps.max(initial=0)))
    times = np.linspace(began, ended, MESSAGES).astype(np.int64)
    for sample in reader.sampled(topic, MESSAGES, at=times) if began >= 0 else ():
        frame, at = reader.frame_of(topic, sample), int(stamps[sample.number])
        there = tree.lookup(reader.fixed_frame, name, at)
        if frame is not None and there is not None:
            looks.append((at, (frame.points - there[1]) @ there[0]))
    if len(looks) < MESSAGES // 2:
        return 0.0

    def voxels(late: float) -> float:
        """Number of filled voxels, as a share of the points, if the transforms are late by that many seconds."""
        cells = []
        for at, points in looks:
            if (there := tree.lookup(reader.fixed_frame, name, at + round(late * 1e9))) is not None:
                cells.append(np.floor((points @ there[0].T + there[1]) / VOXEL).astype(np.int64))
        if len(cells) < len(looks) - MESSAGES // 4:
            return np.inf
        every = np.concatenate(cells) - np.min([c.min(0) for c in cells], 0)
        size = every.max(0) + 1
        return len(np.unique(np.ravel_multi_index(tuple(every.T), tuple(size)))) / len(every)

    none = best = voxels(0.0)
    late, reach = 0.0, REACH
    for step in (COARSE, STEP):
        for by in late + np.arange(-reach, reach + step / 2, step):
            if (now := voxels(float(by))) < best:
                best, late = now, float(by)
        reach = step
    return round(late, 2) if best < FEWER * none and LEAST <= abs(late) < REACH else 0.0


def _moves_from(reader: LogReader, topic: str) -> int:
    """Half a window before the sensor has first moved so far that it tells, nanoseconds; -1 if it never has."""
    stamps = np.sort(reader.stamps(topic))
    name, some = reader.frame_name(topic), stamps[:: max(1, len(stamps) // 500)].tolist()
    poses = [(at, pose) for at in some if (pose := reader.scan.tree.lookup(reader.fixed_frame, name, at)) is not None]
    for at, (rotation, place) in poses:
        before = poses[0][1]
        turn = np.arccos(np.clip((np.trace(before[0].T @ rotation) - 1) / 2, -1, 1))
        if turn * FAR + np.linalg.norm(place - before[1]) > VOXEL:
            return max(int(stamps[0]), at - round(WINDOW * 5e8))
    return -1


class Motion(NamedTuple):
    """Positions of the centre of the moving points."""

    time: Float[np.ndarray, " message"]  # seconds
    place: Float[np.ndarray, "message 3"]  # metres, fixed frame
    view: Float[np.ndarray, "3"]  # unit, from the sensor


def offsets(reader: LogReader, build: Build, settings: DetectSettings) -> dict[str, float]:
    """Seconds by which stamps of sensors are later than those of the first one that sees motion; uncertain ones are
    left out, as are moving sensors."""
    if len(reader.sensors) < 2:
        return {}
    coarse = reader.coarse(POINTS)
    start = min(int(reader.stamps(topic).min()) for topic in reader.sensors)
    motions = {topic: found for topic in reader.sensors if (found := _motion(coarse, topic, start, build, settings))}
    first, *others = motions or ("",)
    found = {topic: offset(motions[first], motions[topic]) for topic in others}
    return {topic: by for topic, by in found.items() if by}


def _motion(reader: LogReader, topic: str, start_ns: int, build: Build, settings: DetectSettings) -> Motion | None:
    """Motion of the body in one sensor's view; None without a body."""
    stamps = reader.stamps(topic)
    count = int(np.sum(stamps < start_ns + WINDOW * 1e9))
    samples = reader.sampled(topic, MOST, step=max(1, count // MOST))
    frames = [frame for sample in samples if (frame := reader.frame_of(topic, sample)) is not None]
    if len(frames) < 10 or np.ptp([frame.origins[0] for frame in frames], axis=0).max() > 0.01:
        return None
    sure, some = bool(reader.up[2] > 0.99), frames[:: max(1, len(frames) // 4)]
    scene = find_scene(some, reader.up, sure)
    up = reader.up if reader.up_is_given else upright(some, scene, reader.up, sure, build, settings)
    finder = BodySegmenter(scene if up is reader.up else find_scene(some, up, False), build, settings)
    moving = [finder(frame).points for frame in sorted(frames, key=lambda frame: frame.time_ns)]
    there = np.array([len(points) >= TELLING for points in moving])
    if there.mean() < SHARE:
        return None
    time = np.sort([(frame.time_ns - start_ns) / 1e9 for frame in frames])[there]
    place = np.array([np.median(points, axis=0) for points in moving if len(points) >= TELLING], float)
    view = np.median(place, axis=0) - frames[0].origins[0]
    return Motion(time, place, view / max(float(np.linalg.norm(view)), 1e-6))


def offset(one: Motion, other: Motion) -> float:
    """Seconds by which the times of the other motion are later than those of the first; 0 if uncertain."""
    if np.linalg.norm(np.ptp(one.place, axis=0)) < AWAY or np.linalg.norm(np.ptp(other.place, axis=0)) < AWAY:
        return 0.0
    by = np.arange(-REACH, REACH + STEP / 2, STEP)
    alike = bool(one.view @ other.view > STEEPEST)  # both show the same side of what moves
    apart = np.array([_apart(one, other, float(b), alike) for b in by])
    if not np.isfinite(apart).any():
        return 0.0
    best, none = int(np.nanargmin(apart)), apart[len(by) // 2]
    sure = apart[best] < min(CLOSE, BETTER * none) and none - apart[best] > APART and abs(by[best]) >= LEAST
    return round(float(by[best]), 2) if sure and 0 < best < len(by) - 1 else 0.0


def _apart(one: Motion, other: Motion, by: float, alike: bool) -> float:
    """Median distance between both for a delay of the other's clock in seconds; NaN if they hardly overlap.

    Sensors that look from different sides see different sides of what moves: how far these are apart does not count.
    """
    time = other.time - by
    within = (time >= one.time[0]) & (time <= one.time[-1])
    if within.sum() < max(8, 0.5 * len(time)):
        return float("nan")
    there = np.column_stack([np.interp(time[within], one.time, one.place[:, k]) for k in range(3)])
    away = other.place[within] - there
    away = away if alike else away - np.median(away, axis=0)
    return float(np.median(np.linalg.norm(away, axis=1)))
