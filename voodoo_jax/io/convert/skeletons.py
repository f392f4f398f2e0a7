"""Converts skeleton files of body trackers: joints become named points, with a prefix for each body.

* JSON of a Kinect, as Microsoft's Azure Kinect samples write it: `joint_names`, and `frames` with `timestamp_usec` and
  `bodies`, each with `body_id` and `joint_positions` in millimetres, in the depth camera's frame.
* JSON of Nuitrack: a list of frames, each with `Timestamp` (microseconds) and `Skeletons`, whose `Joints` have a `Type`
  and a place `Real`, millimetres, y upwards and z ahead of the sensor: left-handed, as Unity's.
* JSON of the ZED SDK's samples: frames by time, each with `timestamp` (nanoseconds) and `body_list`, whose `keypoint`
  are of the order of its format (18, 34 or 38 points).
* NTU RGB+D (`.skeleton`): text with the 25 joints of a Kinect v2, metres, y upwards, 30 Hz.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from voodoo_jax.io.convert.target import START_NS, ConvertError, check_points, content, new_log, putter, scene_of_points
from voodoo_jax.model.marker_names import numbered_names, orders
from voodoo_jax.storage.guarded import Answer

TOPIC, OPTICAL, CAMERA = "/skeletons", "depth_optical", "camera"
MILLIMETRE = 0.001
NTU_HZ, NOT_TRACKED = 30.0, 0  # frames a second of NTU RGB+D; the state of a joint of which nothing is known
WRONG = (ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError, RecursionError)
Bodies = dict[str, dict[str, Float[np.ndarray, "3"]]]  # joints by name, metres, by the body's number
Told = tuple[list[tuple[int, Bodies]], str, str]  # bodies with their stamps (nanoseconds), their frame, and its up


def convert(source: Path, target: Answer) -> list[str]:
    """Writes the joints of all bodies as named 3D points, metres. Raises ConvertError, OSError."""
    try:
        text = content(source).decode("utf-8")
        frames, frame, up = _ntu(text) if source.suffix.lower() == ".skeleton" else _json(json.loads(text))
    except ConvertError:
        raise
    except WRONG as problem:
        raise ConvertError(
            f"'{source}' cannot be read as skeletons: {type(problem).__name__}: {problem}; it needs joint_names and "
            "frames with timestamp_usec and bodies with joint_positions (Kinect), frames with Skeletons (Nuitrack), or "
            "with body_list (ZED)"
        ) from problem
    bodies = {body for _, found in frames for body in found}
    check_points(len(bodies), sum(len(places) for _, found in frames for places in found.values()))
    if not bodies:
        raise ConvertError(f"'{source}' has no body in any frame")
    first = min(stamp for stamp, _ in frames)
    with new_log(target) as writer:
        put = putter(writer, up)
        for stamp, found in sorted(frames, key=lambda each: each[0]):
            joints = [(name, at, body) for body, places in found.items() for name, at in places.items()]
            labels = [f"body{body}:{name}" if len(bodies) > 1 else name for name, _, body in joints]
            points = np.array([at for _, at, _ in joints], float).reshape(-1, 3)
            at = START_NS + stamp - first
            put(TOPIC, at, scene_of_points(labels, points, at, frame))
    return [f"{len(bodies)} bodies: their joints begin with body<id>:"] if len(bodies) > 1 else []


def _json(content: Any) -> Told:
    """Raises one of WRONG where it is of no format that is known."""
    if isinstance(content, list):
        return [_nuitrack(frame) for frame in content], OPTICAL, "-y"
    if "frames" not in content and any("body_list" in frame for frame in content.values()):
        return [_zed(frame) for frame in content.values()], CAMERA, ""
    names = [str(name) for name in content["joint_names"]]
    return [_kinect(frame, names) for frame in content["frames"]], OPTICAL, "-y"


def _kinect(frame: dict[str, Any], names: list[str]) -> tuple[int, Bodies]:
    found: Bodies = {}
    for body in frame["bodies"]:
        places = np.array(body["joint_positions"], float) * MILLIMETRE
        if places.shape != (len(names), 3):
            raise ValueError(f"a body has {len(places)} joints, there are {len(names)} names")
        found[str(int(body["body_id"]))] = dict(zip(names, places))
    return 1000 * int(frame["timestamp_usec"]), found


def _nuitrack(frame: dict[str, Any]) -> tuple[int, Bodies]:
    found: Bodies = {}
    for body in frame["Skeletons"]:
        joints: dict[str, np.ndarray] = {}
        for joint in body["Joints"]:
            if float(joint.get("Confidence", 1.0)) > 0:
                at = joint["Real"]
                joints[str(joint["Type"]).lower()] = MILLIMETRE * np.array([at["X"], -at["Y"], at["Z"]], float)
        found[str(int(body["UserID"]))] = joints
    return 1000 * int(frame["Timestamp"]), found


def _zed(frame: dict[str, Any]) -> tuple[int, Bodies]:
    found: Bodies = {}
    for body in frame["body_list"]:
        places = np.array(body["keypoint"], float)
        names = numbered_names(len(places))
        if names is None or places.shape[1:] != (3,):
            raise ValueError(f"a body has {len(places)} key points, which is no format that is known")
        found[str(int(body["id"]))] = dict(zip(names, places))
    return int(frame["timestamp"]), found


def _ntu(text: str) -> Told:
    words: Iterator[list[str]] = (line.split() for line in text.splitlines() if line.strip())
    frames: list[tuple[int, Bodies]] = []
    names = orders(25)["kinect_v2"]
    for number in range(int(next(words)[0])):
        found: Bodies = {}
        for _ in range(int(next(words, ["0"])[0])):  # some files end early
            body, count = next(words)[0], int(next(words)[0])
            rows = [next(words) for _ in range(count)]
            if count != len(names):
                raise ValueError(f"a body has {count} joints, a Kinect v2's {len(names)}")
            seen = {n: np.array(row[:3], float) for n, row in zip(names, rows) if int(row[11]) != NOT_TRACKED}
            found[body] = seen
        frames.append((round(number / NTU_HZ * 1e9), found))
    return frames, CAMERA, "y"
