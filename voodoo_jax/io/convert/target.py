"""Writes the MCAP log of a conversion."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from voodoo_jax.config.limited import TIME, limits, too_large
from voodoo_jax.io.convert.errors import LIBRARY, ConvertError
from voodoo_jax.storage.guarded import Answer
from voodoo_jax.storage.troubles import NotReadable, small_file

# bytes that a message counts beside what it says, for it takes as long: a million of them in a small file (SQLite may
# compute them); by hand
ROW = 4096
START_NS = 1_000_000_000  # stamp of a first frame that has none: not 0, which means that there is no stamp
RADIUS = 0.007  # metres, of the spheres that stand for markers (half of the usual 14 mm)
SECONDS, NANOSECONDS = re.compile(r"\d{1,12}\.\d+"), re.compile(r"\d{19}")  # names of files
Put = Callable[[str, int, Any], None]  # topic, stamp in nanoseconds, message of foxglove's


def named_times(folder: Path, endings: tuple[str, ...], rate: float) -> list[tuple[int, Path]]:
    """Files of a folder (or a single file) in order, with stamps in nanoseconds: from their names, if these are times
    in seconds or nanoseconds (19 digits), else from their numbers and a rate (files per second). Raises
    ConvertError."""
    if folder.is_file():
        return [(START_NS, folder)]
    files = [path for path in folder.iterdir() if path.suffix.lower() in endings and not path.name.startswith(".")]
    if files and all(SECONDS.fullmatch(path.stem) for path in files):
        return sorted((round(float(path.stem) * 1e9), path) for path in files)
    if files and all(NANOSECONDS.fullmatch(path.stem) for path in files):
        return sorted((int(path.stem), path) for path in files)
    if files and not rate > 0:
        raise ConvertError(f"'{folder}': the files' names are not times in seconds: give their rate (--rate, in Hz)")
    files.sort(key=lambda path: ([int(number) for number in re.findall(r"\d+", path.stem)], path.name))
    return [(START_NS + round(i * 1e9 / rate), path) for i, path in enumerate(files)]


class NewLog(Writer):
    """A writer that limits the unpacked size of a log."""

    def __init__(self, stream: Answer):
        super().__init__(stream, compression=CompressionType.ZSTD)  # type: ignore[arg-type]
        self._left = stream.size

    def add_message(self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0) -> None:
        """Adds a message. Raises ConvertError beyond the limit, ValueError for invalid values."""
        self._left -= len(data) + ROW
        if self._left < 0:
            raise ConvertError("it becomes a log of more than --limits.log_bytes allow")
        if trouble := too_large("a message has", len(data), "chunk_bytes"):
            raise ValueError(trouble)
        if not 0 <= log_time < TIME:
            raise ValueError(f"a message has an impossible time, {log_time} ns")
        super().add_message(channel_id, log_time, data, publish_time, sequence)


@contextmanager
def new_log(stream: Answer) -> Iterator[NewLog]:
    """A writer of a log, which is complete at the end."""
    writer = NewLog(stream)
    writer.start(profile="", library=LIBRARY)
    yield writer
    writer.finish()


def content(path: Path, inside: Path | None = None) -> bytes:
    """The contents of a file of a recording, at most as large as a chunk may be. Raises ConvertError, OSError."""
    try:
        return small_file(path, inside, limits().chunk_bytes)
    except NotReadable as problem:
        raise ConvertError(f"'{path.name}' cannot be read: {problem}") from problem


def check_points(names: int, rows: int) -> None:
    """Raises ConvertError for more names, or named points in all rows together, than a log may have."""
    trouble = too_large("it has", names, "names", "names") or too_large("it has", names * rows, "features", "points")
    if trouble:
        raise ConvertError(trouble)


def putter(writer: Writer, up: str = "") -> Put:
    """A function that writes Foxglove messages, with their stamps, into a log; `up` is the format's upward direction,
    as in read.up."""
    channels: dict[str, int] = {}

    def put(topic: str, stamp: int, message: Any) -> None:
        if "timestamp" in message.DESCRIPTOR.fields_by_name:
            message.timestamp.FromNanoseconds(stamp)
        if topic not in channels:
            descriptors = build_file_descriptor_set(type(message)).SerializeToString(deterministic=True)
            schema = writer.register_schema(message.DESCRIPTOR.full_name, "protobuf", descriptors)
            channels[topic] = writer.register_channel(topic, "protobuf", schema, {"up": up} if up else {})
        writer.add_message(channels[topic], stamp, message.SerializeToString(deterministic=True), stamp)

    return put


def scene_of_points(names: list[str], points: np.ndarray, stamp: int, frame: str) -> SceneUpdate:
    """Named 3D points [point, 3], metres, as spheres; those that are NaN are left out."""
    scene = SceneUpdate()
    for name, place in zip(names, points.tolist()):
        if np.isfinite(place).all():
            entity = SceneEntity(id=name, frame_id=frame)
            entity.timestamp.FromNanoseconds(stamp)
            sphere = entity.spheres.add()
            sphere.pose.position.x, sphere.pose.position.y, sphere.pose.position.z = place
            sphere.pose.orientation.w = 1
            sphere.size.x = sphere.size.y = sphere.size.z = 2 * RADIUS
            sphere.color.r = sphere.color.g = sphere.color.b = sphere.color.a = 1
            scene.entities.append(entity)
    return scene
