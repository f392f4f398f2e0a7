"""TRC, markers for OpenSim: joint centres and the body's landmarks; metres, x forwards, y up, z to the right.

Axes are OpenSim's: x is that of the fixed frame turned upright. Fields of frames and points without pose are NaN:
OpenSim cuts empty ones at the end of a line and refuses the file.
"""

import os
from pathlib import Path

import numpy as np

from voodoo_jax.exporters.frames import OPENSIM, joints, landmarks, seconds, upright, usual_rate
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing


def write(tracks: Tracks, path: str | os.PathLike[str]) -> None:
    """Writes the points of all frames with their times. Raises OSError."""
    names, points = named_points(tracks)
    points = points @ (OPENSIM @ upright(tracks)).T
    rate, count = usual_rate(tracks), len(tracks.time_ns)
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate:.6f}\t{rate:.6f}\t{count}\t{len(names)}\tm\t{rate:.6f}\t1\t{count}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i}" for i in range(1, len(names) + 1) for axis in "XYZ"),
        "",
    ]
    for number, (time, row) in enumerate(zip(seconds(tracks), points.reshape(count, 3 * len(names))), 1):
        values = [f"{value:.6f}" if np.isfinite(value) else "NaN" for value in row]
        lines.append("\t".join([str(number), f"{time:.6f}", *values]))
    with replacing(path) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")


def named_points(tracks: Tracks) -> tuple[list[str], np.ndarray]:
    """Names and places [frame, point, 3] of joint centres and landmarks, metres in the fixed frame; a landmark with the
    name of a joint centre gets the suffix `_landmark`."""
    centres = list(tracks.joint_names)
    sites = [name if name not in centres else f"{name}_landmark" for name in tracks.body.topology.sites]
    return centres + sites, np.concatenate([joints(tracks), landmarks(tracks)], 1)
