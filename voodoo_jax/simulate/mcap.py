"""Writes a simulated recording: MCAP with ROS 2 or Foxglove messages, and the truth beside it."""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from voodoo_jax.model.body import segment_lengths
from voodoo_jax.simulate.colour import ColourSimulation
from voodoo_jax.simulate.recording import Simulation
from voodoo_jax.simulate.sensor import Camera
from voodoo_jax.storage.atomic import replacing

OPTICAL_FRAME = "depth_optical"
IMAGE_TOPIC, INFO_TOPIC = "/depth/image", "/depth/camera_info"
CHUNK_SIZE = 1 << 20
JPEG = 90  # quality


def write_simulation(simulation: Simulation, path: str | os.PathLike[str], format: str = "ros2") -> Path:
    """Writes `path` (MCAP) and `<stem>.truth.npz` beside it; equal simulations give equal bytes. Returns `path`.

    ros2: sensor_msgs/Image 16UC1 and CameraInfo, transform on /tf_static; foxglove: RawImage, CameraCalibration,
    FrameTransform on /tf. Depth in millimetres. Truth: time_ns [frame], joints [frame, centre, 3] metres, names, dims
    (JSON, metres). Files appear under their names only when complete. Raises OSError, ValueError for another format.
    """
    return _write(simulation, path, format, {"ros2": _ros2, "foxglove": _foxglove})


def write_colour(
    simulation: ColourSimulation,
    path: str | os.PathLike[str],
    format: str = "ros2",
    beside: Sequence[ColourSimulation] = (),
) -> Path:
    """As `write_simulation`, with JPEG images: of a pair on /stereo/left/image/compressed and /stereo/right/..., of one
    camera on /colour/image/compressed; camera_info beside each, depth as there.

    **Arguments:** `beside` the same motion as further cameras see it; their topics begin with /camera2, /camera3, ...
    """
    all_of_them = (simulation, *beside)

    def filled(fill: Callable[..., None]) -> Callable[..., None]:
        return lambda _, stream: fill(all_of_them, stream)

    return _write(simulation, path, format, {"ros2": filled(_ros2_colour), "foxglove": filled(_foxglove_colour)})


def _write(simulation: Any, path: str | os.PathLike[str], format: str, fills: dict[str, Callable[..., None]]) -> Path:
    """The log, by that of the functions that writes the format, and the truth beside it."""
    if format not in fills:
        raise ValueError(f"format is 'ros2' or 'foxglove', not '{format}'")
    path, fill = Path(path), fills[format]
    _replace(path, lambda stream: fill(simulation, stream))
    _replace(path.with_name(f"{path.stem}.truth.npz"), lambda stream: _save_truth(simulation, stream))
    return path


def _rig(number: int) -> str:
    """How topics of one of several simulations begin."""
    return f"/camera{number + 1}" if number else ""


def _eyes(s: ColourSimulation, number: int) -> list[tuple[str, str, Camera, float, np.ndarray]]:
    """Of each colour camera how its topics begin, its frame, itself, its distance to the left one, its images."""
    names = ["/colour"] if len(s.cameras) == 1 else ["/stereo/left", "/stereo/right"]
    names = [_rig(number) + name for name in names]
    first = np.array(s.cameras[0].position)
    return [
        (name, name[1:].replace("/", "_") + "_optical", camera, float(np.linalg.norm(camera.position - first)), images)
        for name, camera, images in zip(names, s.cameras, s.images)
    ]


def _depth_frame(number: int) -> str:
    return f"{_rig(number)[1:]}_{OPTICAL_FRAME}".lstrip("_")


def _jpeg(image: np.ndarray) -> bytes:
    import cv2  # only here: logs of depth are written without

    return np.asarray(cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG])[1]).tobytes()


