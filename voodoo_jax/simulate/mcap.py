"""Writes a simulated recording: MCAP with ROS 2 messages, and its truth in a file beside it."""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from voodoo_jax.model.body import segment_lengths
from voodoo_jax.simulate.colour import ColourSimulation
from voodoo_jax.simulate.recording import Simulation
from voodoo_jax.simulate.sensor import Camera
from voodoo_jax.storage.atomic import replacing

OPTICAL_FRAME = "depth_optical"
CHUNK_SIZE = 1 << 20
JPEG = 90  # quality


def write_simulation(simulation: Simulation, path: str | os.PathLike[str]) -> Path:
    """Writes `path` (MCAP) and `<stem>.truth.npz` beside it; equal simulations give equal bytes. Returns `path`.

    ROS 2's sensor_msgs/Image 16UC1 in millimetres, CameraInfo, transform on /tf_static. Truth: time_ns [frame], joints
    [frame, centre, 3] metres, names, dims (JSON, metres). Files appear under their names only when complete. Raises
    OSError.
    """
    return _write(simulation, [_View("/depth", OPTICAL_FRAME, simulation.camera, simulation.depth)], path)


def write_colour(
    simulation: ColourSimulation, path: str | os.PathLike[str], beside: Sequence[ColourSimulation] = ()
) -> Path:
    """As `write_simulation`, with JPEG images: of a pair on /stereo/left/image/compressed and /stereo/right/..., of one
    camera on /colour/image/compressed; camera_info beside each, depth as there.

    **Arguments:** `beside` the same motion as further cameras see it; their topics begin with /camera2, /camera3, ...
    """
    views = [view for number, s in enumerate((simulation, *beside)) for view in _views(s, number)]
    return _write(simulation, views, path)


class _View(NamedTuple):
    """Images of one camera."""

    name: str  # how its topics begin
    frame: str
    camera: Camera
    images: np.ndarray  # [frame, row, column] depth in millimetres, [frame, row, column, 3] red, green, blue
    baseline: float = 0.0  # metres to the left camera of its pair

    @property
    def is_colour(self) -> bool:
        return self.images.ndim == 4

    @property
    def topic(self) -> str:
        """Topic of its images."""
        return f"{self.name}/image/compressed" if self.is_colour else f"{self.name}/image"


def _views(s: ColourSimulation, number: int) -> list[_View]:
    """Images of the cameras of one of several simulations."""
    rig = f"/camera{number + 1}" if number else ""
    names = ["/colour"] if len(s.cameras) == 1 else ["/stereo/left", "/stereo/right"]
    first = np.array(s.cameras[0].position)
    found = []
    for name, camera, images in zip(names, s.cameras, s.images):
        frame = f"{rig}{name}"[1:].replace("/", "_") + "_optical"
        found.append(_View(rig + name, frame, camera, images, float(np.linalg.norm(camera.position - first))))
    if s.depth_camera is not None:
        found.append(_View(f"{rig}/depth", f"{rig[1:]}_{OPTICAL_FRAME}".lstrip("_"), s.depth_camera, s.depth))
    return found


def _write(s: Simulation | ColourSimulation, views: list[_View], path: str | os.PathLike[str]) -> Path:
    """Writes the log and its truth."""
    path, body = Path(path), s.body
    dims = segment_lengths(body) | ({"stature": float(body.scale)} if body.scale_name == "stature" else {})
    with replacing(path) as partial, open(partial, "wb") as stream:
        _ros2(views, s.time_ns.tolist(), s.fixed_frame, stream)
    with replacing(path.with_name(f"{path.stem}.truth.npz")) as partial, open(partial, "wb") as stream:
        save_truth(stream, s.time_ns, s.joints, body.topology.centres, dims)
    return path


def _jpeg(image: np.ndarray) -> bytes:
    import cv2  # only here: logs of depth are written without

    return np.asarray(cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG])[1]).tobytes()


def save_truth(
    stream: BinaryIO, time_ns: np.ndarray, joints: np.ndarray, names: Sequence[str], dims: dict[str, float]
) -> None:
    """Writes the truth in the form of write_simulation."""
    np.savez_compressed(stream, time_ns=time_ns, joints=joints, names=np.array(names), dims=np.array(json.dumps(dims)))


def matrices(camera: Camera, baseline: float = 0.0) -> tuple[list[float], list[float], list[float]]:
    """Row-major k, r, p of a calibration; `baseline` metres to the left camera of its pair."""
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    p = [camera.fx, 0.0, camera.cx, 0.0 - camera.fx * baseline, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return k, np.eye(3).ravel().tolist(), p


def _ros2(views: list[_View], times: list[int], fixed_frame: str, stream: BinaryIO) -> None:
    with _ros2_log(stream) as put:
        if times:
            _ros2_place(put, times[0], views, fixed_frame)
        for view in views if times else ():
            _ros2_info(put, times[0], view)
        for i, stamp in enumerate(times):
            for view in views:
                if view.is_colour:
                    data = np.frombuffer(_jpeg(view.images[i]), np.uint8)
                    fields = {"header": _header(stamp, view.frame), "format": "jpeg", "data": data}
                    put(view.topic, stamp, "sensor_msgs/msg/CompressedImage", fields)
                else:
                    _ros2_depth(put, stamp, view, view.images[i])


Ros2Put = Callable[[str, int, str, dict[str, Any]], None]  # topic, stamp, type, its fields


@contextmanager
def _ros2_log(stream: BinaryIO) -> Iterator[Ros2Put]:
    """A function that writes ROS 2 messages into a log, which is closed at the end; messages in fields are (type,
    fields)."""
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


def _ros2_place(put: Ros2Put, stamp: int, views: list[_View], fixed_frame: str) -> None:
    """Writes the poses of cameras to /tf_static."""
    transforms = []
    for view in views:
        turn = dict(zip("xyzw", Rotation.from_matrix(view.camera.rotation).as_quat().tolist()))
        transform = "geometry_msgs/msg/Transform", {
            "translation": ("geometry_msgs/msg/Vector3", dict(zip("xyz", view.camera.position))),
            "rotation": ("geometry_msgs/msg/Quaternion", turn),
        }  # fmt: skip
        transforms.append(("geometry_msgs/msg/TransformStamped", {
            "header": _header(stamp, fixed_frame), "child_frame_id": view.frame, "transform": transform,
        }))  # fmt: skip
    put("/tf_static", stamp, "tf2_msgs/msg/TFMessage", {"transforms": transforms})


def _ros2_info(put: Ros2Put, stamp: int, view: _View) -> None:
    camera, (k, r, p) = view.camera, (np.array(m) for m in matrices(view.camera, view.baseline))
    roi = dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0) | {"do_rectify": False}
    put(f"{view.name}/camera_info", stamp, "sensor_msgs/msg/CameraInfo", {
        "header": _header(stamp, view.frame), "height": camera.height, "width": camera.width,
        "distortion_model": "plumb_bob", "d": np.zeros(5), "k": k, "r": r, "p": p, "binning_x": 0, "binning_y": 0,
        "roi": ("sensor_msgs/msg/RegionOfInterest", roi),
    })  # fmt: skip


def _ros2_depth(put: Ros2Put, stamp: int, view: _View, image: np.ndarray) -> None:
    camera = view.camera
    put(view.topic, stamp, "sensor_msgs/msg/Image", {
        "header": _header(stamp, view.frame), "height": camera.height, "width": camera.width, "encoding": "16UC1",
        "is_bigendian": 0, "step": 2 * camera.width, "data": image.astype("<u2").reshape(-1).view(np.uint8),
    })  # fmt: skip
