"""The plan for reading a log: the fixed frame, the sensors connected to it, and the messages of each frame; and
which sensors are dense enough to give frames, for a person is tracked by a single one."""

import re
from collections import Counter, defaultdict
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Float64, Int64

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.config.toml import direction
from voodoo_jax.io.calibrations import calibration_of, frame_of
from voodoo_jax.io.container import LogError
from voodoo_jax.io.decode.registry import DEPTH_KINDS
from voodoo_jax.io.frame_sync import clean_stamps, in_pauses, join_one, plan_frames
from voodoo_jax.io.landmark_plan import plan_features, plan_key_points
from voodoo_jax.io.log_index import Scan
from voodoo_jax.io.pictures import PicturePlan, plan_pictures
from voodoo_jax.io.point_labels import BODY, FREE, Parts
from voodoo_jax.io.skin_rays import plan_skin
from voodoo_jax.io.stereo_pairs import STEREO_USE, picture_of
from voodoo_jax.io.topic import DEPTH_USES, Problem, Topic, Unused
from voodoo_jax.records.messages import PAIRS, RAYS, Colour, Image, stride
from voodoo_jax.records.notes import remark
from voodoo_jax.records.recording import NO_RAYS, Pairs, Rays, joined_rays

_CELL = 0.1  # of azimuth and sine of the elevation: 0.01 steradians
_THIN = 1 / 3  # of the densest sensor's density; a spinning scanner of 16 lines has a quarter of a small depth camera's
PAUSE = 3.0  # seconds without a frame that a user should know of
FAR = 1000.0  # metres: float32 has steps of 0.06 mm there, and of 25 cm in UTM
NEEDED = (
    "Needed is a depth image (sensor_msgs/msg/Image or foxglove.RawImage, 16UC1 in mm or 32FC1 in m, or packed as "
    "compressedDepth) with its calibration, or a point cloud (sensor_msgs/msg/PointCloud2 or foxglove.PointCloud), or "
    "the images of a stereo pair with both calibrations"
)
NEEDED_FEATURES = (
    ", or named features: 3D points (visualization_msgs/msg/MarkerArray, geometry_msgs/msg/PointStamped, "
    "foxglove.SceneUpdate) or 2D detections (vision_msgs/msg/Detection2DArray, foxglove.ImageAnnotations) with the "
    "camera's calibration"
)


def dense(topics: dict[str, Topic], names: list[str], max_points: int) -> list[str]:
    """Those of the depth topics that are about as dense as the densest of them (points per solid angle)."""
    density = {name: _density(topics, name, max_points) for name in names}
    most = max((d for d in density.values() if np.isfinite(d)), default=0.0)
    return [name for name in names if density[name] >= _THIN * most]


def _density(topics: dict[str, Topic], name: str, max_points: int) -> float:
    """Points per steradian where the sensor sees anything; inf if the first message does not tell."""
    sample = topics[name].sample
    if isinstance(sample, Image | Colour):  # Colour: the left one of a stereo pair
        c = calibration_of(topics, name)
        if c is None:
            return np.inf
        height, width = sample.shape if any(sample.shape) else (c.height, c.width)
        scale = (width / c.width) * (height / c.height) if c.width and c.height else 1.0
        return float(c.K[0, 0] * c.K[1, 1] * scale) / stride(height, width, max_points) ** 2
    points = sample.points(max_points)
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.linalg.norm(points, axis=1)
        points, distance = points[(distance > 0) & (distance < 1e4)], distance[(distance > 0) & (distance < 1e4)]
    cells = np.column_stack([np.arctan2(points[:, 1], points[:, 0]), points[:, 2] / distance])
    seen = len(np.unique(np.floor(cells / _CELL), axis=0))
    return len(points) / (seen * _CELL**2) if seen else np.inf


