"""Skeletons of Kinect body trackers as JSON: joints become named points, one prefix for each body.

The format is that of the offline processor among Microsoft's Azure Kinect samples: `joint_names`, and `frames` with
`timestamp_usec` and `bodies`, each with `body_id` and `joint_positions` in millimetres, in the depth camera's frame.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from voodoo_jax.io.convert.target import START_NS, ConvertError, check_points, content, new_log, putter, scene_of_points
from voodoo_jax.storage.guarded import Answer

TOPIC, FRAME = "/skeletons", "depth_optical"
MILLIMETRE = 0.001


def convert(source: Path, target: Answer) -> list[str]:
    """Writes the joints of all bodies as named 3D points, metres. Raises ConvertError, OSError."""
    try:
        told = json.loads(content(source))
        names = [str(name) for name in told["joint_names"]]
        check_points(len(names), sum(len(frame["bodies"]) for frame in told["frames"]))
        frames = [_frame(frame, len(names)) for frame in told["frames"]]
    except ConvertError:
        raise
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as problem:
        raise ConvertError(
            f"'{source}' cannot be read as skeletons of a Kinect: {type(problem).__name__}: {problem}; it needs "
            "joint_names and frames with timestamp_usec and bodies with joint_positions"
        ) from problem
    bodies = {body for _, found in frames for body in found}
    if not bodies:
        raise ConvertError(f"'{source}' has no body in any frame")
    first = min(stamp for stamp, _ in frames)
    with new_log(target) as writer:
        put = putter(writer)
        for stamp, found in sorted(frames, key=lambda frame: frame[0]):
            labels, points = [], [np.zeros((0, 3))]
            for body, places in found.items():
                prefix = f"body{body}:" if len(bodies) > 1 else ""
                labels += [f"{prefix}{name}" for name in names]
                points.append(places)
            at = START_NS + 1000 * (stamp - first)
            put(TOPIC, at, scene_of_points(labels, np.concatenate(points), at, FRAME))
    return [f"{len(bodies)} bodies: their joints begin with body<id>:"] if len(bodies) > 1 else []


def _frame(frame: dict[str, Any], count: int) -> tuple[int, dict[int, np.ndarray]]:
    """Stamp in microseconds, and joints [joint, 3] of each body in metres."""
    found = {}
    for body in frame["bodies"]:
        places = np.array(body["joint_positions"], float) * MILLIMETRE
        if places.shape != (count, 3):
            raise ValueError(f"a body has {len(places)} joints, there are {count} names")
        found[int(body["body_id"])] = places
    return int(frame["timestamp_usec"]), found
