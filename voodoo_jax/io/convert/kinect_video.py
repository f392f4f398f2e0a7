"""Recordings of Azure Kinect and Femto cameras (.mkv): depth, colour and calibration.

The format: learn.microsoft.com/azure/kinect-dk/record-file-format. Depth is a track of 16-bit images in millimetres,
the calibration an attachment, JSON, for the whole sensor; the depth mode (K4A_DEPTH_MODE) determines the part of it in
an image.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from scipy.spatial.transform import Rotation

from voodoo_jax.config.limited import too_large
from voodoo_jax.io.convert.depth_images import COLOUR as COLOUR_IMAGE
from voodoo_jax.io.convert.depth_images import COLOUR_INFO, MILLIMETRE, camera_file, depth_image, pinhole
from voodoo_jax.io.convert.target import START_NS, ConvertError, Put, new_log, putter
from voodoo_jax.storage.guarded import Answer

DEPTH, COLOUR = "depth_optical", "color_optical"
# side of the sensor's image, first column and row, width and height of the image: k4a's transformation_mode_info
MODES = {
    "NFOV_2X2BINNED": (512, (96, 90), (320, 288)),
    "NFOV_UNBINNED": (1024, (192, 180), (640, 576)),
    "WFOV_2X2BINNED": (512, (0, 0), (512, 512)),
    "WFOV_UNBINNED": (1024, (0, 0), (1024, 1024)),
}
LOCATIONS = {DEPTH: "CALIBRATION_CameraLocationD0", COLOUR: "CALIBRATION_CameraLocationPV0"}
COLOUR_ASPECT = 3 / 4  # height over width of the colour sensor; 16:9 images are cut from its middle


class _Streams(NamedTuple):
    depth: Any
    colour: Any  # or None
    calibration: dict[str, Any]  # camera by location; empty: there is none
    mode: str


def convert(source: Path, target: Answer, camera: Path | None = None) -> list[str]:
    """Writes depth in millimetres unchanged, and JPEG colour images. `camera`: see depth_images.py, if the file has no
    calibration. Raises ConvertError, OSError."""
    try:
        import av
        import av.error
    except ImportError as problem:
        raise ConvertError('.mkv files need PyAV: pip install "voodoo_jax[mkv]"') from problem
    notes: list[str] = []
    try:
        with av.open(str(source), format="matroska") as container, new_log(target) as writer:
            streams = _streams(container, source)
            put = putter(writer)
            size = streams.depth.width, streams.depth.height
            if trouble := too_large("its depth images have", size[0] * size[1], "pixels", "pixels"):
                raise ConvertError(f"'{source}': {trouble}")
            put("/depth/camera_info", START_NS, _depth_camera(streams, size, camera, source))
            colour = _colour(streams, put, notes)
            count = 0
            for packet in container.demux([s for s in (streams.depth, colour) if s is not None]):
                if packet.stream is streams.depth:
                    for frame in streams.depth.codec_context.decode(packet):
                        stamp = _stamp(frame)
                        image = frame.to_ndarray(format="gray16le")
                        put("/depth/image", stamp, depth_image(image, MILLIMETRE))
                        count += 1
                elif packet.pts is not None:
                    image = CompressedImage(frame_id=COLOUR, format="jpeg", data=bytes(packet))
                    put(COLOUR_IMAGE, _stamp(packet), image)
            if not count:
                raise ConvertError(f"'{source}' has no depth image that could be read")
    except av.error.FFmpegError as problem:
        raise ConvertError(f"'{source}' cannot be read as a video: {problem}") from problem
    return notes


def _stamp(part: Any) -> int:
    """Of a frame or packet, nanoseconds; the file's time begins with the recording."""
    return START_NS + round(float(part.pts * part.time_base) * 1e9)