@dataclass(frozen=True)
class Plan:
    """The plan of a log's frames. `notes`: data left out or assumed, one sentence each."""

    fixed_frame: str
    origin: Float64[np.ndarray, "3"]  # in it; all places are given from there
    up: Float32[np.ndarray, "3"]  # unit, in the fixed frame
    sensors: tuple[str, ...]  # topics that give points
    stamps: tuple[Int64[np.ndarray, " _"], ...]  # of the messages per sensor, nanoseconds, in the order of reading
    frames: tuple[tuple[int, list[tuple[int, int]]], ...]  # (time_ns, [(sensor, message)]) in order of time
    led_by_points: bool  # else features lead, and a frame may have no points
    features: tuple[str, ...]  # topics that give rays or pairs
    rays: dict[int, Rays]  # by frame
    pairs: dict[int, Pairs]  # by frame
    parts: Parts  # what the settings say of the topics
    notes: tuple[str, ...]
    pictures: PicturePlan | None = None  # of single cameras, where images are asked for

    def only(self, frames: range) -> "Plan":
        """Some successive frames of it."""
        again = lambda by_frame: {i - frames.start: by_frame[i] for i in frames if i in by_frame}  # noqa: E731
        planned = self.frames[frames.start : frames.stop]
        return replace(self, frames=planned, rays=again(self.rays), pairs=again(self.pairs))


# 83 lines: one decision after the other, each for the next
def make_plan(
    scan: Scan, settings: ReadSettings, origin: Float64[np.ndarray, "3"] | None = None, after_ns: int = -1
) -> Plan:
    """Plans the second pass; `origin` as in Plan, if it is settled already; frames up to `after_ns` need no features.
    Raises LogError without usable measurements, or without transforms to the fixed frame.

    The fastest depth sensor gives the stamps of frames, the next one those in its pauses. Sensors much sparser than the
    densest (scanners with few lines) do so in long pauses only, and clouds of one limb only without other data. Without
    depth the fastest topic of pairs gives the stamps, else a laser scanner, else rays. Other data joins these frames.
    """
    of = {use: sorted(n for n in scan.uses if scan.uses[n] == use) for use in (*DEPTH_USES, RAYS, PAIRS)}
    lasers, depth = of["laser scan"], sorted(of["depth image"] + of["point cloud"] + of[STEREO_USE])
    sources = depth + lasers if depth else lasers + of[PAIRS] or of[RAYS]
    if not sources:
        raise LogError(_no_depth(scan, settings.features))
    silent = (None, Problem.JPEG, Problem.LOST) if depth else (None, Problem.JPEG)
    unused = {name: use for name, use in scan.uses.items() if isinstance(use, Unused)}
    notes = [f"'{name}' is left out: {use.reason}." for name, use in unused.items() if use.problem not in silent]
    if not depth:
        kinds = " and ".join(sorted({scan.uses[name] for name in sources}))
        note = f"The log has no depth data that can be used; its frames come from {kinds}."
        notes.append(remark(note) if {*sources} <= {*of[PAIRS]} else note)
    fixed, kept = _choose_fixed_frame(scan, settings.fixed_frame.lstrip("/"), sources, notes)
    parts = Parts(scan.topics, scan.uses, settings)
    notes += parts.notes
    whole = [n for n in depth if n in kept and parts.of_topic(n) in (FREE, BODY)]
    good = dense(scan.topics, whole, settings.max_points)
    groups = (good, depth, of[PAIRS], lasers, of[RAYS])
    leaders = next(k for group in groups if (k := [n for n in group if n in kept]))
    sensors = [name for name in kept if scan.uses[name] in DEPTH_USES]
    stamps = {n: clean_stamps(n, scan.topics[n].stamps, scan.topics[n].log_times, notes) for n in sensors}
    led_by_points = leaders[0] in sensors
    found = [scan.topics[n].gathered for n in leaders]
    times = [stamps[n] for n in leaders] if led_by_points else [g.message_stamps for g in found if g is not None]
    unique = [np.unique(s, return_index=True) for s in times]
    frames = plan_frames([s for s, _ in unique], [places for _, places in unique])
    place = {i: sensors.index(name) for i, name in enumerate(leaders)} if led_by_points else {}
    frames = [(t, [(place[i], m) for i, m in members] if led_by_points else []) for t, members in frames]
    thin = [np.unique(stamps[n]) for n in whole if n not in leaders]
    at = np.array([t for t, _ in frames], np.int64)
    alone = [t[in_pauses(at, t)] for t in thin]
    frames = sorted(frames + [(t, []) for t, _ in plan_frames(alone, alone)], key=lambda frame: frame[0])
    at = np.array([t for t, _ in frames], np.int64)
    notes += _gaps(at)
    for name in sensors:
        if name not in leaders:
            for frame, message in join_one(at, stamps[name]):
                frames[frame][1].append((sensors.index(name), message))
    origin = _near_origin(scan, fixed, leaders[0], frames[0][0], notes) if origin is None else origin
    scan.tree.give_from(fixed, origin)
    cameras = [n for n in of[RAYS] if n in kept]
    if leaders[0] in cameras and len(cameras) > 1:
        features = plan_key_points(scan, fixed, cameras, at, parts)
    else:
        features = plan_features(scan, fixed, of[RAYS] + of[PAIRS], at, parts, after_ns)
    if settings.skin:
        skin = plan_skin(scan, fixed, at, parts)
        features.rays |= {i: joined_rays([features.rays.get(i, NO_RAYS), rays]) for i, rays in skin.rays.items()}
        features.topics += tuple(name for name in skin.topics if name not in features.topics)
        notes += skin.notes
    looked_at = any(picture_of(scan.topics[n].sample) is not None for n in cameras)  # see camera_key_points
    pictures = plan_pictures(scan, fixed, at) if settings.images or (settings.pose_net and not looked_at) else None
    notes += pictures.notes if pictures else ()
    if settings.pose_net and pictures is not None and not pictures.cameras and not scan.stereo:
        notes.append("read.pose_net has no effect: the log has no calibrated colour images.")
    given = np.array(direction(settings.up), np.float32) if settings.up else None
    up = _upward(scan, fixed, leaders[0], frames[0][0]) if given is None else given
    return Plan(
        fixed_frame=fixed,
        origin=origin,
        up=up,
        sensors=tuple(sensors),
        stamps=tuple(stamps.values()),
        frames=tuple(frames),
        led_by_points=led_by_points,
        features=features.topics,
        rays=features.rays,
        pairs=features.pairs,
        parts=parts,
        notes=tuple(notes + features.notes),
        pictures=pictures,
    )


