"""Writes a simulated recording: MCAP with ROS 2 or Foxglove messages, and the truth beside it."""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from voodoo_jax.model.body import segment_lengths
from voodoo_jax.simulate.recording import Simulation
from voodoo_jax.simulate.sensor import Camera
from voodoo_jax.storage.atomic import replacing

OPTICAL_FRAME = "depth_optical"
IMAGE_TOPIC, INFO_TOPIC = "/depth/image", "/depth/camera_info"
CHUNK_SIZE = 1 << 20


def write_simulation(simulation: Simulation, path: str | os.PathLike[str], format: str = "ros2") -> Path:
    """Writes `path` (MCAP) and `<stem>.truth.npz` beside it; equal simulations give equal bytes. Returns `path`.

    ros2: sensor_msgs/Image 16UC1 and CameraInfo, transform on /tf_static; foxglove: RawImage, CameraCalibration,
    FrameTransform on /tf. Depth in millimetres. Truth: time_ns [frame], joints [frame, centre, 3] metres, names, dims
    (JSON, metres). Files appear under their names only when complete. Raises OSError, ValueError for another format.
    """
    if format not in ("ros2", "foxglove"):
        raise ValueError(f"format is 'ros2' or 'foxglove', not '{format}'")
    path = Path(path)
    fill = _ros2 if format == "ros2" else _foxglove
    _replace(path, lambda stream: fill(simulation, stream))
    _replace(path.with_name(f"{path.stem}.truth.npz"), lambda stream: _save_truth(simulation, stream))
    return path


def _save_truth(simulation: Simulation, stream: BinaryIO) -> None:
    body, s = simulation.body, simulation
    dims = segment_lengths(body) | ({"stature": float(body.scale)} if body.scale_name == "stature" else {})
    save_truth(stream, s.time_ns, s.joints, body.topology.centres, dims)


def save_truth(
    stream: BinaryIO, time_ns: np.ndarray, joints: np.ndarray, names: Sequence[str], dims: dict[str, float]
) -> None:
    """Truth as write_simulation has it."""
    np.savez_compressed(stream, time_ns=time_ns, joints=joints, names=np.array(names), dims=np.array(json.dumps(dims)))


def _replace(path: Path, fill: Callable[[BinaryIO], None]) -> None:
    with replacing(path) as partial, open(partial, "wb") as stream:
        fill(stream)


def _matrices(camera: Camera) -> tuple[list[float], list[float], list[float]]:
    """Row-major k, r, p of a calibration."""
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    p = [camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return k, np.eye(3).ravel().tolist(), p


def _ros2(simulation: Simulation, stream: BinaryIO) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer(stream, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="voodoo_jax")
    channels: dict[str, int] = {}

    def put(topic: str, stamp: int, message: Any) -> None:
        name = message.__msgtype__
        if topic not in channels:
            text, _ = store.generate_msgdef(name, ros_version=2)
            schema = writer.register_schema(name, "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        writer.add_message(channels[topic], stamp, bytes(store.serialize_cdr(message, name)), stamp)

    t, camera = store.types, simulation.camera

    def header(stamp: int, frame: str) -> Any:
        time = t["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        return t["std_msgs/msg/Header"](stamp=time, frame_id=frame)

    if len(simulation.time_ns):
        start = int(simulation.time_ns[0])
        x, y, z, w = Rotation.from_matrix(camera.rotation).as_quat().tolist()
        px, py, pz = camera.position
        transform = t["geometry_msgs/msg/Transform"](
            translation=t["geometry_msgs/msg/Vector3"](x=px, y=py, z=pz),
            rotation=t["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        )
        stamped = t["geometry_msgs/msg/TransformStamped"](
            header=header(start, simulation.fixed_frame), child_frame_id=OPTICAL_FRAME, transform=transform
        )
        put("/tf_static", start, t["tf2_msgs/msg/TFMessage"](transforms=[stamped]))
        k, r, p = (np.array(m) for m in _matrices(camera))
        put(INFO_TOPIC, start, t["sensor_msgs/msg/CameraInfo"](
            header=header(start, OPTICAL_FRAME), height=camera.height, width=camera.width,
            distortion_model="plumb_bob", d=np.zeros(5), k=k, r=r, p=p, binning_x=0, binning_y=0,
            roi=t["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
        ))  # fmt: skip
    for stamp, image in zip(simulation.time_ns.tolist(), simulation.depth):
        put(IMAGE_TOPIC, stamp, t["sensor_msgs/msg/Image"](
            header=header(stamp, OPTICAL_FRAME), height=camera.height, width=camera.width, encoding="16UC1",
            is_bigendian=0, step=2 * camera.width, data=image.astype("<u2").reshape(-1).view(np.uint8),
        ))  # fmt: skip
    writer.finish()


def _foxglove(simulation: Simulation, stream: BinaryIO) -> None:
    camera = simulation.camera
    with foxglove_log(stream) as put:
        if len(simulation.time_ns):
            start = int(simulation.time_ns[0])
            put_camera(put, start, camera, simulation.fixed_frame, OPTICAL_FRAME, INFO_TOPIC)
        for stamp, image in zip(simulation.time_ns.tolist(), simulation.depth):
            put(IMAGE_TOPIC, stamp, depth_image(camera, OPTICAL_FRAME, image))


Put = Callable[[str, int, Any], None]  # topic, stamp, message


@contextmanager
def foxglove_log(stream: BinaryIO) -> Iterator[Put]:
    """What writes a message of foxglove's, stamped where it has a stamp, into a log that is finished at the end."""
    writer = Writer(stream, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
    writer.start(profile="", library="voodoo_jax")
    channels: dict[str, int] = {}

    def put(topic: str, stamp: int, message: Any) -> None:
        if "timestamp" in message.DESCRIPTOR.fields_by_name:
            message.timestamp.FromNanoseconds(stamp)
        if topic not in channels:
            descriptors = build_file_descriptor_set(type(message)).SerializeToString(deterministic=True)
            schema = writer.register_schema(message.DESCRIPTOR.full_name, "protobuf", descriptors)
            channels[topic] = writer.register_channel(topic, "protobuf", schema)
        writer.add_message(channels[topic], stamp, message.SerializeToString(deterministic=True), stamp)

    yield put
    writer.finish()


def put_camera(put: Put, stamp: int, camera: Camera, fixed_frame: str, frame: str, topic: str) -> None:
    """A camera's place, on /tf, and its calibration."""
    transform = FrameTransform(parent_frame_id=fixed_frame, child_frame_id=frame)
    part = transform.translation
    part.x, part.y, part.z = camera.position
    turn = transform.rotation
    turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(camera.rotation).as_quat().tolist()
    put("/tf", stamp, transform)
    k, r, p = _matrices(camera)
    put(topic, stamp, CameraCalibration(
        frame_id=frame, width=camera.width, height=camera.height, distortion_model="plumb_bob", D=[0.0] * 5, K=k, R=r,
        P=p,
    ))  # fmt: skip


def depth_image(camera: Camera, frame: str, image: np.ndarray) -> RawImage:
    """An image in millimetres."""
    return RawImage(
        frame_id=frame, width=camera.width, height=camera.height, encoding="16UC1", step=2 * camera.width,
        data=image.astype("<u2").tobytes(),
    )  # fmt: skip