def _ros2_colour(simulations: Sequence[ColourSimulation], stream: BinaryIO) -> None:
    times = simulations[0].time_ns.tolist()
    start, eyes = times[0] if times else 0, [_eyes(s, number) for number, s in enumerate(simulations)]
    with _ros2_log(stream) as put:
        places = [(camera, frame) for rig in eyes for _, frame, camera, _, _ in rig]
        for number, s in enumerate(simulations):
            if s.depth_camera is not None:
                places.append((s.depth_camera, _depth_frame(number)))
                _ros2_info(put, start, s.depth_camera, _depth_frame(number), _rig(number) + INFO_TOPIC)
        _ros2_place(put, start, places, simulations[0].fixed_frame)
        for rig in eyes:
            for name, frame, camera, baseline, _ in rig:
                _ros2_info(put, start, camera, frame, f"{name}/camera_info", baseline)
        for i, stamp in enumerate(times):
            for number, (s, rig) in enumerate(zip(simulations, eyes)):
                for name, frame, _, _, images in rig:
                    data = np.frombuffer(_jpeg(images[i]), np.uint8)
                    fields = {"header": _header(stamp, frame), "format": "jpeg", "data": data}
                    put(f"{name}/image/compressed", stamp, "sensor_msgs/msg/CompressedImage", fields)
                if s.depth_camera is not None:
                    frame, topic = _depth_frame(number), _rig(number) + IMAGE_TOPIC
                    _ros2_depth(put, stamp, s.depth_camera, s.depth[i], frame, topic)


def _foxglove_colour(simulations: Sequence[ColourSimulation], stream: BinaryIO) -> None:
    times, fixed = simulations[0].time_ns.tolist(), simulations[0].fixed_frame
    start, eyes = times[0] if times else 0, [_eyes(s, number) for number, s in enumerate(simulations)]
    with foxglove_log(stream) as put:
        for number, (s, rig) in enumerate(zip(simulations, eyes)):
            if s.depth_camera is not None:
                put_camera(put, start, s.depth_camera, fixed, _depth_frame(number), _rig(number) + INFO_TOPIC)
            for name, frame, camera, baseline, _ in rig:
                put_camera(put, start, camera, fixed, frame, f"{name}/camera_info", baseline)
        for i, stamp in enumerate(times):
            for number, (s, rig) in enumerate(zip(simulations, eyes)):
                for name, frame, _, _, images in rig:
                    message = CompressedImage(frame_id=frame, format="jpeg", data=_jpeg(images[i]))
                    put(f"{name}/image/compressed", stamp, message)
                if s.depth_camera is not None:
                    image = depth_image(s.depth_camera, _depth_frame(number), s.depth[i])
                    put(_rig(number) + IMAGE_TOPIC, stamp, image)


def _save_truth(simulation: Simulation | ColourSimulation, stream: BinaryIO) -> None:
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


