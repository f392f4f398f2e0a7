"""Read an MCAP sensor log: depth images and point clouds, found by type, as frames of points in one fixed frame.

Two passes: the first collects stamps, calibrations and transforms, and plans which messages make up which frame; the
second decodes the depth messages one by one. So memory stays bounded, and a calibration may come after the images.
"""

import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from voodoo_jax.io import camera
from voodoo_jax.io.container import READ_ERRORS, Item, LogError, LogFile
from voodoo_jax.io.decode import (
    DECODE_ERRORS,
    Calibration,
    Cloud,
    Decoder,
    Image,
    is_static,
    kind_of,
    quick_stamp,
    reason_unused,
    stride,
)
from voodoo_jax.io.transforms import HOLD_NS, TransformTree
from voodoo_jax.recording import Frame, Recording
from voodoo_jax.settings import ReadSettings

__all__ = ["LogError", "LogReader", "LogSurvey", "TopicSurvey", "open_log", "read_log", "survey"]

Progress = Callable[[int, int], None]
NEEDED = (
    "Needed is a depth image (sensor_msgs/msg/Image or foxglove.RawImage, 16UC1 in mm or 32FC1 in m) with its "
    "calibration, or a point cloud (sensor_msgs/msg/PointCloud2 or foxglove.PointCloud)."
)
DEPTH_USES = ("depth image", "point cloud")


@dataclass(frozen=True)
class TopicSurvey:
    """One topic of a log. `use` is what replay takes it for, or "not used: <reason>"."""

    topic: str
    type: str
    encoding: str
    count: int
    use: str


