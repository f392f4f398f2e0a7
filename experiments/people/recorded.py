"""Writes what was seen as a log (MCAP, Foxglove's messages) with the truth beside it."""

from pathlib import Path

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations

from experiments.foxglove_log import depth_image, foxglove_log, put_camera
from experiments.people.figure import BONES
from experiments.people.pictures import JPEG, Rig
from voodoo_jax.simulate.mcap import save_truth
from voodoo_jax.simulate.recording import FIXED_FRAME
from voodoo_jax.simulate.sensor import Camera

Found = list[tuple[str, float, float]]


def write(
    path: Path, cameras: dict[str, list[Camera]], time_ns: np.ndarray, depth: list[np.ndarray], found: list[Found]
) -> None:
    """`cameras` "depth" and "colour", in each frame where they move, or once; `depth` images in millimetres; `found`
    names and pixels in the colour camera."""
    with path.open("wb") as stream, foxglove_log(stream) as put:
        for i, (stamp, image, names) in enumerate(zip(time_ns.tolist(), depth, found)):
            for name, camera in cameras.items():
                if i < len(camera):
                    put_camera(put, stamp, camera[i], FIXED_FRAME, f"{name}_optical", f"/{name}/camera_info")
            put("/depth/image", stamp, depth_image(cameras["depth"][0], "depth_optical", image))
            put("/colour/detections", stamp, _annotations(stamp, names))


def write_pairs(path: Path, rig: Rig, time_ns: np.ndarray, pictures: list[list[np.ndarray]]) -> None:
    """`pictures` of the left and the right camera in each frame; as JPEG."""
    with path.open("wb") as stream, foxglove_log(stream) as put:
        for stamp, pair in zip(time_ns.tolist(), pictures):
            for side, camera, picture in zip(("left", "right"), rig.cameras(), pair):
                frame = f"{side}_optical"
                put_camera(put, stamp, camera, FIXED_FRAME, frame, f"/stereo/{side}/camera_info")
                data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG])[1].tobytes()
                put(f"/stereo/{side}/image", stamp, CompressedImage(frame_id=frame, data=data, format="jpeg"))


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
    with path.open("wb") as stream:
        save_truth(stream, time_ns, joints.astype(np.float32), list(BONES), dims)
