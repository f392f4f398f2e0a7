"""Unpacks compressed clouds of point_cloud_transport (zlib, zstd, Draco) and of Foxglove (Draco).

Draco is unpacked by DracoPy, which wraps Google's library, has wheels for all systems, and is maintained.
"""

import zlib
from typing import Any

import numpy as np
import zstandard
from jaxtyping import Float32

from voodoo_jax.config.limited import limits, too_large
from voodoo_jax.io.decode.depth import foxglove_pose, ros_cloud
from voodoo_jax.records.messages import Cloud, frame_name, pb_stamp, ros_stamp

_EITHER = 32 + zlib.MAX_WBITS  # of zlib and gzip, as the head says
# A file of Draco begins with its name, two numbers of its version, what it holds, how, and two bytes of flags.
_HEAD, _CLOUD, _METADATA = 11, 0, 0x8000
_BYTES = 12  # of a point, unpacked
_POSITION = 0  # Draco's number for attributes that are places
_AXES = ("x", "y", "z")


def _ros_packed(m: Any) -> Cloud:
    """Raises ValueError for what is not packed as its format says, or unpacks to too much."""
    how, data = m.format.strip().lower(), bytes(m.compressed_data)
    if how == "draco":
        points = _draco(data, tuple(field.name for field in m.fields))
        return Cloud(ros_stamp(m.header), frame_name(m.header.frame_id), _grid(points))
    if how not in ("zlib", "zstd"):
        advice = ": unpack it by cloudini_rosbag_converter" if how == "cloudini" else ""
        raise ValueError(f"a cloud packed by '{m.format}' is not read{advice}")
    size = m.height * max(m.row_step, m.width * m.point_step)
    if trouble := too_large("the cloud unpacks to", size, "chunk_bytes"):
        raise ValueError(trouble)
    return ros_cloud(m, _inflated(data, size) if how == "zlib" else _zstd(data, size))


def _foxglove_packed(m: Any) -> Cloud:
    if m.format.strip().lower() != "draco":
        raise ValueError(f"a cloud packed by '{m.format}' is not read")
    return Cloud(pb_stamp(m), frame_name(m.frame_id), _grid(_draco(m.data, ())), foxglove_pose(m))


def _inflated(data: bytes, size: int) -> bytes:
    try:
        return zlib.decompressobj(_EITHER).decompress(data, size + 1)
    except zlib.error as problem:
        raise ValueError(f"the cloud cannot be unpacked: {problem}") from problem


def _zstd(data: bytes, size: int) -> bytes:
    try:
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            return stream.read(size + 1)
    except zstandard.ZstdError as problem:
        raise ValueError(f"the cloud cannot be unpacked: {problem}") from problem


def _draco(data: bytes, names: tuple[str, ...]) -> Float32[np.ndarray, "point 3"]:
    """Positions in a cloud packed by Draco; `names` of its attributes, if their order identifies them."""
    try:
        import DracoPy
    except ImportError as missing:
        raise ValueError('Draco is needed to unpack it: pip install "voodoo_jax[draco]"') from missing
    count = _count(data)
    if trouble := too_large("the cloud has", count, "points", "points"):
        raise ValueError(trouble)
    if _BYTES * count > limits().log_times * len(data):
        raise ValueError(f"{len(data)} bytes are too few for the {count} points of the cloud")
    try:
        attributes: list[dict[str, Any]] = DracoPy.decode(data).attributes
    except Exception as problem:  # DracoPy raises bare exceptions of its own
        raise ValueError(f"the cloud cannot be unpacked by Draco: {problem}") from problem
    return places(attributes, names)


def places(attributes: list[dict[str, Any]], names: tuple[str, ...]) -> Float32[np.ndarray, "point 3"]:
    """Positions in Draco's attributes: one with three numbers, or one for each axis, as point_cloud_transport packs the
    fields of a cloud. Raises ValueError without positions."""
    found = [a["data"] for a in attributes if a["attribute_type"] == _POSITION]
    if found and found[0].shape[1] == 3:
        return np.asarray(found[0], np.float32)
    if len(names) == len(attributes) and all(axis in names for axis in _AXES):
        ordered = sorted(attributes, key=lambda a: a["unique_id"])
        found = [ordered[names.index(axis)]["data"] for axis in _AXES]
    if len(found) < 3 or any(data.shape[1] != 1 for data in found[:3]):
        raise ValueError("the cloud that Draco has packed has no positions")
    return np.concatenate(found[:3], 1).astype(np.float32)


def _count(data: bytes) -> int:
    """Number of points that a file of Draco says it has: it comes behind the head and what is written about it."""
    if data[:5] != b"DRACO" or len(data) < _HEAD + 4 or data[7] != _CLOUD:
        raise ValueError("the cloud is not packed by Draco")
    at = _HEAD
    if int.from_bytes(data[9:11], "little") & _METADATA:
        at = _behind_metadata(data, at)
    return int.from_bytes(data[at : at + 4], "little")


def _behind_metadata(data: bytes, at: int) -> int:
    """Position in a Draco file after its metadata: those of its attributes, then its own."""
    count, at = _varint(data, at)
    for _ in range(count):  # each takes bytes, so that they end where the data do
        _, at = _varint(data, at)
        at = _behind_entries(data, at, 0)
    return _behind_entries(data, at, 0)


def _behind_entries(data: bytes, at: int, depth: int) -> int:
    entries, at = _varint(data, at)
    for _ in range(entries):
        at += 1 + data[at]  # name
        size, at = _varint(data, at)
        at += size
        if at >= len(data):
            raise ValueError("the cloud that Draco has packed is cut off")
    inner, at = _varint(data, at)
    if inner and depth > 8:
        raise ValueError("the cloud that Draco has packed is damaged")
    for _ in range(inner):
        at += 1 + data[at]
        at = _behind_entries(data, at, depth + 1)
    return at


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of groups of seven bits, the lowest first, and where it ends. IndexError where the data end."""
    number = shift = 0
    while True:
        byte, at = data[at], at + 1
        number |= (byte & 127) << shift
        if byte < 128:
            return number, at
        shift += 7
        if shift > 35:
            raise ValueError("the cloud that Draco has packed is damaged")


def _grid(points: Float32[np.ndarray, "point 3"]) -> np.ndarray:
    return np.ascontiguousarray(points).view(np.dtype([(axis, "f4") for axis in _AXES])).reshape(1, -1)


CONVERTERS = {
    "point_cloud_interfaces/msg/CompressedPointCloud2": ("point cloud", _ros_packed),
    "foxglove.CompressedPointCloud": ("point cloud", _foxglove_packed),
}
