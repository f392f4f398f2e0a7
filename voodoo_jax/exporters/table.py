"""CSV with one row for each frame: joints (metres, in the log's fixed frame), confidence, joint angles (degrees).

Names of columns say units. Fields are empty where there is nothing; `tracked` says when to believe a row.
"""

import csv
import os

import numpy as np

from voodoo_jax.exporters.frames import seconds
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing


def write(tracks: Tracks, path: str | os.PathLike[str]) -> None:
    """Writes the table. Raises OSError."""
    names, angles = tracks.body.topology.centres, tracks.angles()
    header = ["frame_id", "time_ns", "time_s", "tracked", "residual_m"]
    header += [f"{name}_{axis}_m" for name in names for axis in "xyz"]
    header += [f"{name}_confidence" for name in names]
    header += [f"{name}_deg" for name in angles.columns]
    sure = tracks.joint_confidence
    sure = np.full(tracks.joints.shape[:2], np.nan) if sure is None else sure
    blocks = [tracks.residual[:, None], tracks.joints.reshape(len(sure), -1), sure, np.degrees(angles.table)]
    digits = [6] * (1 + 3 * len(names)) + [4] * len(names) + [3] * len(angles.columns)
    rows = np.concatenate([np.asarray(block, float) for block in blocks], 1)
    with replacing(path) as partial, open(partial, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for stamp, time, tracked, row in zip(tracks.time_ns.tolist(), seconds(tracks), tracks.tracked, rows):
            values = [f"{value:.{n}f}" if np.isfinite(value) else "" for value, n in zip(row, digits)]
            writer.writerow([tracks.fixed_frame, stamp, f"{time:.9f}", int(tracked), *values])
