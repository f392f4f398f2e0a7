"""Messages of ROS 2 and Foxglove logs as plain NumPy. Everything that knows a message type by name is here."""

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError as ProtobufError
from jaxtyping import Float
from mcap.exceptions import McapError
from mcap.records import Channel, Schema
from mcap_protobuf.decoder import DecoderFactory
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from voodoo_jax.io.transforms import Transform

KINDS = {
    "sensor_msgs/msg/PointCloud2": "point cloud",
    "sensor_msgs/msg/Image": "image",
    "sensor_msgs/msg/CameraInfo": "calibration",
    "tf2_msgs/msg/TFMessage": "transforms",
    "foxglove.PointCloud": "point cloud",
    "foxglove.RawImage": "image",
    "foxglove.CameraCalibration": "calibration",
    "foxglove.FrameTransform": "transforms",
    "foxglove.FrameTransforms": "transforms",
}
_ENCODINGS = {("cdr", "ros2msg"), ("cdr", "ros2idl"), ("protobuf", "protobuf")}
_DEPTH = {"16UC1": ("u2", 0.001), "MONO16": ("u2", 0.001), "32FC1": ("f4", 1.0)}  # pixel type, metres per unit
# Signed and unsigned are swapped between the two: ROS INT8=1, UINT8=2; Foxglove UINT8=1, INT8=2.
_ROS_FIELDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_FOXGLOVE_FIELDS = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}
# One broken message raises one of these in rosbags, protobuf or NumPy.
DECODE_ERRORS = (
    SerdeError,
    TypesysError,
    ProtobufError,
    McapError,
    struct.error,
    ValueError,  # also UnicodeDecodeError
    TypeError,
    LookupError,
    AttributeError,
    AssertionError,
    OverflowError,
    MemoryError,
)


