"""C3D, points for biomechanics: joint centres and the body's landmarks; millimetres, z up, at an even rate.

POINT:UNITS, X_SCREEN and Y_SCREEN state units and axes, POINT:DESCRIPTIONS what each point is. A point without pose has
the residual -1, as the format says. Needs ezc3d.
"""

import os

import ezc3d
import numpy as np

from voodoo_jax.exporters.frames import evenly, upright
from voodoo_jax.exporters.trc import named_points
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing

MILLIMETRES = 1000.0


def write(tracks: Tracks, path: str | os.PathLike[str]) -> None:
    """Writes the points. Raises OSError."""
    tracks, rate = evenly(tracks)
    names, points = named_points(tracks)
    points = MILLIMETRES * points @ upright(tracks).T
    there = np.isfinite(points).all(2).T
    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    point["UNITS"]["value"] = ["mm"]
    point["RATE"]["value"] = [rate]
    point["LABELS"]["value"] = names
    centres = len(tracks.joint_names)
    what = ["joint centre"] * centres + ["landmark of the tracked body"] * (len(names) - centres)
    point["DESCRIPTIONS"]["value"] = what
    file.add_parameter("POINT", "X_SCREEN", ["+X"])
    file.add_parameter("POINT", "Y_SCREEN", ["+Z"])
    file.add_parameter("MANUFACTURER", "SOFTWARE", ["voodoo_jax"])
    data = np.ones((4, len(names), len(points)))
    data[:3] = np.where(there, points.transpose(2, 1, 0), np.nan)
    file["data"]["points"] = data
    file["data"]["meta_points"]["residuals"] = np.where(there, 0.0, -1.0)[None]
    with replacing(path, ".c3d") as partial:  # ezc3d adds that to other names
        file.write(str(partial))
