"""Logs of simulated cameras with Foxglove's messages."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import CompressionType, Writer
from scipy.spatial.transform import Rotation

from voodoo_jax.io.convert.target import Put, putter
from voodoo_jax.simulate.mcap import CHUNK_SIZE, matrices
from voodoo_jax.simulate.sensor import Camera


@contextmanager
def foxglove_log(stream: BinaryIO) -> Iterator[Put]:
    """A function that writes Foxglove messages, with a stamp if they have one, into a log, which is closed at the
    end."""
    writer = Writer(stream, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
    writer.start(profile="", library="voodoo_jax")
    yield putter(writer)
    writer.finish()


# 6 parameters and how far the camera is from the left one of its pair
def put_camera(
    put: Put, stamp: int, camera: Camera, fixed_frame: str, frame: str, topic: str, baseline: float = 0.0
) -> None:
    """Writes a camera's pose to /tf, and its calibration."""
    transform = FrameTransform(parent_frame_id=fixed_frame, child_frame_id=frame)
    part = transform.translation
    part.x, part.y, part.z = camera.position
    turn = transform.rotation
    turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(camera.rotation).as_quat().tolist()
    put("/tf", stamp, transform)
    k, r, p = matrices(camera, baseline)
    put(topic, stamp, CameraCalibration(
        frame_id=frame, width=camera.width, height=camera.height, distortion_model="plumb_bob", D=[0.0] * 5, K=k, R=r,
        P=p,
    ))  # fmt: skip


def depth_image(camera: Camera, frame: str, image: np.ndarray) -> RawImage:
    """Writes an image in millimetres."""
    return RawImage(
        frame_id=frame, width=camera.width, height=camera.height, encoding="16UC1", step=2 * camera.width,
        data=image.astype("<u2").tobytes(),
    )  # fmt: skip
