"""Transforms of a sensor that moves, stamped later or earlier than it was there: the room tells. Host side, NumPy.

What is at rest is seen at one place from everywhere: the points of many messages fill the fewest voxels if each is put
where the sensor was (crispness of a cloud: Sheehan, Harrison, Newman 2012, doi:10.1177/0278364911429475).
"""

import numpy as np

from voodoo_jax.detect.delays import LEAST, REACH, STEP, WINDOW
from voodoo_jax.io.log_reader import LogReader

MESSAGES, POINTS = 24, 3000  # of each sensor, and of each message: measured to tell 0.15 s to 0.01 s
VOXEL = 0.06  # metres: twice the noise of depth at 4 m (Khoshelham and Elberink 2012, doi:10.3390/s120201437)
FAR = 3.0  # metres: how far away what a turning sensor sees is, usually (measured: 2.5 to 5.5 in the recordings)
COARSE = 0.05  # seconds between offsets that are tried at first: measured, voxels fall from 0.3 s on all the way
FEWER = 0.9  # of the voxels without an offset: measured 0.68 with 0.15 s, 1.00 without


def late_transforms(reader: LogReader) -> dict[str, float]:
    """Seconds by which the stamps of transform topics are late, where the static room determines them. Sensors at rest,
    or hardly moving, determine none."""
    found: dict[str, float] = {}
    for topic in reader.sensors:
        topics = reader.moved_by(topic)
        if not topics or topics & found.keys():
            continue
        by = _late(reader.coarse(POINTS), topic)
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