def _gaps(times: Int64[np.ndarray, " frame"]) -> list[str]:
    """A sentence on where there are no frames for long."""
    apart = np.diff(times) / 1e9
    long = np.flatnonzero(apart > max(PAUSE, 10 * np.median(apart))) if len(apart) else apart
    if not len(long):
        return []
    first = f"{apart[long[0]]:.1f} s, after {(times[long[0]] - times[0]) / 1e9:.1f} s"
    return [f"The log has {'a gap of ' if len(long) == 1 else f'{len(long)} gaps, the first of '}{first}."]


def _no_depth(scan: Scan, features: bool) -> str:
    """Why a log has no depth data, and what to do about it."""
    of: dict[Problem | None, dict[str, Unused]] = defaultdict(dict)
    for name, use in scan.uses.items():
        if isinstance(use, Unused):
            of[use.problem][name] = use
    said = lambda unused: "; ".join(f"'{name}' is {use.reason}" for name, use in unused.items())  # noqa: E731
    if blind := of[Problem.CALIBRATION]:
        return (
            f"'{scan.log.path}' has no depth image that can be used: {said(blind)}. "
            "Record the camera's calibration (sensor_msgs/msg/CameraInfo or foxglove.CameraCalibration) with it, or "
            "give it: --read.camera FILE, a camera_info as YAML, TOML or JSON."
        )
    if lossy := of[Problem.JPEG]:
        return f"'{scan.log.path}' has no depth that can be used: {said(lossy)}."
    if dead := [name for name in of[Problem.BROKEN] if scan.topics[name].kind in DEPTH_KINDS]:
        uses = "; ".join(f"'{name}': {scan.topics[name].error}" for name in dead)
        hint = "" if all(scan.topics[name].whole for name in dead) else " Was it written by another version?"
        return f"'{scan.log.path}': no depth message can be decoded ({uses}).{hint}"
    damage = " ".join(["", *scan.log.damage])
    if lost := [f"'{name}'" for name in of[Problem.LOST] if scan.topics[name].kind in DEPTH_KINDS]:
        return (
            f"'{scan.log.path}' is damaged: no message of {', '.join(lost)} can be read.{damage} Copy the file again."
        )
    topics = sorted(scan.topics.items())
    held = "; ".join(f"{name} ({t.type}, {t.count} messages) {scan.uses[name]}" for name, t in topics)
    nor, needed = (" and no named features", NEEDED + NEEDED_FEATURES) if features else ("", NEEDED)
    return f"'{scan.log.path}' has no depth data{nor}. It has: {held}. {needed}.{damage}"


