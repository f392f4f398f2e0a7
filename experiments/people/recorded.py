"""Writes what was seen as a log (MCAP, Foxglove's messages) with the truth beside it."""

import json
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set
from scipy.spatial.transform import Rotation

from experiments.people.figure import BONES
from voodoo_jax.simulate import FIXED_FRAME, Camera

Found = list[tuple[str, float, float]]


def write(
    path: Path, cameras: dict[str, Camera], time_ns: np.ndarray, depth: list[np.ndarray], found: list[Found]
) -> None:
    """`cameras` "depth" and "colour"; `depth` images in millimetres; `found` names and pixels in the colour camera."""
    with path.open("wb") as stream:
        writer, channels = Writer(stream), {}
        writer.start(profile="", library="experiments.people")

        def put(topic: str, stamp: int, message) -> None:
            if topic not in channels:
                text = build_file_descriptor_set(type(message)).SerializeToString()
                schema = writer.register_schema(message.DESCRIPTOR.full_name, "protobuf", text)
                channels[topic] = writer.register_channel(topic, "protobuf", schema)
            writer.add_message(channels[topic], stamp, message.SerializeToString(), stamp)

        first, transforms = int(time_ns[0]), FrameTransforms()
        for name, camera in cameras.items():
            t = transforms.transforms.add()
            t.timestamp.FromNanoseconds(first)
            t.parent_frame_id, t.child_frame_id = FIXED_FRAME, f"{name}_optical"
            t.translation.x, t.translation.y, t.translation.z = camera.position
            q = Rotation.from_matrix(camera.rotation).as_quat().tolist()
            t.rotation.x, t.rotation.y, t.rotation.z, t.rotation.w = q
        put("/tf", first, transforms)
        for name, c in cameras.items():
            info = CameraCalibration(
                frame_id=f"{name}_optical", width=c.width, height=c.height, distortion_model="plumb_bob", D=[0.0] * 5,
                K=[c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1], R=np.eye(3).ravel().tolist(),
                P=[c.fx, 0, c.cx, 0, 0, c.fy, c.cy, 0, 0, 0, 1, 0],
            )  # fmt: skip
            info.timestamp.FromNanoseconds(first)
            put(f"/{name}/camera_info", first, info)
        c = cameras["depth"]
        for stamp, image, names in zip(time_ns.tolist(), depth, found):
            message = RawImage(
                frame_id="depth_optical", width=c.width, height=c.height, encoding="16UC1", step=2 * c.width,
                data=image.astype("<u2").tobytes(),
            )  # fmt: skip
            message.timestamp.FromNanoseconds(stamp)
            put("/depth/image", stamp, message)
            put("/colour/detections", stamp, _annotations(stamp, names))
        writer.finish()


def _annotations(stamp: int, names: Found) -> ImageAnnotations:
    """A circle and a text for each."""
    message = ImageAnnotations()
    for name, u, v in names:
        circle, text = message.circles.add(), message.texts.add()
        circle.diameter, circle.outline_color.a, text.text, text.font_size = 20, 1, name, 10
        for mark in (circle, text):
            mark.timestamp.FromNanoseconds(stamp)
            mark.position.x, mark.position.y = u, v
    return message


def write_truth(path: Path, time_ns: np.ndarray, joints: np.ndarray, dims: dict[str, float]) -> None:
    """Joint centres [frame, joint, 3] and dimensions, metres."""
    text = np.array(json.dumps(dims))
    np.savez_compressed(path, time_ns=time_ns, joints=np.float32(joints), names=np.array(list(BONES)), dims=text)