@dataclass(frozen=True)
class LogSurvey:
    """What a log holds, and what of it replay would use. `str()` gives a table for a person."""

    path: str
    start_ns: int  # log time of the first message, nanoseconds since 1970
    duration: float  # seconds
    topics: tuple[TopicSurvey, ...]
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        start = datetime.fromtimestamp(self.start_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        rows = [("topic", "messages", "type", "encoding", "used as")]
        rows += [(t.topic, str(t.count), t.type, t.encoding, t.use) for t in self.topics]
        width = [max(len(row[i]) for row in rows) for i in range(5)]
        lines = [f"{self.path}: {self.duration:.2f} s from {start}, {sum(t.count for t in self.topics)} messages"]
        for row in rows:
            cells = [c.rjust(w) if i == 1 else c.ljust(w) for i, (c, w) in enumerate(zip(row, width))]
            lines.append(("  " + "  ".join(cells)).rstrip())
        return "\n".join(lines + [f"  note: {w}" for w in self.warnings])


def survey(path: str | os.PathLike[str]) -> LogSurvey:
    """List what a log holds. Raises LogError only if nothing can be read at all."""
    scan = _Scan(path, ReadSettings())
    warnings: list[str] = []
    try:
        reader = LogReader(scan, ReadSettings())
        warnings += reader.notes
    except LogError as error:
        warnings += [*scan.notes, str(error)]
    log_times = scan.log.time_range or scan.log_times or (0, 0)
    seconds = (log_times[1] - log_times[0]) / 1e9
    return LogSurvey(scan.log.path, log_times[0], seconds, tuple(scan.table()), tuple(warnings))


def open_log(path: str | os.PathLike[str], settings: ReadSettings | None = None) -> "LogReader":
    """Look through a log and plan its frames; `frames()` of the result then gives them one by one.

    Raises LogError if the file cannot be read, holds no usable depth data, or a name in `settings` is not in the log.
    """
    settings = settings or ReadSettings()
    return LogReader(_Scan(path, settings), settings)


def read_log(
    path: str | os.PathLike[str], settings: ReadSettings | None = None, progress: Progress | None = None
) -> Recording:
    """Read a whole log into memory: see `open_log`, `LogReader.frames` and `Recording`. Raises LogError."""
    log = open_log(path, settings)
    frames = tuple(log.frames(progress))
    return Recording(log.path, log.fixed_frame, log.up, log.sensors, frames, log.notes)


@dataclass
class _Topic:
    """What the first pass learns of a topic."""

    type: str
    encoding: str
    kind: str
    why_not: str
    stamps: list[int] = field(default_factory=list)
    log_times: list[int] = field(default_factory=list)
    sample: Any = None  # first message that could be decoded
    error: str = ""  # why the first broken message could not be
    broken: int = 0
    calibration: Calibration | None = None
    count: int = 0
    stated: int = 0  # number of messages by the file's own statistics


def _guarded(log: LogFile, wanted: Callable[[Schema | None, Channel], bool]) -> Iterator[Item]:
    """The messages of a log; what goes wrong below the level of chunks (a failing disk) comes out as LogError."""
    try:
        yield from log.messages(wanted)
    except READ_ERRORS as error:
        raise LogError(f"'{log.path}' cannot be read: {error}. Check the disk, and copy the file again.") from error


def _many(n: int) -> str:
    return "1 message" if n == 1 else f"{n} messages"


class _Scan:
    """The first pass over a log."""

    def __init__(self, path: str | os.PathLike[str], settings: ReadSettings):
        self.log = LogFile(path)
        self.topics: dict[str, _Topic] = {}
        self.tree = TransformTree()
        self.notes: list[str] = []
        self.log_times: tuple[int, int] | None = None
        self._decoder = Decoder()
        # Without statistics the only way to know the number of messages is to read them all.
        everything = self.log.declared is None
        wanted = lambda s, c: everything or bool(kind_of(s, c))  # noqa: E731
        for schema, channel, message in _guarded(self.log, wanted):
            first, last = self.log_times or (message.log_time, message.log_time)
            self.log_times = min(first, message.log_time), max(last, message.log_time)
            topic = self._topic(schema, channel)
            topic.count += 1
            if schema is not None and topic.kind and kind_of(schema, channel) == topic.kind:
                self._take(topic, schema, channel, message)
        self.tree.close()
        self._count()
        if not self.topics:
            damage = " ".join(self.log.damage)
            raise LogError(f"'{self.log.path}' holds no messages. {damage or 'Nothing was recorded.'}")
        self.uses = self._uses(settings)

    def _topic(self, schema: Schema | None, channel: Channel) -> _Topic:
        if channel.topic not in self.topics:
            encoding = "/".join(filter(None, [channel.message_encoding, schema.encoding if schema else ""]))
            name, why = schema.name if schema else "?", reason_unused(schema, channel)
            self.topics[channel.topic] = _Topic(name, encoding, kind_of(schema, channel), why)
        return self.topics[channel.topic]

    def _take(self, topic: _Topic, schema: Schema, channel: Channel, message: Any) -> None:
        content, stamp = None, quick_stamp(channel, message.data)
        depth = topic.kind in ("image", "point cloud")
        if topic.sample is None or stamp is None or not depth:
            try:
                content = self._decoder.message(schema, channel, message.data)
            except DECODE_ERRORS as error:
                topic.broken += 1
                topic.error = topic.error or f"{type(error).__name__}: {error}"
        if content is not None and topic.sample is None:
            topic.sample = content
        if isinstance(content, list):
            for transform in content:
                self.tree.add(transform, is_static(schema, channel))
        elif isinstance(content, Calibration):
            old = topic.calibration
            if old is None or (old.K[0, 0] == 0 and content.K[0, 0] != 0):
                topic.calibration = content
            elif content.K[0, 0] != 0 and not (np.array_equal(old.K, content.K) and np.array_equal(old.D, content.D)):
                note = f"The calibration on '{channel.topic}' changes during the log; its first value is used."
                if note not in self.notes:
                    self.notes.append(note)
        elif depth:
            if content is not None:
                stamp = content.stamp_ns
            topic.stamps.append(message.log_time if stamp is None else stamp)
            topic.log_times.append(message.log_time)

    def _count(self) -> None:
        """Number of messages per topic as the file states it, and a note where fewer were found."""
        log = self.log
        for channel in log.channels.values():
            self._topic(log.schemas.get(channel.schema_id), channel)
        stated: Counter[str] = Counter()
        for i, n in (log.declared or {}).items():
            if i in log.channels:
                stated[log.channels[i].topic] += n
        self.notes += log.damage
        for name, topic in self.topics.items():
            topic.stated = stated[name]
            if topic.kind and topic.count < stated[name]:
                lost = stated[name] - topic.count
                self.notes.append(f"'{name}': kept {topic.count} of {stated[name]} messages, {lost} cannot be read.")
            elif not topic.kind:
                topic.count = max(topic.count, stated[name])
            if topic.broken and topic.kind in ("calibration", "transforms"):
                self.notes.append(f"'{name}': {_many(topic.broken)} cannot be decoded ({topic.error}).")

    def _uses(self, settings: ReadSettings) -> dict[str, str]:
        """What each topic is used as; a camera that gives both an image and a cloud is used once."""
        uses = {}
        for name, topic in self.topics.items():
            uses[name] = topic.kind if topic.kind in ("calibration", "transforms") else f"not used: {topic.why_not}"
            if topic.kind in ("image", "point cloud"):
                uses[name] = self._depth_use(name, topic)
        if settings.topics:
            depth = [name for name, use in uses.items() if use in DEPTH_USES]
            for name in settings.topics:
                if name not in depth:
                    why = f" ({uses[name]})" if name in uses else ""
                    raise LogError(
                        f"'{self.log.path}' has no depth topic '{name}'{why}. It has: {', '.join(depth) or 'none'}."
                    )
            return {n: "not used: not among the topics asked for" if n in depth and n not in settings.topics else use
                    for n, use in uses.items()}  # fmt: skip
        order = {"depth image": 0, "point cloud": 1}
        seen: dict[str, str] = {}
        ranked = sorted((n for n in uses if uses[n] in order), key=lambda n: (self._is_mono(n), order[uses[n]], n))
        for name in ranked:
            frame = self.topics[name].sample.frame
            # Two clouds of one frame may be two sensors given in a common frame, so only images shadow others.
            first = seen.get(frame)
            if first and (uses[first] == "depth image" or self._is_mono(name)):
                uses[name] = f"not used: the same camera as '{first}' (frame '{frame}')"
                self.notes.append(f"'{name}' is left out: it is the same camera as '{first}' (frame '{frame}').")
            seen.setdefault(frame, name)
        return uses

    def _is_mono(self, name: str) -> bool:
        sample = self.topics[name].sample
        return isinstance(sample, Image) and sample.encoding.upper() == "MONO16"

    def _depth_use(self, name: str, topic: _Topic) -> str:
        if topic.count == 0:
            return (
                f"not used: none of its {topic.stated} messages can be read"
                if topic.stated
                else "not used: no messages"
            )
        if topic.sample is None:
            return f"not used: no message can be decoded ({topic.error})"
        if topic.kind == "point cloud":
            return "point cloud"
        if topic.sample.raw is None:
            return f"not used: encoding {topic.sample.encoding} is not a depth image"
        tokens = name.lower().replace("/", "_").split("_")
        if self._is_mono(name) and {"ir", "infra", "infra1", "infra2", "infrared", "amplitude", "intensity"} & {
            *tokens
        }:
            return "not used: brightness, to judge by its name"
        calibration = self.calibration(name)
        if calibration is None:
            return f"not used: a depth image without calibration (none for frame '{topic.sample.frame}')"
        try:
            # A small part is enough to learn whether the lens model is known.
            camera.pixel_rays(calibration.K, calibration.D, calibration.model, 2, 2)
        except ValueError as error:
            return f"not used: a depth image whose calibration is unusable: {error}"
        return "depth image"

    def calibration(self, name: str) -> Calibration | None:
        """That of the same frame, else of the same namespace; then the one of the same size."""
        image: Image = self.topics[name].sample
        space = name.rsplit("/", 1)[0]
        found = []
        for other, topic in self.topics.items():
            c = topic.calibration
            if c is not None and (c.frame == image.frame or other.rsplit("/", 1)[0] == space):
                key = (
                    c.frame != image.frame,
                    (c.height, c.width) != image.shape,
                    other.rsplit("/", 1)[0] != space,
                    other,
                )
                found.append((key, c))
        return min(found, key=lambda pair: pair[0])[1] if found else None

    def table(self) -> Iterator[TopicSurvey]:
        """All topics in name order."""
        for name, topic in sorted(self.topics.items()):
            yield TopicSurvey(name, topic.type, topic.encoding, topic.count, self.uses[name])


class LogReader:
    """A log opened for reading frame by frame. `notes` is complete once `frames()` has run through."""

    def __init__(self, scan: _Scan, settings: ReadSettings):
        self._scan, self._settings = scan, settings
        self.path = scan.log.path
        self._notes = list(scan.notes) + scan.tree.notes
        self._counted: Counter[tuple[str, str]] = Counter()  # (topic, what happened)
        self._rays: dict[tuple, np.ndarray] = {}
        sensors = sorted(name for name, use in scan.uses.items() if use in DEPTH_USES)
        if not sensors:
            raise LogError(self._no_depth())
        for name, use in scan.uses.items():
            if "a depth image w" in use or "no message can be decoded" in use:
                self._notes.append(f"'{name}' is left out: {use.removeprefix('not used: ')}.")
        self.fixed_frame, connected = self._choose_fixed_frame(sensors)
        self.sensors: tuple[str, ...] = tuple(connected)
        self._stamps = [self._clean_stamps(name) for name in self.sensors]
        unique = [np.unique(stamps, return_index=True) for stamps in self._stamps]
        self._plan = _plan_frames([stamps for stamps, _ in unique], [places for _, places in unique])
        self.up = self._upward()

    def __len__(self) -> int:
        """Number of frames planned; fewer come out if messages turn out to be broken or have no transform."""
        return len(self._plan)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out, missing or damaged, one sentence each."""
        return tuple(self._notes + self._losses())

    def _losses(self) -> list[str]:
        return [f"'{topic}': {_many(n)} {what}." for (topic, what), n in self._counted.items()]

    def frames(self, progress: Progress | None = None) -> Iterator[Frame]:
        """Frames in the order of their stamps. `progress` gets the number of depth messages done, and of all.

        Raises LogError if not one message can be used.
        """
        scan, decoder = self._scan, Decoder()
        self._counted = Counter()
        sensor_of = {name: i for i, name in enumerate(self.sensors)}
        home = {member: i for i, (_, members) in enumerate(self._plan) for member in members}
        missing = [len(members) for _, members in self._plan]
        parts: dict[int, list[tuple[int, np.ndarray, np.ndarray]]] = {}
        seen, done, made, following, error = Counter(), 0, 0, 0, ""
        origins = np.full((len(self.sensors), 3), np.nan)
        wanted = lambda s, c: c.topic in sensor_of and kind_of(s, c) == scan.topics[c.topic].kind  # noqa: E731
        for schema, channel, message in _guarded(scan.log, wanted):
            member = sensor_of[channel.topic], seen[channel.topic]
            seen[channel.topic] += 1
            done += 1
            if progress is not None:
                progress(done, len(home))
            if member not in home or schema is None:
                continue
            i = home[member]
            missing[i] -= 1
            try:
                content = decoder.message(schema, channel, message.data)
                part = self._measure(channel.topic, content, int(self._stamps[member[0]][member[1]]))
                if part is not None:
                    parts.setdefault(i, []).append((member[0], *part))
            except DECODE_ERRORS as problem:
                error = error or f"{type(problem).__name__}: {problem}"
                self._counted[channel.topic, "cannot be decoded, left out"] += 1
            while following < len(self._plan) and missing[following] == 0:
                if following in parts:
                    yield self._frame(self._plan[following][0], parts.pop(following), origins)
                    made += 1
                following += 1
        for i in sorted(parts):  # only if the file was changed between the passes
            yield self._frame(self._plan[i][0], parts[i], origins)
            made += 1
        if not made:
            raise LogError(
                " ".join([f"'{self.path}': not one depth message can be used.", *self._losses(), error]).strip()
            )

    def _frame(self, time_ns: int, parts: list[tuple[int, np.ndarray, np.ndarray]], origins: np.ndarray) -> Frame:
        for sensor, _, origin in parts:
            origins[sensor] = origin
        for sensor in np.flatnonzero(np.isnan(origins[:, 0])):  # sensors that have not measured yet
            frame = self._scan.topics[self.sensors[sensor]].sample.frame
            found = self._scan.tree.lookup(self.fixed_frame, frame, time_ns, hold_ns=None)
            origins[sensor] = found[1] if found else 0.0
        parts = sorted(parts, key=lambda part: part[0])
        return Frame(
            time_ns=time_ns,
            points=np.concatenate([points for _, points, _ in parts]).astype(np.float32).reshape(-1, 3),
            sensor=np.repeat([s for s, _, _ in parts], [len(p) for _, p, _ in parts]).astype(np.int32),
            origins=origins.astype(np.float32),
        )

    def _measure(self, topic: str, content: Cloud | Image, stamp_ns: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Points [point, 3] and the sensor's position [3] in the fixed frame; None if there is no transform."""
        s = self._settings
        found = self._scan.tree.lookup(self.fixed_frame, content.frame, stamp_ns)
        if found is None:
            seconds = f"{HOLD_NS / 1e9:g} s"
            why = f"left out, no transform from '{content.frame}' to '{self.fixed_frame}' within {seconds} of the stamp"
            self._counted[topic, why] += 1
            return None
        rotation, translation = found
        if isinstance(content, Image):
            if content.raw is None:
                raise ValueError(f"encoding changed to {content.encoding}")
            k = stride(*content.shape, s.max_points)
            z = content.raw[::k, ::k].astype(np.float64) * content.unit
            keep = np.isfinite(z) & (z > 0)
            z = z[keep]
            rays = self._pixel_rays(topic, content, k)[keep]
            points = np.column_stack([rays * z[:, None], z])
        else:
            points = content.points(s.max_points)
        with np.errstate(invalid="ignore", over="ignore"):
            square = np.einsum("ni,ni->n", points, points)
            # NaN fails every comparison; a range of exactly 0 is a driver's word for nothing seen.
            points = points[(square >= s.min_range**2) & (square <= s.max_range**2) & (square > 0)]
        if isinstance(content, Cloud) and content.pose is not None:
            translation = rotation @ content.pose[1] + translation
            rotation = rotation @ content.pose[0]
        if np.abs(translation).max() > 1e4:
            note = f"Coordinates in '{self.fixed_frame}' exceed 10 km, inexact in float32: set another fixed_frame."
            if note not in self._notes:
                self._notes.append(note)
        return points @ rotation.T + translation, translation

    def _pixel_rays(self, topic: str, image: Image, k: int) -> np.ndarray:
        key = (topic, image.shape, k)
        if key not in self._rays:
            c = self._scan.calibration(topic)
            assert c is not None
            # By ROS custom a topic called image_rect... is rectified: P holds, and the lens is undone already.
            rectified = "rect" in topic.rsplit("/", 1)[-1] and c.P[0, 0] > 0
            K, D = (c.P[:, :3].copy(), np.zeros(0)) if rectified else (c.K.copy(), c.D)
            height, width = image.shape
            if c.width and c.height and (c.width, c.height) != (width, height):
                scale = np.array([width / c.width, height / c.height])
                K[:2, :2] *= scale[:, None]
                K[:2, 2] = (K[:2, 2] + 0.5) * scale - 0.5
                self._notes.append(
                    f"'{topic}' is {width} x {height} pixels, its calibration {c.width} x {c.height}: scaled to fit."
                )
            self._rays[key] = camera.pixel_rays(K, D, c.model, width, height)[::k, ::k].copy()
        return self._rays[key]

    def _no_depth(self) -> str:
        scan = self._scan
        blind = [name for name, use in scan.uses.items() if "a depth image w" in use]
        if blind:
            uses = "; ".join(f"'{name}' is {scan.uses[name].removeprefix('not used: ')}" for name in blind)
            return (
                f"'{self.path}' has no depth image that can be used: {uses}. "
                "Record the camera's calibration (sensor_msgs/msg/CameraInfo or foxglove.CameraCalibration) with it."
            )
        dead = [name for name, use in scan.uses.items() if "no message can be decoded" in use]
        if dead:
            uses = "; ".join(f"'{name}': {scan.topics[name].error}" for name in dead)
            return f"'{self.path}': no depth message can be decoded ({uses}). Was it written by another version?"
        damage = " ".join(["", *scan.log.damage])
        lost = [f"'{name}'" for name, use in scan.uses.items() if use.startswith("not used: none of its")]
        if lost:
            return (
                f"'{self.path}' is damaged: no message of {', '.join(lost)} can be read.{damage} Copy the file again."
            )
        held = "; ".join(f"{t.topic} ({t.type}, {t.count} messages) {t.use}" for t in scan.table())
        return f"'{self.path}' holds no depth data. It holds: {held}. {NEEDED}{damage}"

    def _choose_fixed_frame(self, sensors: list[str]) -> tuple[str, list[str]]:
        """Name of the fixed frame, and the sensors that are connected to it."""
        tree, asked = self._scan.tree, self._settings.fixed_frame.lstrip("/")
        frame = {name: self._scan.topics[name].sample.frame for name in sensors}
        known = sorted({*tree.frames, *frame.values()})
        if asked and asked not in known:
            raise LogError(f"'{self.path}' has no frame '{asked}'. Its frames: {', '.join(known)}.")
        roots = {name: tree.root(frame[name]) for name in sensors}
        number = Counter(roots.values())
        best = max(sensors, key=lambda name: (frame[name] in tree.frames, number[roots[name]], -sensors.index(name)))
        if tree.frames and not asked and frame[best] not in tree.frames:
            lone = ", ".join(f"'{f}'" for f in sorted(set(frame.values())))
            raise LogError(
                f"'{self.path}': no depth sensor is in the transform tree, nothing links {lone} to any of "
                f"{', '.join(tree.frames)}. Record the missing transform, or set fixed_frame to '{frame[best]}' "
                "to track in the sensor's own frame."
            )
        fixed = asked or roots[best]
        if not tree.frames:
            self._notes.append(f"The log has no transforms: everything is given in the frame '{fixed}' of the sensor.")
        kept = [name for name in sensors if tree.connected(frame[name], fixed)]
        for name in sensors:
            if name not in kept:
                self._notes.append(f"'{name}' is left out: no transform between '{frame[name]}' and '{fixed}'.")
        if not kept:
            missing = ", ".join(f"'{f}'" for f in sorted(set(frame.values())))
            raise LogError(
                f"'{self.path}': no depth sensor is connected to the fixed frame '{fixed}', transforms are missing "
                f"from {missing}. Choose another fixed_frame or record the transforms (/tf, /tf_static)."
            )
        return fixed, kept

    def _upward(self) -> np.ndarray:
        """Up in the fixed frame: the root frame's z (REP 103), or -y for a camera that is the root itself."""
        tree, fixed = self._scan.tree, self.fixed_frame
        root = tree.root(fixed)
        if "optical" in root.lower() or (root not in tree.frames and self._scan.uses[self.sensors[0]] == "depth image"):
            up = np.array([0.0, -1.0, 0.0])
        else:
            up = np.array([0.0, 0.0, 1.0])
        found = tree.lookup(fixed, root, self._plan[0][0], hold_ns=None)
        return (found[0] @ up if found else up).astype(np.float32)

    def _clean_stamps(self, name: str) -> np.ndarray:
        """Stamp of each of a topic's messages, nanoseconds, in the order of reading."""
        topic = self._scan.topics[name]
        stamps, log_times = np.array(topic.stamps, np.int64), np.array(topic.log_times, np.int64)
        zero = stamps == 0
        if zero.any():
            self._notes.append(
                f"'{name}': {_many(int(zero.sum()))} without header stamp; the log time is used for them."
            )
            stamps = np.where(zero, log_times, stamps)
        distinct = len(np.unique(stamps))
        if 2 * distinct < len(stamps) and len(np.unique(log_times)) > distinct:
            self._notes.append(
                f"'{name}': {len(stamps)} messages have only {distinct} header stamps; log time is used."
            )
            stamps, distinct = log_times, len(np.unique(log_times))
        backwards = int((np.diff(stamps) < 0).sum())
        if backwards:
            self._notes.append(f"'{name}': the stamps run backwards at {backwards} places; messages were sorted.")
        if distinct < len(stamps):
            self._notes.append(f"'{name}': {_many(len(stamps) - distinct)} with the stamp of another, left out.")
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
