"""The same messages written in another way: ROS 1, JSON, and types of drivers that are told by their fields."""

import base64
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.json_format import MessageToDict
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.support.logs import (
    PERIOD,
    START,
    depth_log,
    depth_metres,
    foxglove_calibration,
    foxglove_image,
    foxglove_tf,
    ros_calibration,
    ros_image,
)
from voodoo_jax.io.log_reader import read_log, survey

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))


def write(path: Path, items: list[tuple[str, int, str, str, bytes, str, bytes]]) -> Path:
    """(topic, log time, type, schema encoding, schema, encoding, data)"""
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start("", "test")
        known: dict[Any, int] = {}
        for topic, at, name, how, text, encoding, data in items:
            if topic not in known:
                known[topic] = writer.register_channel(topic, encoding, writer.register_schema(name, how, text))
            writer.add_message(known[topic], at, data, at)
        writer.finish()
    return path


def as_ros1(message: Any, kind: str = "") -> Any:
    """A message of ROS 2 as one of ROS 1."""
    kind = kind or message.__msgtype__
    if kind == "std_msgs/msg/Header":
        time = ROS1.types["builtin_interfaces/msg/Time"](message.stamp.sec, message.stamp.nanosec)
        return ROS1.types[kind](0, time, message.frame_id)
    values = {}
    for field, (node, sub) in ROS1.fielddefs[kind][1]:
        value = getattr(message, field, None) if hasattr(message, field) else getattr(message, field.lower())
        if node.name == "NAME":
            value = as_ros1(value, str(sub))
        elif node.name in ("ARRAY", "SEQUENCE") and sub[0][0].name == "NAME":
            value = [as_ros1(item) for item in value]
        values[field] = value
    return ROS1.types[kind](**values)


def test_ros1_messages_in_mcap(tmp_path):
    ros2 = depth_log(3)
    items = []
    for topic, at, message in ros2.items:
        name = message.__msgtype__
        data = bytes(ROS1.serialize_ros1(as_ros1(message), name))
        text = ROS1.generate_msgdef(name)[0].encode()
        items.append((topic, at, name.replace("/msg/", "/"), "ros1msg", text, "ros1", data))
    one = read_log(write(tmp_path / "a.mcap", items))
    other = read_log(ros2.write(tmp_path / "b.mcap"))
    assert one.fixed_frame == other.fixed_frame == "base" and one.notes == ()
    for a, b in zip(one, other, strict=True):
        assert a.time_ns == b.time_ns
        np.testing.assert_array_equal(a.points, b.points)


def foxglove_json(message: Any) -> bytes:
    """As Foxglove writes it: bytes in base64, times as seconds and nanoseconds."""
    found = MessageToDict(message, preserving_proto_field_name=True)
    stamp = message.timestamp
    found["timestamp"] = {"sec": stamp.seconds, "nsec": stamp.nanos}
    if "data" in found:
        assert base64.b64decode(found["data"]) == message.data
    return json.dumps(found).encode()


def test_foxglove_messages_in_json(tmp_path):
    items = []
    tf = foxglove_tf(START, "base", "cam", (0, 0, 1.25), (-0.5, 0.5, -0.5, 0.5))
    images = [(f"/d{i}", foxglove_image(START + i * PERIOD, "cam", depth_metres(i))) for i in range(2)]
    for topic, message in [("/tf", tf), ("/info", foxglove_calibration("cam")), *(("/d", m) for _, m in images)]:
        name = message.DESCRIPTOR.full_name
        items.append(
            (topic, message.timestamp.ToNanoseconds(), name, "jsonschema", b"{}", "json", foxglove_json(message))
        )
    recording = read_log(write(tmp_path / "a.mcap", items))
    expected = read_log(depth_log(2).write(tmp_path / "b.mcap"))
    for a, b in zip(recording, expected, strict=True):
        assert a.time_ns == b.time_ns
        np.testing.assert_allclose(a.points, b.points, atol=1e-6)


PART = "\n" + "=" * 80 + "\nMSG: "
TIME = PART + "builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
HEADER = PART + "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id" + TIME
HUMBLE = get_typestore(Stores.ROS2_HUMBLE)


