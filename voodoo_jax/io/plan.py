"""The plan for reading a log: the fixed frame, the sensors that are connected to it, and what makes up which frame."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int64

from voodoo_jax.io.container import LogError
from voodoo_jax.io.scan import DEPTH_USES, Scan, Topic, many
from voodoo_jax.settings import ReadSettings

NEEDED = (
    "Needed is a depth image (sensor_msgs/msg/Image or foxglove.RawImage, 16UC1 in mm or 32FC1 in m) with its "
    "calibration, or a point cloud (sensor_msgs/msg/PointCloud2 or foxglove.PointCloud)."
)


@dataclass(frozen=True)
class Plan:
    """How a log becomes frames. `notes`: what is left out or assumed, one sentence each."""

    fixed_frame: str
    up: Float32[np.ndarray, "3"]  # unit, in the fixed frame
    sensors: tuple[str, ...]  # topics
    stamps: tuple[Int64[np.ndarray, " _"], ...]  # of the messages per sensor, nanoseconds, in the order of reading
    frames: tuple[tuple[int, list[tuple[int, int]]], ...]  # (time_ns, [(sensor, message)]) in order of time
    notes: tuple[str, ...]


def make_plan(scan: Scan, settings: ReadSettings) -> Plan:
    """Plans the second pass. Raises LogError if there is no usable depth data or no way to the fixed frame."""
    sensors = sorted(name for name, use in scan.uses.items() if use in DEPTH_USES)
    if not sensors:
        raise LogError(_no_depth(scan))
    notes = []
    for name, use in scan.uses.items():
        if "a depth image w" in use or "no message can be decoded" in use:
            notes.append(f"'{name}' is left out: {use.removeprefix('not used: ')}.")
    fixed, sensors = _choose_fixed_frame(scan, settings.fixed_frame.lstrip("/"), sensors, notes)
    stamps = [_clean_stamps(scan.topics[name], name, notes) for name in sensors]
    unique = [np.unique(s, return_index=True) for s in stamps]
    frames = _plan_frames([s for s, _ in unique], [places for _, places in unique])
    up = _upward(scan, fixed, sensors[0], frames[0][0])
    return Plan(fixed, up, tuple(sensors), tuple(stamps), tuple(frames), tuple(notes))


def _no_depth(scan: Scan) -> str:
    """Why a log has no depth data, and what to do about it."""
    blind = [name for name, use in scan.uses.items() if "a depth image w" in use]
    if blind:
        uses = "; ".join(f"'{name}' is {scan.uses[name].removeprefix('not used: ')}" for name in blind)
        return (
            f"'{scan.log.path}' has no depth image that can be used: {uses}. "
            "Record the camera's calibration (sensor_msgs/msg/CameraInfo or foxglove.CameraCalibration) with it."
        )
    dead = [name for name, use in scan.uses.items() if "no message can be decoded" in use]
    if dead:
        uses = "; ".join(f"'{name}': {scan.topics[name].error}" for name in dead)
        return f"'{scan.log.path}': no depth message can be decoded ({uses}). Was it written by another version?"
    damage = " ".join(["", *scan.log.damage])
    lost = [f"'{name}'" for name, use in scan.uses.items() if use.startswith("not used: none of its")]
    if lost:
        return (
            f"'{scan.log.path}' is damaged: no message of {', '.join(lost)} can be read.{damage} Copy the file again."
        )
    topics = sorted(scan.topics.items())
    held = "; ".join(f"{name} ({t.type}, {t.count} messages) {scan.uses[name]}" for name, t in topics)
    return f"'{scan.log.path}' holds no depth data. It holds: {held}. {NEEDED}{damage}"


def _choose_fixed_frame(scan: Scan, asked: str, sensors: list[str], notes: list[str]) -> tuple[str, list[str]]:
    """Name of the fixed frame, and the sensors that are connected to it."""
    tree, path = scan.tree, scan.log.path
    frame = {name: scan.topics[name].sample.frame for name in sensors}
    known = sorted({*tree.frames, *frame.values()})
    if asked and asked not in known:
        raise LogError(f"'{path}' has no frame '{asked}'. Its frames: {', '.join(known)}.")
    roots = {name: tree.root(frame[name]) for name in sensors}
    number = Counter(roots.values())
    best = max(sensors, key=lambda name: (frame[name] in tree.frames, number[roots[name]], -sensors.index(name)))
    if tree.frames and not asked and frame[best] not in tree.frames:
        lone = ", ".join(f"'{f}'" for f in sorted(set(frame.values())))
        raise LogError(
            f"'{path}': no depth sensor is in the transform tree, nothing links {lone} to any of "
            f"{', '.join(tree.frames)}. Record the missing transform, or set fixed_frame to '{frame[best]}' "
            "to track in the sensor's own frame."
        )
    fixed = asked or roots[best]
    if not tree.frames:
        notes.append(f"The log has no transforms: everything is given in the frame '{fixed}' of the sensor.")
    kept = [name for name in sensors if tree.connected(frame[name], fixed)]
    for name in sensors:
        if name not in kept:
            notes.append(f"'{name}' is left out: no transform between '{frame[name]}' and '{fixed}'.")
    if not kept:
        missing = ", ".join(f"'{f}'" for f in sorted(set(frame.values())))
        raise LogError(
            f"'{path}': no depth sensor is connected to the fixed frame '{fixed}', transforms are missing "
            f"from {missing}. Choose another fixed_frame or record the transforms (/tf, /tf_static)."
        )
    return fixed, kept


def _upward(scan: Scan, fixed: str, sensor: str, time_ns: int) -> np.ndarray:
    """Up in the fixed frame: the root frame's z (REP 103), or -y for a camera that is the root itself."""
    tree = scan.tree
    root = tree.root(fixed)
    if "optical" in root.lower() or (root not in tree.frames and scan.uses[sensor] == "depth image"):
        up = np.array([0.0, -1.0, 0.0])
    else:
        up = np.array([0.0, 0.0, 1.0])
    found = tree.lookup(fixed, root, time_ns, hold_ns=None)
    return (found[0] @ up if found else up).astype(np.float32)


