"""ROS 1 bags (.bag) and SQLite bags of ROS 2 (.db3, or their folder): every message, in ROS 2's encoding.

`driver_types.msg` has message definitions for bags without them (SQLite bags before Iron), as the drivers' packages
define them (Livox, RealSense, ZED, vision_msgs 4, point_cloud_interfaces, mocap4r2_msgs); others can be given as files.
Bags of the RealSense viewer and SDK have image and calibration of a stream in `/device_0/sensor_0/Depth_0/image/data`
and `.../info/camera_info`; the unit of depth counts is the option Depth_Units (librealsense, src/media/ros).
"""

import re
from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
from mcap.writer import Writer
from rosbags.convert.converter import STATIC_MSGTYPE_RENAMES, migrate_bytes
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import ReaderError as Bag1Error
from rosbags.rosbag1 import reader as bag1
from rosbags.rosbag2 import ReaderError as Bag2Error
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from voodoo_jax.config.limited import limits, too_large
from voodoo_jax.io.convert.target import ConvertError, new_log
from voodoo_jax.io.decode.by_fields import by_fields
from voodoo_jax.io.decode.registry import KINDS
from voodoo_jax.storage.guarded import Answer
from voodoo_jax.storage.troubles import check_file, small_text

BUILT_IN, FIRST = Path(__file__).with_name("driver_types.msg"), "livox_ros_driver2/msg/CustomMsg"
WAY_OUT = "give its definition, the .msg file of its package: --read.types FILE.msg (voodoo-jax convert: --types)"
IMAGE = re.compile(r"^(/device_\d+)/sensor_\d+/(\w+?)_(\d+)/(?:image/data|info/(camera_info))$")
UNITS = re.compile(r"^(/device_\d+)/sensor_\d+/option/Depth[_ ]Units/value$")
MILLIMETRE = 0.001
CLOSE = 1e-6  # metres: units that differ by less are one
BROKEN = (AnyReaderError, Bag1Error, Bag2Error, SerdeError, TypesysError, AssertionError, KeyError, ValueError)


def register(store: Any, wanted: Sequence[str], given: Sequence[str]) -> set[str]:
    """Adds missing definitions to a typestore, first those of the given files; returns the names in `wanted` that it
    now knows. Raises ConvertError for a file without definitions."""
    missing = {name for name in wanted if name not in store.fielddefs}
    if missing:
        types = get_types_from_msg(small_text(BUILT_IN), FIRST) | _of_files(given, missing)
        store.register({name: fields for name, fields in types.items() if name not in store.fielddefs})
    return {name for name in missing if name in store.fielddefs}


def _of_files(given: Sequence[str], missing: set[str]) -> dict[str, Any]:
    """Types that files define, each with those beside it in its folder."""
    found: dict[str, Any] = {}
    for place in map(Path, given):
        try:
            package = _package(place, missing)
            for path in [*sorted(place.parent.glob("*.msg")), place]:
                found |= get_types_from_msg(small_text(path), f"{package}/msg/{path.stem}")
        except (OSError, ValueError, KeyError, TypesysError) as problem:
            raise ConvertError(f"read.types: '{place}' is not a message definition (.msg): {problem}") from problem
    return found


def _package(path: Path, missing: set[str]) -> str:
    """Of a definition: as its folder says (PACKAGE/msg/TYPE.msg), or as the bag does that lacks it."""
    if path.parent.name == "msg":
        return path.resolve().parent.parent.name
    return next((name.split("/")[0] for name in sorted(missing) if name.endswith(f"/{path.stem}")), path.parent.name)


def plain_topic(topic: str) -> str:
    """The common topic of an image and its calibration; others are unchanged."""
    match = IMAGE.match(topic)
    if match is None:
        return topic
    device, stream, number, info = match.groups()
    name = stream.lower() + (f"_{number}" if number != "0" else "")
    return f"{device}/{name}/{'camera_info' if info else 'image'}"


def depth_units(reader: Any) -> dict[str, float]:
    """Metres per depth count, by device, if it is not a millimetre."""
    found: dict[str, float] = {}
    connections = [c for c in reader.connections if UNITS.match(c.topic)]
    for connection, _, raw in reader.messages(connections=connections) if connections else ():
        device = UNITS.match(connection.topic)[1]  # type: ignore[index]
        unit = float(reader.deserialize(raw, connection.msgtype).data)
        if unit > 0 and abs(unit - MILLIMETRE) > CLOSE:
            found.setdefault(device, unit)
    return found


def unit_of(topic: str, kind: str, units: dict[str, float]) -> float | None:
    """Metres per count of a topic's images; None: they are millimetres, or no depth images."""
    match = IMAGE.match(topic)
    if match is None or not kind.endswith("/Image") or match[2].lower() != "depth":
        return None
    return units.get(match[1])


def in_metres(store: Any, data: bytes, kind: str, unit: float) -> bytes:
    """Converts a message of 16-bit counts (CDR) to metres, 32 bits."""
    image = store.deserialize_cdr(data, kind)
    order = ">" if image.is_bigendian else "<"
    rows = np.asarray(image.data).reshape(image.height, image.step)[:, : 2 * image.width]
    metres = np.ascontiguousarray(rows).view(f"{order}u2") * np.float64(unit)
    values = {name: getattr(image, name) for name in ("header", "height", "width")}
    made = store.types[kind](
        **values,
        encoding="32FC1",
        is_bigendian=0,
        step=4 * image.width,
        data=metres.astype("<f4").view(np.uint8).ravel(),
    )
    return bytes(store.serialize_cdr(made, kind))