def _matrices(camera: Camera, baseline: float = 0.0) -> tuple[list[float], list[float], list[float]]:
    """Row-major k, r, p of a calibration; `baseline` metres to the left camera of its pair."""
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    p = [camera.fx, 0.0, camera.cx, 0.0 - camera.fx * baseline, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return k, np.eye(3).ravel().tolist(), p


def _ros2(simulation: Simulation, stream: BinaryIO) -> None:
    with _ros2_log(stream) as put:
        if len(simulation.time_ns):
            start = int(simulation.time_ns[0])
            _ros2_place(put, start, [(simulation.camera, OPTICAL_FRAME)], simulation.fixed_frame)
            _ros2_info(put, start, simulation.camera, OPTICAL_FRAME, INFO_TOPIC)
        for stamp, image in zip(simulation.time_ns.tolist(), simulation.depth):
            _ros2_depth(put, stamp, simulation.camera, image)


Ros2Put = Callable[[str, int, str, dict[str, Any]], None]  # topic, stamp, type, its fields


@contextmanager
def _ros2_log(stream: BinaryIO) -> Iterator[Ros2Put]:
    """What writes a message of ROS 2 into a log that is finished at the end; messages in fields are (type, fields)."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer(stream, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="voodoo_jax")
    channels: dict[str, int] = {}

    def made(value: Any) -> Any:
        if isinstance(value, tuple):
            name, fields = value
            return store.types[name](**{key: made(field) for key, field in fields.items()})
        return [made(each) for each in value] if isinstance(value, list) else value

    def put(topic: str, stamp: int, name: str, fields: dict[str, Any]) -> None:
        if topic not in channels:
            text, _ = store.generate_msgdef(name, ros_version=2)
            schema = writer.register_schema(name, "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        data = bytes(store.serialize_cdr(made((name, fields)), name))
        writer.add_message(channels[topic], stamp, data, stamp)

    yield put
    writer.finish()


def _header(stamp: int, frame: str) -> tuple[str, dict[str, Any]]:
    time = "builtin_interfaces/msg/Time", {"sec": stamp // 10**9, "nanosec": stamp % 10**9}
    return "std_msgs/msg/Header", {"stamp": time, "frame_id": frame}


def _ros2_place(put: Ros2Put, stamp: int, cameras: Sequence[tuple[Camera, str]], fixed_frame: str) -> None:
    """Where cameras with these frames are, on /tf_static."""
    transforms = []
    for camera, frame in cameras:
        turn = dict(zip("xyzw", Rotation.from_matrix(camera.rotation).as_quat().tolist()))
        transform = "geometry_msgs/msg/Transform", {
            "translation": ("geometry_msgs/msg/Vector3", dict(zip("xyz", camera.position))),
            "rotation": ("geometry_msgs/msg/Quaternion", turn),
        }  # fmt: skip
        transforms.append(("geometry_msgs/msg/TransformStamped", {
            "header": _header(stamp, fixed_frame), "child_frame_id": frame, "transform": transform,
        }))  # fmt: skip
    put("/tf_static", stamp, "tf2_msgs/msg/TFMessage", {"transforms": transforms})


# 6 parameters and how far the camera is from the left one of its pair
def _ros2_info(put: Ros2Put, stamp: int, camera: Camera, frame: str, topic: str, baseline: float = 0.0) -> None:
    k, r, p = (np.array(m) for m in _matrices(camera, baseline))
    roi = dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0) | {"do_rectify": False}
    put(topic, stamp, "sensor_msgs/msg/CameraInfo", {
        "header": _header(stamp, frame), "height": camera.height, "width": camera.width,
        "distortion_model": "plumb_bob", "d": np.zeros(5), "k": k, "r": r, "p": p, "binning_x": 0, "binning_y": 0,
        "roi": ("sensor_msgs/msg/RegionOfInterest", roi),
    })  # fmt: skip


# 6 parameters: the last two have defaults
def _ros2_depth(
    put: Ros2Put, stamp: int, camera: Camera, image: np.ndarray, frame: str = OPTICAL_FRAME, topic: str = IMAGE_TOPIC
) -> None:
    put(topic, stamp, "sensor_msgs/msg/Image", {
        "header": _header(stamp, frame), "height": camera.height, "width": camera.width, "encoding": "16UC1",
        "is_bigendian": 0, "step": 2 * camera.width, "data": image.astype("<u2").reshape(-1).view(np.uint8),
    })  # fmt: skip


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


# 6 parameters and how far the camera is from the left one of its pair
def put_camera(
    put: Put, stamp: int, camera: Camera, fixed_frame: str, frame: str, topic: str, baseline: float = 0.0
) -> None:
    """A camera's place, on /tf, and its calibration."""
    transform = FrameTransform(parent_frame_id=fixed_frame, child_frame_id=frame)
    part = transform.translation
    part.x, part.y, part.z = camera.position
    turn = transform.rotation
    turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(camera.rotation).as_quat().tolist()
    put("/tf", stamp, transform)
    k, r, p = _matrices(camera, baseline)
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
