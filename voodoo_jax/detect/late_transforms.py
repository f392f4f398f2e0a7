"""Transforms of a sensor that moves, stamped later or earlier than it was there: the room tells. Host side, NumPy.

What is at rest is seen at one place from everywhere: the points of many messages fill the fewest voxels if each is put
where the sensor was (crispness of a cloud: Sheehan, Harrison, Newman 2012, doi:10.1177/0278364911429475).
"""

import numpy as np

from voodoo_jax.detect.delays import LEAST, REACH, STEP
from voodoo_jax.io.log_reader import LogReader

MESSAGES, POINTS = 24, 3000  # of each sensor, and of each message: measured to tell 0.15 s to 0.01 s
VOXEL = 0.06  # metres: twice the noise of depth at 4 m (Khoshelham and Elberink 2012, doi:10.3390/s120201437)
COARSE = 0.05  # seconds between offsets that are tried at first: measured, voxels fall from 0.3 s on all the way
FEWER = 0.9  # of the voxels without an offset: measured 0.68 with 0.15 s, 1.00 without


def late_transforms(reader: LogReader) -> dict[str, float]:
    """Seconds by which the stamps of topics of transforms are late, where the room tells. Sensors that stand still tell
    nothing, and neither does one that hardly moves."""
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
    looks = []  # time and points in the sensor's frame
    for sample in reader.sampled(topic, MESSAGES, spread=True):
        frame, at = reader.frame_of(topic, sample), int(stamps[sample.number])
        there = tree.lookup(reader.fixed_frame, name, at)
        if frame is not None and there is not None:
            looks.append((at, (frame.points - there[1]) @ there[0]))
    if len(looks) < MESSAGES // 2:
        return 0.0

    def voxels(late: float) -> float:
        """Voxels that are filled, as a share of the points, if the transforms are so many seconds late."""
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