def _streams(container: Any, source: Path) -> _Streams:
    videos = container.streams.video
    named = {stream.metadata.get("title", "").upper(): stream for stream in videos}
    wide = [s for s in videos if str(s.codec_context.pix_fmt).startswith("gray16")]
    depth = named.get("DEPTH") or (wide[0] if len(wide) == 1 else None)
    if depth is None:
        found = ", ".join(s.metadata.get("title", s.codec_context.name) for s in videos) or "no video"
        raise ConvertError(f"'{source}' has no track DEPTH of 16-bit images, but {found}")
    colour = next((s for s in videos if s.codec_context.name == "mjpeg"), None)
    cameras: dict[str, Any] = {}
    for stream in container.streams:
        if stream.type == "attachment" and "calibration" in stream.metadata.get("filename", "").lower():
            try:
                listed = json.loads(bytes(stream.data).rstrip(b"\0"))["CalibrationInformation"]["Cameras"]
                cameras = {camera["Location"]: camera for camera in listed}
            except (ValueError, KeyError, TypeError) as problem:
                raise ConvertError(f"'{source}': its calibration cannot be read: {problem}") from problem
    mode = container.metadata.get("K4A_DEPTH_MODE", "") or depth.metadata.get("K4A_DEPTH_MODE", "")
    return _Streams(depth, colour, cameras, mode)


def _depth_camera(streams: _Streams, size: tuple[int, int], camera: Path | None, source: Path) -> CameraCalibration:
    if camera is not None:
        given = camera_file(camera)
        if (given["width"], given["height"]) != size:
            raise ConvertError(f"'{source}' has images of {size[0]} x {size[1]}, '{camera}' another size")
        return pinhole(given)
    found = streams.calibration.get(LOCATIONS[DEPTH])
    mode = MODES.get(streams.mode) or next((m for m in MODES.values() if m[2] == size), None)
    if found is None or mode is None or mode[2] != size:
        lacks = "calibration" if found is None else f"depth mode for images of {size[0]} x {size[1]}"
        raise ConvertError(f"'{source}' has no {lacks}: give a camera file (--camera)")
    side, corner, _ = mode
    return _calibration(found, (side, side), corner, size, DEPTH)


def _calibration(
    camera: dict[str, Any], sensor: tuple[float, float], corner: tuple[float, float], size: tuple[int, int], frame: str
) -> CameraCalibration:
    """Of an image that is cut from a whole one of the sensor. In the file are shares of the whole image, which count
    from the edge of its first pixel (k4a's transformation_get_mode_specific_camera_calibration)."""
    p = [float(value) for value in camera["Intrinsics"]["ModelParameters"]]
    fx, fy = p[2] * sensor[0], p[3] * sensor[1]
    cx, cy = p[0] * sensor[0] - corner[0] - 0.5, p[1] * sensor[1] - corner[1] - 0.5
    k1, k2, k3, k4, k5, k6 = p[4:10]
    p2, p1 = p[12:14]
    return CameraCalibration(
        frame_id=frame, width=size[0], height=size[1], distortion_model="rational_polynomial",
        D=[k1, k2, p1, p2, k3, k4, k5, k6], K=[fx, 0, cx, 0, fy, cy, 0, 0, 1], R=np.eye(3).ravel().tolist(),
        P=[fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
    )  # fmt: skip


def _colour(streams: _Streams, put: Put, notes: list[str]) -> Any:
    """The stream of colour images, once its calibration and place are written; None: they are left out."""
    stream, camera = streams.colour, streams.calibration.get(LOCATIONS[COLOUR])
    if stream is None:
        return None
    if camera is None:
        notes.append("colour images were left out: they have no calibration")
        return None
    width, height = stream.width, stream.height
    full = width * COLOUR_ASPECT
    corner = (0, (full - height) / 2)
    put(COLOUR_INFO, START_NS, _calibration(camera, (width, full), corner, (width, height), COLOUR))
    # the file has where depth's points are in the colour camera; metres
    turn = np.array(camera["Rt"]["Rotation"], float).reshape(3, 3)
    place = -turn.T @ np.array(camera["Rt"]["Translation"], float)
    message = FrameTransform(parent_frame_id=DEPTH, child_frame_id=COLOUR)
    message.translation.x, message.translation.y, message.translation.z = place.tolist()
    q = Rotation.from_matrix(turn.T).as_quat().tolist()
    message.rotation.x, message.rotation.y, message.rotation.z, message.rotation.w = q
    put("/tf", START_NS, message)
    return stream
