"""Clouds that were packed for the network: zlib, gzip, zstd and Draco."""

import gzip
import sys
import zlib
from typing import Any

import numpy as np
import pytest
import zstandard
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.timestamp_pb2 import Timestamp

from tests.support.logs import PERIOD, START, Log, packed_cloud, ros_cloud
from voodoo_jax.io.decode.packed_cloud import places
from voodoo_jax.io.log_reader import LogError, read_log

POINTS = np.random.default_rng(0).uniform([1, -1, 0.5], [3, 1, 3], (40, 50, 3))
PACKERS = {"zlib": (zlib.compress, gzip.compress), "zstd": (zstandard.compress,)}


def log_of(path, messages):
    log = Log()
    for i, message in enumerate(messages):
        log.add("/points/packed", START + i * PERIOD, message)
    return log.write(path)


def cloud_at(i: int, **more):
    return ros_cloud(START + i * PERIOD, "lidar", POINTS + 0.01 * i, **more)


@pytest.mark.parametrize("format, pack", [(how, pack) for how, some in PACKERS.items() for pack in some])
def test_what_was_packed_without_loss_is_as_it_was(tmp_path, format, pack):
    clouds = [cloud_at(i, kind="f8", big=True, point_padding=3, row_padding=5) for i in range(3)]
    packed = [packed_cloud(cloud, format, pack(bytes(cloud.data))) for cloud in clouds]
    recording = read_log(log_of(tmp_path / "a.mcap", packed))
    expected = read_log(log_of(tmp_path / "b.mcap", clouds))
    assert len(recording) == 3 and recording.notes == expected.notes
    for a, b in zip(recording, expected, strict=True):
        np.testing.assert_array_equal(a.points, b.points)