def driver_log(path: Path, name: str, text: str, make: Callable[[dict, Any, int], Any], count: int = 2) -> Path:
    """A log of messages of a type that nobody knows."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = get_types_from_msg(text, name)
    store.register({k: v for k, v in types.items() if k not in store.types})
    items = []
    for i in range(count):
        at = START + i * PERIOD
        header = store.types["std_msgs/msg/Header"](
            store.types["builtin_interfaces/msg/Time"](at // 10**9, at % 10**9), "sensor"
        )
        data = bytes(store.serialize_cdr(make(store.types, header, i), name))
        items.append(("/driver", at, name, "ros2msg", text.encode(), "cdr", data))
    return write(path, items)


def test_a_cloud_of_points_with_names_of_a_driver(tmp_path):
    text = (
        "std_msgs/Header header\nuint64 base\nuint8[3] spare\nmaker_msgs/Shot[] shots" + HEADER + PART
        + "maker_msgs/Shot\nuint32 delay\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 line"
    )  # fmt: skip
    points = np.random.default_rng(1).uniform(1, 2, (80, 3)).astype(np.float32)
    shot = "maker_msgs/msg/Shot"
    make = lambda t, header, i: t["maker_msgs/msg/Cloud"](  # noqa: E731
        header, 7, np.zeros(3, np.uint8), [t[shot](k, *map(float, p), 1) for k, p in enumerate(points + i)]
    )
    recording = read_log(driver_log(tmp_path / "a.mcap", "maker_msgs/msg/Cloud", text, make))
    for i, frame in enumerate(recording):
        np.testing.assert_allclose(frame.points, points + i, atol=1e-6)
        assert frame.time_ns == START + i * PERIOD


def test_markers_with_names_and_subjects(tmp_path):
    text = (
        "std_msgs/Header header\nmocap_msgs/Marker[] markers" + HEADER + PART
        + "mocap_msgs/Marker\nstring marker_name\nstring subject_name\ngeometry_msgs/Point translation\nbool occluded"
        + PART + "geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z"
    )  # fmt: skip
    marker, point = "mocap_msgs/msg/Marker", "geometry_msgs/msg/Point"
    make = lambda t, header, i: t["mocap_msgs/msg/Markers"](  # noqa: E731
        header,
        [t[marker]("LASI", "Anna", t[point](1.0, 2.0, 3.0), False),
         t[marker]("RASI", "Anna", t[point](9.0, 9.0, 9.0), True),
         t[marker]("C7", "", t[point](1.0, 2.0, 3.0 + i), False)],
    )  # fmt: skip
    recording = read_log(driver_log(tmp_path / "a.mcap", "mocap_msgs/msg/Markers", text, make))
    assert recording.frames[1].pairs.names == ("Anna:LASI", "C7")
    np.testing.assert_allclose(recording.frames[1].pairs.points, [[1, 2, 3], [1, 2, 4]])


def nested(name: str) -> str:
    return PART + name.replace("/msg/", "/") + "\n" + HUMBLE.generate_msgdef(name, ros_version=2)[0].split("=" * 80)[0]


def test_depth_and_calibration_in_one_message(tmp_path):
    image, camera, region = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/RegionOfInterest"
    text = (
        "std_msgs/Header header\nsensor_msgs/CameraInfo depth_camera_info\nsensor_msgs/Image rgb\n"
        + "sensor_msgs/Image depth" + HEADER + nested(image) + nested(camera) + nested(region)
    )  # fmt: skip
    make = lambda t, header, i: t["maker_msgs/msg/RGBD"](  # noqa: E731
        header, ros_calibration("sensor"), ros_image(START, "rgb", depth_metres(9), "32FC1"),
        ros_image(START + i * PERIOD, "sensor", depth_metres(i)),
    )  # fmt: skip
    recording = read_log(driver_log(tmp_path / "a.mcap", "maker_msgs/msg/RGBD", text, make))
    log = depth_log(2)
    log.items = log.items[1:]
    expected = read_log(log.write(tmp_path / "b.mcap"))
    for a, b in zip(recording, expected, strict=True):
        np.testing.assert_array_equal(a.points, b.points)


def test_other_messages_with_points_are_no_clouds(tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    text = store.generate_msgdef("geometry_msgs/msg/PolygonStamped", ros_version=2)[0]
    make = lambda t, header, i: t["geometry_msgs/msg/PolygonStamped"](  # noqa: E731
        header, t["geometry_msgs/msg/Polygon"]([t["geometry_msgs/msg/Point32"](1.0, 2.0, 3.0)])
    )
    log = driver_log(tmp_path / "a.mcap", "geometry_msgs/msg/PolygonStamped", text, make)
    assert survey(log).topics[0].use.startswith("not used")