def convert(source: Path, target: Answer, types: Sequence[str] = ()) -> list[str]:
    """Copies all topics; returns notes on topics left out. `types` files with message definitions that the bag lacks.
    Raises ConvertError, OSError."""
    notes: list[str] = []
    for path in source.iterdir() if source.is_dir() else ():
        check_file(path, source)
    with _opened(source) as reader, new_log(target) as writer:
        store = reader.typestore if reader.is2 else _ros2_types(reader)
        if trouble := too_large("it has", len(reader.connections), "topics", "topics"):
            raise ConvertError(f"'{source}': {trouble}")
        assumed = register(store, [c.msgtype for c in reader.connections], types) if reader.is2 else set()
        channels = {c.id: _channel(store, writer, c, notes) for c in reader.connections}
        for connection in reader.connections:
            if connection.msgtype in assumed and not _fits(reader, connection):
                channels[connection.id] = None
                notes.append(
                    f"'{connection.topic}' was left out: its messages have another version of "
                    f"{connection.msgtype} than the known one: {WAY_OUT}"
                )
        _check_use(source, store, [c for c in reader.connections if channels[c.id] is not None], notes)
        units = depth_units(reader)
        notes += [f"{device}: depth counts of {1000 * unit:g} mm became metres" for device, unit in units.items()]
        cache: dict[str, object] = {}
        count = 0
        try:
            for connection, stamp, raw in reader.messages():
                channel = channels[connection.id]
                if channel is None:
                    continue
                data = raw
                if not reader.is2:  # headers and calibrations have other fields in ROS 2
                    kinds = (connection.msgtype, _renamed(connection.msgtype))
                    data = migrate_bytes(reader.typestore, store, *kinds, cache, raw, src_is2=False, dst_is2=True)
                if unit := unit_of(connection.topic, connection.msgtype, units):
                    data = in_metres(store, bytes(data), _renamed(connection.msgtype), unit)
                writer.add_message(channel, stamp, bytes(data), stamp)
                count += 1
        except BROKEN as problem:
            if not count:
                raise ConvertError(f"'{source}' cannot be read: {type(problem).__name__}: {problem}") from problem
            notes.append(f"'{source}' is damaged after {count} messages: {type(problem).__name__}: {problem}")
        if not count:
            raise ConvertError(f"'{source}' has no message that could be read")
    return notes


def _fits(reader: Any, connection: Any) -> bool:
    """Whether the first message of a topic is of the type that is assumed."""
    for _, _, raw in reader.messages(connections=[connection]):
        try:
            reader.deserialize(raw, connection.msgtype)
        except BROKEN:
            return False
        break
    return True


def _check_use(source: Path, store: Any, kept: list[Any], left_out: list[str]) -> None:
    """Raises ConvertError where topics were left out and no measurement is left."""
    kinds = {_renamed(c.msgtype) for c in kept}
    used = {KINDS.get(kind, "") or by_fields(store, kind)[0] for kind in kinds}
    if left_out and not used - {"", "calibration", "transforms"}:
        raise ConvertError(f"'{source}' has no usable topic left: {'; '.join(left_out)}")


def _part(decoder: Callable[[], Any]) -> Callable[[bytes], bytes]:
    """What unpacks a chunk of a ROS 1 bag as far as one may unpack."""

    def unpacked(data: bytes) -> bytes:
        most, one = limits().chunk_bytes, decoder()
        found = one.decompress(data, max_length=most + 1)
        if trouble := too_large("a chunk unpacks to", len(found), "chunk_bytes"):
            raise ValueError(trouble)
        return found

    return unpacked


@contextmanager
def _opened(source: Path) -> Iterator[Any]:
    bag1.decompressors |= {"bz2": _part(BZ2Decompressor), "lz4": _part(lz4.frame.LZ4FrameDecompressor)}
    try:
        # a recorder that was stopped hard writes no metadata
        bare = source.is_dir() and not (source / "metadata.yaml").exists()
        files = sorted(source.glob("*.db3")) if bare else [source]
        reader = AnyReader(files, default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except BROKEN as problem:
        raise ConvertError(f"'{source}' cannot be opened as a bag: {problem}") from problem
    try:
        yield reader
    finally:
        reader.close()


def _renamed(kind: str) -> str:
    return STATIC_MSGTYPE_RENAMES.get(kind, kind)


def _ros2_types(reader: Any) -> Any:
    """ROS 2's types, and those of a ROS 1 bag that it does not know."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for connection in reader.connections:
        if _renamed(connection.msgtype) not in store.fielddefs:
            text, _ = reader.typestore.generate_msgdef(connection.msgtype, ros_version=2)
            found = get_types_from_msg(text, connection.msgtype)
            store.register({name: fields for name, fields in found.items() if name not in store.fielddefs})
    return store


def _channel(store: Any, writer: Writer, connection: Any, notes: list[str]) -> int | None:
    kind = _renamed(connection.msgtype)
    try:
        text, _ = store.generate_msgdef(kind, ros_version=2)
    except BROKEN as problem:
        notes.append(f"'{connection.topic}' was left out: {kind} is not known: {WAY_OUT} ({problem})")
        return None
    if trouble := too_large("its definition has", len(text), "schema_bytes"):
        notes.append(f"'{connection.topic}' was left out: {trouble}")
        return None
    schema = writer.register_schema(kind, "ros2msg", text.encode())
    return writer.register_channel(plain_topic(connection.topic), "cdr", schema)