@pytest.mark.parametrize("format", ["zlib", "zstd"])
def test_what_is_cut_off_or_no_packed_cloud_is_left_out(tmp_path, format):
    cloud, pack = cloud_at(1), PACKERS[format][0]
    whole = pack(bytes(cloud.data))
    wrong = [whole[: len(whole) // 2], b"nothing of the kind", pack(bytes(cloud.data)[: len(cloud.data) // 2])]
    messages = [packed_cloud(cloud_at(0), format, pack(bytes(cloud_at(0).data)))]
    messages += [packed_cloud(cloud_at(i + 1), format, data) for i, data in enumerate(wrong)]
    recording = read_log(log_of(tmp_path / "a.mcap", messages))
    assert len(recording) == 1 and "3 messages" in " ".join(recording.notes)


def test_more_than_a_log_may_ask_for_is_not_unpacked(tmp_path):
    cloud = cloud_at(0)
    cloud.height, cloud.row_step = 4_000_000, 2_000_000_000
    bomb = zlib.compress(bytes(50_000_000))
    with pytest.raises(LogError, match="chunk_bytes"):
        read_log(log_of(tmp_path / "a.mcap", [packed_cloud(cloud, "zlib", bomb)]))


def test_other_ways_of_packing_are_named(tmp_path):
    cloud = cloud_at(0)
    with pytest.raises(LogError, match="cloudini_rosbag_converter"):
        read_log(log_of(tmp_path / "a.mcap", [packed_cloud(cloud, "cloudini", b"CLOUDINI_V03")]))


@pytest.mark.parametrize("options", [{}, {"compression_level": 10}, {"create_metadata": True}])
def test_draco(tmp_path, options):
    DracoPy = pytest.importorskip("DracoPy")
    flat = [(POINTS + 0.01 * i).reshape(-1, 3).astype(np.float32) for i in range(2)]
    more = {"intensity": np.ones((len(flat[0]), 1), np.float32)} if options.get("create_metadata") else None
    data = [DracoPy.encode(p, quantization_bits=16, generic_attributes=more, **options) for p in flat]
    recording = read_log(
        log_of(tmp_path / "a.mcap", [packed_cloud(cloud_at(i), "draco", d) for i, d in enumerate(data)])
    )
    for frame, points in zip(recording, flat, strict=True):  # Draco changes the order, and rounds to some 0.05 mm
        assert len(frame.points) == len(points)
        order = lambda p: p[np.lexsort(np.round(p, 3).T)]  # noqa: E731
        np.testing.assert_allclose(order(frame.points).mean(0), order(points).mean(0), atol=1e-4)
        np.testing.assert_allclose(np.sort(frame.points, 0), np.sort(points, 0), atol=1e-4)


def test_without_its_package_draco_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(LogError, match=r"voodoo_jax\[draco\]"):
        read_log(log_of(tmp_path / "a.mcap", [packed_cloud(cloud_at(0), "draco", b"DRACO")]))


def compressed_point_cloud() -> Any:
    """The class foxglove.CompressedPointCloud by its published fields: the package of schemas has it from 0.4 on."""
    file = FileDescriptorProto(name="tests/CompressedPointCloud.proto", package="foxglove", syntax="proto3")
    file.dependency.extend([Timestamp.DESCRIPTOR.file.name, Pose.DESCRIPTOR.file.name])
    message = file.message_type.add(name="CompressedPointCloud")
    text = FieldDescriptorProto.TYPE_STRING
    fields = {
        "timestamp": Timestamp,
        "frame_id": text,
        "pose": Pose,
        "data": FieldDescriptorProto.TYPE_BYTES,
        "format": text,
    }
    for number, (name, kind) in enumerate(fields.items(), 1):
        told = {"type": kind} if isinstance(kind, int) else {"type_name": f".{kind.DESCRIPTOR.full_name}"}
        message.field.add(name=name, number=number, label=FieldDescriptorProto.LABEL_OPTIONAL, **told)
    pool = descriptor_pool.Default()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("foxglove.CompressedPointCloud"))


def test_draco_of_foxglove_has_a_pose(tmp_path):
    DracoPy = pytest.importorskip("DracoPy")
    points = POINTS.reshape(-1, 3).astype(np.float32)
    message = compressed_point_cloud()(frame_id="lidar", data=DracoPy.encode(points), format="draco")
    message.timestamp.FromNanoseconds(START)
    message.pose.position.z = 5.0
    message.pose.orientation.w = 1.0
    (frame,) = read_log(log_of(tmp_path / "a.mcap", [message]))
    np.testing.assert_allclose(frame.points.mean(0), points.mean(0) + [0, 0, 5], atol=1e-3)


def test_damaged_draco_is_left_out_and_asks_for_little(tmp_path):
    DracoPy = pytest.importorskip("DracoPy")
    good = DracoPy.encode(POINTS.reshape(-1, 3).astype(np.float32))
    # says that it has a thousand million points, or ten million in so few bytes; is cut off; is a mesh
    counts = [good[:11] + count.to_bytes(4, "little") + good[15:] for count in (1_000_000_000, 10_000_000)]
    # the same behind what is written about many attributes: none of it is to be skipped
    many = good[:9] + b"\0\x80" + b"\x80\x80\x01" + b"\0\0\0" * 2**14 + b"\0\0" + counts[0][11:]
    wrong = [*counts, many, good[:40], good[:7] + b"\1" + good[8:], b"DRACO", good[:9] + b"\0\x80" + bytes([255] * 20)]
    messages = [packed_cloud(cloud_at(i), "draco", data) for i, data in enumerate([good, *wrong])]
    recording = read_log(log_of(tmp_path / "a.mcap", messages))
    assert len(recording) == 1 and f"{len(wrong)} messages" in " ".join(recording.notes)


def test_each_axis_may_be_an_attribute_of_its_own():
    """As point_cloud_transport packs the fields of a cloud: one number each, in the order of the fields."""
    column = lambda k, kind: {  # noqa: E731
        "unique_id": k, "attribute_type": kind, "data": np.full((4, 1), k, np.float32)
    }  # fmt: skip
    attributes = [column(1, 0), column(0, 4), column(3, 0), column(2, 0)]
    names = ("ring", "z", "y", "x")
    np.testing.assert_array_equal(places(attributes, names), np.tile([3, 2, 1], (4, 1)))
    with pytest.raises(ValueError, match="no positions"):
        places(attributes[1:2], ("ring",))