@dataclass(frozen=True)
class Cloud:
    """A point cloud as it lies in the message: `grid` is a structured [row, column] view with fields x, y, z."""

    stamp_ns: int
    frame: str
    grid: np.ndarray
    pose: tuple[np.ndarray, np.ndarray] | None = None  # frame_T_cloud: rotation matrix, translation in metres

    def points(self, max_points: int) -> Float[np.ndarray, "point 3"]:
        """At most about `max_points` points in metres, in the cloud's own frame; invalid ones still among them."""
        rows, columns = self.grid.shape
        if rows > 1 and columns > 1:
            k = stride(rows, columns, max_points)
            part = self.grid[::k, ::k]
        else:
            part = self.grid.reshape(-1)[:: max(1, -(-self.grid.size // max_points))]
        return np.stack([part[axis].ravel() for axis in "xyz"], axis=-1).astype(np.float64)


@dataclass(frozen=True)
class Image:
    """A one-channel image of distances along the optical axis, or a reason why it is none."""

    stamp_ns: int
    frame: str
    encoding: str
    shape: tuple[int, int]  # rows, columns
    raw: np.ndarray | None  # [row, column] view; None if the encoding is none of depth
    unit: float  # metres per raw unit


@dataclass(frozen=True)
class Calibration:
    """Camera model in OpenCV's terms. K and D describe the raw image, P the rectified one. Pixels."""

    stamp_ns: int
    frame: str
    width: int
    height: int
    model: str
    D: Float[np.ndarray, " coefficient"]
    K: Float[np.ndarray, "3 3"]
    P: Float[np.ndarray, "3 4"]


def kind_of(schema: Schema | None, channel: Channel) -> str:
    """What a channel may be used for: "image", "point cloud", "calibration", "transforms", or "" for nothing."""
    if schema is None or (channel.message_encoding, schema.encoding) not in _ENCODINGS:
        return ""
    return KINDS.get(_full(schema.name), "")


def reason_unused(schema: Schema | None, channel: Channel) -> str:
    """Why a channel with no kind is not read."""
    if schema is None:
        return "it has no schema"
    name = schema.name.rsplit("/", 1)[-1].rsplit(".", 1)[-1]
    if _full(schema.name) in KINDS or (channel.message_encoding, schema.encoding) not in _ENCODINGS:
        return f"encoding {channel.message_encoding or '?'}/{schema.encoding or '?'} is not read"
    if "Compressed" in name:
        return "compressed images and clouds are not read"
    if name == "LaserScan":
        return "a single line of a laser scanner"
    return "no depth, calibration or transforms"


def is_static(schema: Schema | None, channel: Channel) -> bool:
    """Whether transforms on this channel hold for the whole log."""
    if channel.topic.rstrip("/").endswith("tf_static"):
        return True
    qos = channel.metadata.get("offered_qos_profiles", "")
    return re.search(r"durability:\s*(1\b|transient_local)", qos) is not None


def stride(rows: int, columns: int, most: int) -> int:
    """Smallest step in rows and columns that leaves at most `most` pixels."""
    k = max(1, int(np.sqrt(rows * columns / most)))
    while -(-rows // k) * -(-columns // k) > most and k < max(rows, columns):
        k += 1
    return k


class Decoder:
    """Turns message bytes into `Cloud`, `Image`, `Calibration` or a list of `Transform`; one decoder per schema."""

    def __init__(self):
        self._made: dict[tuple[str, bytes], Callable[[bytes], Any]] = {}

    def message(self, schema: Schema, channel: Channel, data: bytes) -> Any:
        """The decoded content. Raises one of DECODE_ERRORS if the message or its schema is broken."""
        key = (schema.name, schema.data)
        if key not in self._made:
            self._made[key] = _ros(schema) if channel.message_encoding == "cdr" else _protobuf(schema)
        return self._made[key](data)


def quick_stamp(channel: Channel, data: bytes) -> int | None:
    """Header stamp of a CDR message that starts with std_msgs/Header, nanoseconds, without decoding the rest."""
    if channel.message_encoding != "cdr" or len(data) < 12:
        return None
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return seconds * 1_000_000_000 + nanoseconds


def _full(name: str) -> str:
    return name if "/msg/" in name or "/" not in name else name.replace("/", "/msg/", 1)


def _ros(schema: Schema) -> Callable[[bytes], Any]:
    store, name, text = get_typestore(Stores.EMPTY), _full(schema.name), schema.data.decode()
    if schema.encoding == "ros2msg":
        store.register(get_types_from_msg(text, name))
    else:
        types = {}
        for part in re.split(r"^=+\r?\n", text, flags=re.MULTILINE):
            # The parser knows no preprocessor; what is included stands in another part anyway.
            body = re.sub(r"\A\s*IDL:[^\n]*\n|^\s*#[^\n]*$", "", part, flags=re.MULTILINE)
            if body.strip():
                types.update(get_types_from_idl(body))
        store.register(types)
    make = {"point cloud": _ros_cloud, "image": _ros_image, "calibration": _ros_calibration, "transforms": _ros_tf}
    convert = make[KINDS[name]]
    return lambda data: convert(store.deserialize_cdr(data, name))


def _ros_stamp(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _ros_cloud(m: Any) -> Cloud:
    fields = {f.name: (_ROS_FIELDS.get(f.datatype), f.offset) for f in m.fields}
    grid = _grid(m.data, m.height, m.width, m.point_step, m.row_step, fields, ">" if m.is_bigendian else "<")
    return Cloud(_ros_stamp(m.header), _frame(m.header.frame_id), grid)


def _ros_image(m: Any) -> Image:
    order = ">" if m.is_bigendian else "<"
    return _image(_ros_stamp(m.header), m.header.frame_id, m.encoding, m.height, m.width, m.step, m.data, order)


def _ros_calibration(m: Any) -> Calibration:
    K, P = np.array(m.k, float).reshape(3, 3), np.array(m.p, float).reshape(3, 4)
    # K describes the full sensor; the image may be a part of it (roi), with pixels added together (binning).
    bx, by = max(int(m.binning_x), 1), max(int(m.binning_y), 1)
    for matrix in (K, P):
        matrix[0, 2] -= m.roi.x_offset
        matrix[1, 2] -= m.roi.y_offset
        matrix[0] /= bx
        matrix[1] /= by
    width, height = (m.roi.width or m.width) // bx, (m.roi.height or m.height) // by
    D = np.array(m.d, float)
    return Calibration(_ros_stamp(m.header), _frame(m.header.frame_id), width, height, m.distortion_model, D, K, P)


def _ros_tf(m: Any) -> list[Transform]:
    return [
        Transform(
            _ros_stamp(t.header),
            _frame(t.header.frame_id),
            _frame(t.child_frame_id),
            _xyz(t.transform.translation),
            _xyzw(t.transform.rotation),
        )
        for t in m.transforms
    ]


def _protobuf(schema: Schema) -> Callable[[bytes], Any]:
    decode = DecoderFactory().decoder_for("protobuf", schema)
    if decode is None:
        raise ValueError("not a protobuf schema")
    make = {
        "foxglove.PointCloud": _foxglove_cloud,
        "foxglove.RawImage": lambda m: _image(
            _pb_stamp(m), m.frame_id, m.encoding, m.height, m.width, m.step, m.data, "<"
        ),
        "foxglove.CameraCalibration": _foxglove_calibration,
        "foxglove.FrameTransform": lambda m: [_foxglove_transform(m)],
        "foxglove.FrameTransforms": lambda m: [_foxglove_transform(t) for t in m.transforms],
    }
    convert = make[schema.name]
    return lambda data: convert(decode(data))


def _pb_stamp(m: Any) -> int:
    return m.timestamp.seconds * 1_000_000_000 + m.timestamp.nanos


def _foxglove_cloud(m: Any) -> Cloud:
    fields = {f.name: (_FOXGLOVE_FIELDS.get(f.type), f.offset) for f in m.fields}
    if m.point_stride <= 0:
        raise ValueError("point_stride is 0")
    count = len(m.data) // m.point_stride
    grid = _grid(m.data, 1, count, m.point_stride, len(m.data), fields, "<")
    pose = None
    if m.HasField("pose"):
        q = _xyzw(m.pose.orientation)
        # Protobuf leaves an unset quaternion all zeros.
        rotation = Rotation.from_quat(q).as_matrix() if np.any(q) else np.eye(3)
        pose = rotation, _xyz(m.pose.position)
    return Cloud(_pb_stamp(m), _frame(m.frame_id), grid, pose)


def _foxglove_calibration(m: Any) -> Calibration:
    K = np.array(m.K, float).reshape(3, 3) if m.K else np.zeros((3, 3))
    P = np.array(m.P, float).reshape(3, 4) if m.P else np.zeros((3, 4))
    D = np.array(m.D, float)
    return Calibration(_pb_stamp(m), _frame(m.frame_id), m.width, m.height, m.distortion_model, D, K, P)


def _foxglove_transform(m: Any) -> Transform:
    return Transform(
        _pb_stamp(m), _frame(m.parent_frame_id), _frame(m.child_frame_id), _xyz(m.translation), _xyzw(m.rotation)
    )


def _frame(name: str) -> str:
    return name.lstrip("/")  # old drivers still write tf1 names


def _xyz(v: Any) -> np.ndarray:
    return np.array([v.x, v.y, v.z], float)


def _xyzw(q: Any) -> np.ndarray:
    return np.array([q.x, q.y, q.z, q.w], float)


def _grid(data: Any, rows: int, columns: int, step: int, row_step: int, fields: dict, order: str) -> np.ndarray:
    if any(axis not in fields or fields[axis][0] is None for axis in "xyz"):
        raise ValueError(f"the cloud has no fields x, y, z but {', '.join(fields) or 'none'}")
    names = list("xyz")
    formats = [order + str(fields[axis][0]) for axis in names]
    offsets = [fields[axis][1] for axis in names]
    dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    if rows * columns == 0:
        return np.empty((0, 0), dtype)
    if rows == 1 or row_step < columns * step:
        row_step = columns * step  # some drivers leave row_step at 0
    if len(data) < (rows - 1) * row_step + columns * step:
        raise ValueError(f"{len(data)} bytes are too few for {rows} x {columns} points of {step} bytes")
    return np.ndarray((rows, columns), dtype, buffer=data, strides=(row_step, step))


def _image(
    stamp_ns: int, frame: str, encoding: str, rows: int, columns: int, step: int, data: Any, order: str
) -> Image:
    kind, unit = _DEPTH.get(encoding.strip().upper(), ("", 1.0))
    raw = None
    if kind:
        dtype = np.dtype(order + kind)
        step = max(step, columns * dtype.itemsize)
        need = (rows - 1) * step + columns * dtype.itemsize
        if rows * columns == 0 or len(data) < need:
            raise ValueError(f"{len(data)} bytes are too few for {rows} x {columns} pixels, or the image is empty")
        raw = np.ndarray((rows, columns), dtype, buffer=data, strides=(step, dtype.itemsize))
    elif not encoding:
        raise ValueError("the image names no encoding")
    return Image(stamp_ns, _frame(frame), encoding.strip(), (rows, columns), raw, unit)
