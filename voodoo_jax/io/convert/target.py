"""The MCAP log that a recording is converted to."""

import os
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

from voodoo_jax.storage.atomic import replacing

START_NS = 1_000_000_000  # stamp of a first frame that has none: not 0, which means that there is no stamp
RADIUS = 0.007  # metres, of the spheres that stand for markers (half of the usual 14 mm)
SECONDS, NANOSECONDS = re.compile(r"\d{1,12}\.\d+"), re.compile(r"\d{19}")  # names of files
Put = Callable[[str, int, Any], None]  # topic, stamp in nanoseconds, message of foxglove's


class ConvertError(ValueError):
    """A recording that cannot be converted, with the reason and what to do."""


def named_times(folder: Path, endings: tuple[str, ...], rate: float) -> list[tuple[int, Path]]:
    """Files of a folder in their order, with stamps in nanoseconds: their names, where these are times in seconds, or
    nanoseconds (19 digits); else numbered at a rate (files a second). Raises ConvertError."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in endings and not path.name.startswith(".")]
    if files and all(SECONDS.fullmatch(path.stem) for path in files):
        return sorted((round(float(path.stem) * 1e9), path) for path in files)
    if files and all(NANOSECONDS.fullmatch(path.stem) for path in files):
        return sorted((int(path.stem), path) for path in files)
    if files and not rate > 0:
        raise ConvertError(f"'{folder}': the files' names are not times in seconds: give their rate (--rate, in Hz)")
    files.sort(key=lambda path: ([int(number) for number in re.findall(r"\d+", path.stem)], path.name))
    return [(START_NS + round(i * 1e9 / rate), path) for i, path in enumerate(files)]


@contextmanager
def new_log(path: str | os.PathLike[str]) -> Iterator[Writer]:
    """A writer of a log that appears under its name when it is complete. Raises OSError."""
    with replacing(path) as partial, open(partial, "wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="", library="voodoo_jax convert")
        yield writer
        writer.finish()


def putter(writer: Writer, up: str = "") -> Put:
    """What writes messages of foxglove's into a log; `up` which way is up by the recording's format, as in read.up."""
    channels: dict[str, int] = {}

    def put(topic: str, stamp: int, message: Any) -> None:
        if topic not in channels:
            descriptors = build_file_descriptor_set(type(message)).SerializeToString(deterministic=True)
            schema = writer.register_schema(message.DESCRIPTOR.full_name, "protobuf", descriptors)
            channels[topic] = writer.register_channel(topic, "protobuf", schema, {"up": up} if up else {})
        writer.add_message(channels[topic], stamp, message.SerializeToString(), stamp)

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
