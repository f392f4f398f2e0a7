"""CSV with one row for each frame: joints (metres, in the log's fixed frame), confidence, joint angles (degrees).

Names of columns say units. Fields are empty where there is nothing; `tracked` says when to believe a row.
"""

import csv
import os

import numpy as np

from voodoo_jax.records.tracks import Tracks, track_columns
from voodoo_jax.storage.atomic import replacing

DIGITS = {"_s": 9, "_m": 6, "_confidence": 4, "_deg": 3}  # behind the point, by how a column's name ends


def write(tracks: Tracks, path: str | os.PathLike[str]) -> None:
    """Writes the table. Raises OSError."""
    columns = track_columns(tracks)
    texts = [[tracks.fixed_frame] * len(tracks.time_ns)]
    for name, values in columns.items():
        digits = next((n for end, n in DIGITS.items() if name.endswith(end)), None)
        if digits is None:
            texts.append([str(int(value)) for value in values])
        else:
            texts.append([f"{value:.{digits}f}" if np.isfinite(value) else "" for value in values])
    with replacing(path) as partial, open(partial, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["frame_id", *columns])
        writer.writerows(zip(*texts))