def _choose_fixed_frame(scan: Scan, asked: str, sensors: list[str], notes: list[str]) -> tuple[str, list[str]]:
    """Name of the fixed frame, and the sensors (or feature topics) that are connected to it."""
    what = "depth sensor" if any(scan.uses[name] in DEPTH_USES for name in sensors) else "topic of features"
    tree, path = scan.tree, scan.log.path
    frame = {name: frame_of(scan.topics, name) for name in sensors}
    known = sorted({*tree.frames, *frame.values()})
    if asked and asked not in known:
        raise LogError(f"'{path}' has no frame '{asked}'. Its frames: {', '.join(known)}.")
    roots = {name: tree.root(frame[name]) for name in sensors}
    number = Counter(roots.values())
    best = max(sensors, key=lambda name: (frame[name] in tree.frames, number[roots[name]], -sensors.index(name)))
    if tree.frames and not asked and frame[best] not in tree.frames:
        lone = ", ".join(f"'{f}'" for f in sorted(set(frame.values())))
        raise LogError(
            f"'{path}': no {what} is in the transform tree, no transform links {lone} to any of "
            f"{', '.join(tree.frames)}. Record the missing transform, give it by read.transform, or set fixed_frame to "
            f"'{frame[best]}' to track in the sensor's own frame."
        )
    fixed = asked or roots[best]
    if not tree.frames:
        notes.append(remark(f"The log has no transforms: results are in the frame of its measurements, '{fixed}'."))
    kept = [name for name in sensors if tree.connected(frame[name], fixed)]
    for name in sensors:
        if name not in kept:
            notes.append(f"'{name}' is left out: no transform between '{frame[name]}' and '{fixed}'.")
    if not kept:
        missing = ", ".join(f"'{f}'" for f in sorted(set(frame.values())))
        raise LogError(
            f"'{path}': no {what} is connected to the fixed frame '{fixed}', transforms are missing "
            f"from {missing}. Choose another fixed_frame, record the transforms (/tf, /tf_static), or give them by "
            "read.transform."
        )
    return fixed, kept


def _near_origin(scan: Scan, fixed: str, sensor: str, time_ns: int, notes: list[str]) -> np.ndarray:
    """A place in the fixed frame, in whole metres, near which all is: 0 but for coordinates of a country (UTM)."""
    pose = scan.tree.lookup(fixed, frame_of(scan.topics, sensor), time_ns, hold_ns=None)
    rotation, place = pose if pose else (np.eye(3), np.zeros(3))
    gathered = scan.topics[sensor].gathered
    if gathered is not None and gathered.values.shape[1:] == (3,) and len(gathered.values):
        place = rotation @ np.median(gathered.values, axis=0) + place
    origin = np.where(np.abs(place) > FAR, np.round(place), 0.0)
    if origin.any():
        at = ", ".join(f"{x:.0f}" for x in origin)
        notes.append(
            f"Coordinates in '{fixed}' are large: computed from ({at}) m, and written in '{fixed}' in float64."
        )
    return origin


def _upward(scan: Scan, fixed: str, sensor: str, time_ns: int) -> np.ndarray:
    """Up in the fixed frame: the root frame's z (REP 103), or -y for a camera that is the root itself, or what the
    format says that the log was converted from."""
    tree, stated = scan.tree, scan.topics[sensor].up
    if not tree.frames and re.fullmatch("-?[xyz]", stated):
        return np.array(direction(stated), np.float32)
    root = tree.root(fixed)
    cameras = ("depth image", STEREO_USE, RAYS)
    if "optical" in root.lower() or (root not in tree.frames and scan.uses[sensor] in cameras):
        up = np.array([0.0, -1.0, 0.0])
    else:
        up = np.array([0.0, 0.0, 1.0])
    found = tree.lookup(fixed, root, time_ns, hold_ns=None)
    return (found[0] @ up if found else up).astype(np.float32)
