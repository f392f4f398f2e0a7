"""Small real MCAP logs for tests: messages of ROS 2 and Foxglove with known geometry."""

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf import (
    CameraCalibration_pb2,
    FrameTransform_pb2,
    FrameTransforms_pb2,
    ImageAnnotations_pb2,
    LaserScan_pb2,
    PackedElementField_pb2,
    PointCloud_pb2,
    PosesInFrame_pb2,
    RawImage_pb2,
    SceneUpdate_pb2,
)
from google.protobuf.message import Message as ProtobufMessage
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
START = 1_700_000_000_000_000_000  # nanoseconds
PERIOD = 33_000_000
K = np.array([[100.0, 0.0, 15.5], [0.0, 110.0, 11.5], [0.0, 0.0, 1.0]])
WIDTH, HEIGHT = 32, 24
HALF = float(np.sqrt(0.5))


def header(stamp_ns: int, frame: str) -> Any:
    time = T["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    return T["std_msgs/msg/Header"](time, frame)


def depth_metres(i: int = 0) -> np.ndarray:
    """[24, 32] metres, a tilted wall in whole millimetres; the first pixel saw nothing."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    metres = np.round(1.5 + 0.01 * u + 0.02 * v + 0.001 * i, 3)
    metres[0, 0] = 0.0
    return metres


def depth_points(metres: np.ndarray) -> np.ndarray:
    """[point, 3] in the optical frame, row by row, pinhole K, without pixels that saw nothing."""
    v, u = np.mgrid[0 : metres.shape[0], 0 : metres.shape[1]]
    points = np.stack([(u - K[0, 2]) / K[0, 0] * metres, (v - K[1, 2]) / K[1, 1] * metres, metres], axis=-1)
    return points[metres > 0]


def ros_image(
    stamp_ns: int, frame: str, metres: np.ndarray, encoding: str = "16UC1", padding: int = 0, big: bool = False
) -> Any:
    order = ">" if big else "<"
    pixels = metres.astype(order + "f4") if encoding == "32FC1" else np.round(metres * 1000).astype(order + "u2")
    rows = np.full((metres.shape[0], pixels.dtype.itemsize * metres.shape[1] + padding), 0xAB, np.uint8)
    rows[:, : rows.shape[1] - padding] = pixels.view(np.uint8).reshape(metres.shape[0], -1)
    h, w = metres.shape
    return T["sensor_msgs/msg/Image"](header(stamp_ns, frame), h, w, encoding, int(big), rows.shape[1], rows.ravel())


def ros_calibration(
    frame: str, k: np.ndarray = K, d: tuple[float, ...] = (), model: str = "plumb_bob", size: tuple[int, int] = (24, 32)
) -> Any:
    roi = T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    p = np.hstack([k, np.zeros((3, 1))]).ravel()
    return T["sensor_msgs/msg/CameraInfo"](
        header(START, frame), *size, model, np.array(d, float), k.ravel(), np.eye(3).ravel(), p, 0, 0, roi
    )


def ros_cloud(
    stamp_ns: int,
    frame: str,
    points: np.ndarray,
    kind: str = "f4",
    big: bool = False,
    point_padding: int = 0,
    row_padding: int = 0,
) -> Any:
    """points [point, 3] or [row, column, 3]; before x stands one foreign field of 4 bytes."""
    grid = points if points.ndim == 3 else points[None]
    h, w, _ = grid.shape
    size = int(kind[1])
    dtype = np.dtype(
        {
            "names": ["ring", "x", "y", "z"],
            "formats": ["<u2", *[(">" if big else "<") + kind] * 3],
            "offsets": [0, 4, 4 + size, 4 + 2 * size],
            "itemsize": 4 + 3 * size + point_padding,
        }
    )
    packed = np.full((h, w * dtype.itemsize + row_padding), 0xCD, np.uint8)
    view = np.ndarray((h, w), dtype, buffer=packed, strides=(packed.shape[1], dtype.itemsize))
    for i, axis in enumerate("xyz"):
        view[axis] = grid[..., i]
    field_type = T["sensor_msgs/msg/PointField"]
    fields: list[Any] = [field_type("ring", 0, 4, 1)]
    fields += [field_type(a, 4 + i * size, 7 if kind == "f4" else 8, 1) for i, a in enumerate("xyz")]
    return T["sensor_msgs/msg/PointCloud2"](
        header(stamp_ns, frame), h, w, fields, big, dtype.itemsize, packed.shape[1], packed.ravel(), False
    )


PACKED = "point_cloud_interfaces/msg/CompressedPointCloud2"
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n"
        "uint32 point_step\nuint32 row_step\nuint8[] compressed_data\nbool is_dense\nstring format",
        PACKED,
    )
)


def packed_cloud(cloud: Any, format: str, data: bytes) -> Any:
    """The cloud of ROS as point_cloud_transport sends it: all as it is but the bytes of its points."""
    head = cloud.header, cloud.height, cloud.width, cloud.fields, cloud.is_bigendian, cloud.point_step, cloud.row_step
    return T[PACKED](*head, np.frombuffer(data, np.uint8), cloud.is_dense, format)


def ros_tf(*items: tuple[int, str, str, tuple[float, ...], tuple[float, ...]]) -> Any:
    """(stamp, parent, child, translation, quaternion xyzw)."""
    g = "geometry_msgs/msg/"
    made: list[Any] = [
        T[g + "TransformStamped"](
            header(stamp, parent), child, T[g + "Transform"](T[g + "Vector3"](*xyz), T[g + "Quaternion"](*q))
        )
        for stamp, parent, child, xyz, q in items
    ]
    return T["tf2_msgs/msg/TFMessage"](made)


def foxglove_cloud(stamp_ns: int, frame: str, points: np.ndarray, pose: tuple | None = None, padding: int = 0) -> Any:
    m = PointCloud_pb2.PointCloud(frame_id=frame, point_stride=16 + padding)
    m.timestamp.FromNanoseconds(stamp_ns)
    kinds = PackedElementField_pb2.PackedElementField
    m.fields.add(name="i", offset=0, type=kinds.UINT32)
    for i, axis in enumerate("xyz"):
        m.fields.add(name=axis, offset=4 + 4 * i, type=kinds.FLOAT32)
    packed = np.full((len(points), 16 + padding), 0xEF, np.uint8)
    packed[:, 4:16] = points.astype("<f4", order="C").view(np.uint8).reshape(len(points), 12)
    m.data = packed.tobytes()
    if pose is not None:
        xyz, q = pose
        m.pose.position.x, m.pose.position.y, m.pose.position.z = xyz
        m.pose.orientation.x, m.pose.orientation.y, m.pose.orientation.z, m.pose.orientation.w = q
    return m


def with_field(cloud: Any, name: str, values: np.ndarray) -> Any:
    """The cloud of one row with one more field of one number per point, behind the others."""
    values = np.asarray(values)
    ros = hasattr(cloud, "header")
    data = cloud.data if ros else np.frombuffer(cloud.data, np.uint8)
    raw = np.hstack([data.reshape(len(values), -1), values[:, None].view(np.uint8)])
    code = values.dtype.kind + str(values.dtype.itemsize)
    if ros:
        kinds = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
        field_type = T["sensor_msgs/msg/PointField"]
        cloud.fields.append(field_type(name, cloud.point_step, kinds[code], 1))
        cloud.point_step, cloud.row_step, cloud.data = raw.shape[1], raw.size, raw.ravel()
    else:
        kinds = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "f4": 7, "f8": 8}
        cloud.fields.add(name=name, offset=cloud.point_stride, type=kinds[code])
        cloud.point_stride, cloud.data = raw.shape[1], raw.tobytes()
    return cloud


def foxglove_image(stamp_ns: int, frame: str, metres: np.ndarray, encoding: str = "16UC1") -> Any:
    image = ros_image(stamp_ns, frame, metres, encoding, padding=6)
    m = RawImage_pb2.RawImage(frame_id=frame, width=image.width, height=image.height, encoding=encoding)
    m.step, m.data = image.step, image.data.tobytes()
    m.timestamp.FromNanoseconds(stamp_ns)
    return m


def foxglove_calibration(frame: str) -> Any:
    p = np.hstack([K, np.zeros((3, 1))]).ravel()
    m = CameraCalibration_pb2.CameraCalibration(frame_id=frame, width=WIDTH, height=HEIGHT, K=K.ravel(), P=p)
    m.timestamp.FromNanoseconds(START)
    return m


def foxglove_tf(stamp_ns: int, parent: str, child: str, xyz: tuple, q: tuple) -> Any:
    m = FrameTransform_pb2.FrameTransform(parent_frame_id=parent, child_frame_id=child)
    m.timestamp.FromNanoseconds(stamp_ns)
    m.translation.x, m.translation.y, m.translation.z = xyz
    m.rotation.x, m.rotation.y, m.rotation.z, m.rotation.w = q
    return m


def foxglove_tfs(*transforms: Any) -> Any:
    return FrameTransforms_pb2.FrameTransforms(transforms=transforms)


_HYPOTHESIS = "MSG: vision_msgs/ObjectHypothesis\nstring class_id\nfloat64 score\n"
_PART = "=" * 80 + "\n"
DETECTION_TEXTS = {  # what differs between the releases of vision_msgs; 2 is that of ROS 2 Foxy
    2: "string id\nfloat64 score\n" + _PART + "MSG: vision_msgs/BoundingBox2D\ngeometry_msgs/Pose2D center\n",
    3: "vision_msgs/ObjectHypothesis hypothesis\n"
    + _PART
    + _HYPOTHESIS
    + _PART
    + "MSG: vision_msgs/BoundingBox2D\ngeometry_msgs/Pose2D center\n",
    4: "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    + _PART
    + _HYPOTHESIS
    + _PART
    + "MSG: vision_msgs/Point2D\nfloat64 x\nfloat64 y\n"
    + _PART
    + "MSG: vision_msgs/Pose2D\nvision_msgs/Point2D position\nfloat64 theta\n"
    + _PART
    + "MSG: vision_msgs/BoundingBox2D\nvision_msgs/Pose2D center\n",
}
DETECTIONS = "vision_msgs/msg/Detection2DArray"


def _vision(version: int) -> Any:
    store = get_typestore(Stores.ROS2_HUMBLE)
    text = (
        "std_msgs/Header header\nvision_msgs/Detection2D[] detections\n"
        + _PART
        + "MSG: vision_msgs/Detection2D\nstd_msgs/Header header\n"
        + "vision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox2D bbox\n"
        + _PART
        + "MSG: vision_msgs/ObjectHypothesisWithPose\n"
        + DETECTION_TEXTS[version]
        + "float64 size_x\nfloat64 size_y\n"
    )
    store.register(get_types_from_msg(text, DETECTIONS))
    return store


def detections(
    stamp_ns: int, frame: str, items: list[tuple[list[tuple[str, float]], float, float]], version: int = 4
) -> tuple[str, bytes, bytes]:
    """items: ([(name, score), ...], u, v). Gives type, message and definition."""
    store = _vision(version)
    t, v = store.types, "vision_msgs/msg/"
    g = "geometry_msgs/msg/"
    pose = t[g + "Pose"](t[g + "Point"](0.0, 0.0, 0.0), t[g + "Quaternion"](0.0, 0.0, 0.0, 1.0))
    pose = t[g + "PoseWithCovariance"](pose, np.zeros(36))
    made = []
    for names, x, y in items:
        results: list[Any] = []
        for name, score in names:
            hypothesis = (name, score) if version == 2 else (t[v + "ObjectHypothesis"](name, score),)
            results.append(t[v + "ObjectHypothesisWithPose"](*hypothesis, *([pose] if version == 4 else [])))
        if version == 4:
            center = t[v + "Pose2D"](t[v + "Point2D"](x, y), 0.0)
        else:
            center = t[g + "Pose2D"](x, y, 0.0)
        made.append(t[v + "Detection2D"](header(0, ""), results, t[v + "BoundingBox2D"](center, 8.0, 8.0)))
    message = t[DETECTIONS](header(stamp_ns, frame), made)
    text = store.generate_msgdef(DETECTIONS, ros_version=2)[0].encode()
    return DETECTIONS, bytes(store.serialize_cdr(message, DETECTIONS)), text


def ros_point(stamp_ns: int, frame: str, point: Any) -> Any:
    return T["geometry_msgs/msg/PointStamped"](
        header(stamp_ns, frame), T["geometry_msgs/msg/Point"](*map(float, point))
    )


def ros_pose(stamp_ns: int, frame: str, point: Any) -> Any:
    return T["geometry_msgs/msg/PoseStamped"](header(stamp_ns, frame), _pose(point))


def _pose(point: Any, q: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> Any:
    g = "geometry_msgs/msg/"
    return T[g + "Pose"](T[g + "Point"](*map(float, point)), T[g + "Quaternion"](*q))


def ros_marker(stamp_ns: int, frame: str, ns: str, point: Any, id: int = 0, **more: Any) -> Any:
    """more: type (2: sphere), action, text, points, alpha, q."""
    g, s = "geometry_msgs/msg/", "std_msgs/msg/"
    image = T["sensor_msgs/msg/CompressedImage"](header(0, ""), "", np.zeros(0, np.uint8))
    return T["visualization_msgs/msg/Marker"](
        header=header(stamp_ns, frame),
        ns=ns,
        id=id,
        type=more.get("type", 2),
        action=more.get("action", 0),
        pose=_pose(point, more.get("q", (0.0, 0.0, 0.0, 1.0))),
        scale=T[g + "Vector3"](0.01, 0.01, 0.01),
        color=T[s + "ColorRGBA"](1.0, 1.0, 1.0, more.get("alpha", 1.0)),
        lifetime=T["builtin_interfaces/msg/Duration"](0, 0),
        frame_locked=False,
        points=[T[g + "Point"](*map(float, p)) for p in more.get("points", [])],
        colors=[],
        texture_resource="",
        texture=image,
        uv_coordinates=[],
        text=more.get("text", ""),
        mesh_resource="",
        mesh_file=T["visualization_msgs/msg/MeshFile"]("", np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )


def ros_markers(*markers: Any) -> Any:
    return T["visualization_msgs/msg/MarkerArray"](list(markers))


def ros_laser(stamp_ns: int, frame: str, start: float, step: float, ranges: Any) -> Any:
    values = np.array(ranges, np.float32)
    end = start + step * (len(values) - 1)
    return T["sensor_msgs/msg/LaserScan"](
        header(stamp_ns, frame), start, end, step, 0.0, 0.0, 0.05, 10.0, values, np.zeros(0, np.float32)
    )


def foxglove_laser(stamp_ns: int, frame: str, start: float, end: float, ranges: Any, pose: tuple | None = None) -> Any:
    m = LaserScan_pb2.LaserScan(frame_id=frame, start_angle=start, end_angle=end, ranges=ranges)
    m.timestamp.FromNanoseconds(stamp_ns)
    if pose is not None:
        _fill_pose(m.pose, *pose)
    return m


def _fill_pose(pose: Any, point: Any, q: Any = (0.0, 0.0, 0.0, 1.0)) -> None:
    pose.position.x, pose.position.y, pose.position.z = map(float, point)
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = q


def annotations(stamp_ns: int, items: list[tuple[str, float, float]], kind: str = "circles") -> Any:
    """items: (text, u, v); kind: circles, points or boxes."""
    m = ImageAnnotations_pb2.ImageAnnotations()
    for text, u, v in items:
        if kind == "circles":
            mark = m.circles.add(diameter=5)
            mark.position.x, mark.position.y = u, v
        else:
            mark = m.points.add(type=1 if kind == "points" else 2)
            for du, dv in [(0, 0)] if kind == "points" else [(-3, -2), (3, -2), (3, 2), (-3, 2)]:
                mark.points.add(x=u + du, y=v + dv)
        mark.timestamp.FromNanoseconds(stamp_ns)
        label = m.texts.add(text=text)
        label.timestamp.FromNanoseconds(stamp_ns)
    return m


def scene(stamp_ns: int, frame: str, items: list[tuple[str, str, list]]) -> Any:
    """items: (entity id, "spheres" | "cubes" | "texts", points)."""
    m = SceneUpdate_pb2.SceneUpdate()
    for name, kind, points in items:
        entity = m.entities.add(id=name, frame_id=frame)
        entity.timestamp.FromNanoseconds(stamp_ns)
        for point in points:
            shape = getattr(entity, kind).add()
            _fill_pose(shape.pose, point)
            shape.color.a = 1.0
    return m


def poses_in_frame(stamp_ns: int, frame: str, points: Any) -> Any:
    m = PosesInFrame_pb2.PosesInFrame(frame_id=frame)
    m.timestamp.FromNanoseconds(stamp_ns)
    for point in points:
        _fill_pose(m.poses.add(), point)
    return m


@dataclass
class Log:
    """Collects (topic, log_time, message) and writes them. A message is a ROS or protobuf object, or
    (type name, raw bytes) for broken ones."""

    items: list[tuple[str, int, Any]] = field(default_factory=list)
    schema_text: dict[str, bytes] = field(default_factory=dict)  # to give a type another definition
    schema_encoding: str = "ros2msg"
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)

    def add(self, topic: str, log_time: int, message: Any) -> "Log":
        self.items.append((topic, log_time, message))
        return self

    def write(
        self,
        path: Path,
        compression: CompressionType = CompressionType.ZSTD,
        chunk_size: int = 1024 * 1024,
        finish: bool = True,
        **options: Any,
    ) -> Path:
        with open(path, "wb") as stream:
            writer = Writer(stream, compression=compression, chunk_size=chunk_size, **options)
            writer.start("", "voodoo_jax tests")
            channels: dict[tuple[str, str], int] = {}
            schemas: dict[str, int] = {}
            for i, (topic, log_time, message) in enumerate(self.items):
                name, encoding, data = serialise(message)
                if name not in schemas:
                    text = self.schema_text.get(name) or definition(name, encoding, message)
                    kind = self.schema_encoding if encoding == "cdr" else "protobuf"
                    schemas[name] = writer.register_schema(name, kind, text)
                key = topic, name
                if key not in channels:
                    more = self.metadata.get(topic, {})
                    channels[key] = writer.register_channel(topic, encoding, schemas[name], metadata=more)
                writer.add_message(channels[key], log_time, data, log_time, i)
            if finish:
                writer.finish()
        return path


def serialise(message: Any) -> tuple[str, str, bytes]:
    if isinstance(message, tuple):
        return message[0], "protobuf" if message[0].startswith("foxglove.") else "cdr", message[1]
    if isinstance(message, ProtobufMessage):
        return message.DESCRIPTOR.full_name, "protobuf", message.SerializeToString()
    return message.__msgtype__, "cdr", bytes(STORE.serialize_cdr(message, message.__msgtype__))


def definition(name: str, encoding: str, message: Any) -> bytes:
    if encoding == "cdr":
        return STORE.generate_msgdef(name, ros_version=2)[0].encode()
    kind = RawImage_pb2.RawImage if isinstance(message, tuple) else type(message)
    return build_file_descriptor_set(kind).SerializeToString()


def depth_log(n: int = 40) -> Log:
    """A depth camera over a fixed base: calibration and transform once, n depth images, log time = stamp."""
    log = Log()
    log.add("/tf_static", START, ros_tf((START, "base", "cam_optical", (0.0, 0.0, 1.25), (-0.5, 0.5, -0.5, 0.5))))
    log.add("/cam/camera_info", START, ros_calibration("cam_optical"))
    for i in range(n):
        stamp = START + i * PERIOD
        log.add("/cam/depth", stamp, ros_image(stamp, "cam_optical", depth_metres(i)))
    return log


def in_base(points: np.ndarray) -> np.ndarray:
    """Points of `depth_log`'s camera in its base frame: x forward, y left, z up, 1.25 m high."""
    x, y, z = points.T
    return np.column_stack([z, -x, -y + 1.25])


def chunks(data: bytes) -> list[tuple[int, int]]:
    """(offset of the content, length) of each chunk record."""
    found, at = [], 8
    while at + 9 <= len(data) - 8:
        opcode, length = data[at], struct.unpack_from("<Q", data, at + 1)[0]
        if opcode == 6:
            found.append((at + 9, length))
        at += 9 + length
    return found