def _clean_stamps(topic: Topic, name: str, notes: list[str]) -> np.ndarray:
    """Stamp of each of a topic's messages, nanoseconds, in the order of reading."""
    stamps, log_times = np.array(topic.stamps, np.int64), np.array(topic.log_times, np.int64)
    zero = stamps == 0
    if zero.any():
        notes.append(f"'{name}': {many(int(zero.sum()))} without header stamp; the log time is used for them.")
        stamps = np.where(zero, log_times, stamps)
    distinct = len(np.unique(stamps))
    if 2 * distinct < len(stamps) and len(np.unique(log_times)) > distinct:
        notes.append(f"'{name}': {len(stamps)} messages have only {distinct} header stamps; log time is used.")
        stamps, distinct = log_times, len(np.unique(log_times))
    backwards = int((np.diff(stamps) < 0).sum())
    if backwards:
        notes.append(f"'{name}': the stamps run backwards at {backwards} places; messages were sorted.")
    if distinct < len(stamps):
        notes.append(f"'{name}': {many(len(stamps) - distinct)} with the stamp of another, left out.")
    return stamps


def _plan_frames(stamps: list[np.ndarray], places: list[np.ndarray]) -> list[tuple[int, list[tuple[int, int]]]]:
    """Which messages make up which frame: (time_ns, [(sensor, place)]) in order of time, each message once.

    `stamps` per sensor, increasing, sensors in name order. The fastest sensor leads; what falls into its pauses is
    planned again among the others.
    """
    period = np.array([np.median(np.diff(s)) if len(s) > 1 else np.inf for s in stamps])
    left = {i: np.arange(len(s)) for i, s in enumerate(stamps)}
    frames: list[tuple[int, list[tuple[int, int]]]] = []
    while left:
        # Jitter must not decide between equal rates.
        lead = next(i for i in left if period[i] <= 1.05 * min(period[j] for j in left) or len(left) == 1)
        mine = left.pop(lead)
        if not len(mine):
            continue
        times = stamps[lead][mine]
        made = [(int(t), [(lead, int(places[lead][m]))]) for t, m in zip(times, mine)]
        for other in list(left):
            rest = left[other]
            t = stamps[other][rest]
            after = np.clip(np.searchsorted(times, t), 0, len(times) - 1)
            before = np.clip(after - 1, 0, None)
            nearest = np.where(np.abs(times[after] - t) < np.abs(times[before] - t), after, before)
            inside = (times[before] <= t) & (t <= times[after]) & (times[after] - times[before] <= 1.5 * period[lead])
            # A lead with one message has no period: it takes what is as near as half of the other's.
            reach = 0.5 * (period[lead] if np.isfinite(period[lead]) else min(period[other], 1e8))
            joins = inside | (np.abs(times[nearest] - t) <= reach)
            for n, m in zip(nearest[joins], rest[joins]):
                made[n][1].append((other, int(places[other][m])))
            left[other] = rest[~joins]
        frames += made
    return sorted(frames, key=lambda frame: frame[0])
