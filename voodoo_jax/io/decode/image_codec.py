"""Decodes compressed images."""

import struct

import cv2
import numpy as np
from jaxtyping import UInt8

from voodoo_jax.geometry.from_bytes import array_at
from voodoo_jax.io.decode.image_size import packed_size
from voodoo_jax.io.limits import too_large
from voodoo_jax.records.messages import Colour

# Bytes per pixel of the encodings that can be unpacked. ROS calls UYVY yuv422, and YUYV yuv422_yuy2.
PIXELS = {
    "rgb8": 3, "bgr8": 3, "8uc3": 3, "rgba8": 4, "bgra8": 4, "8uc4": 4, "mono8": 1, "8uc1": 1,
    "yuv422": 2, "uyvy": 2, "yuyv": 2, "yuv422_yuy2": 2,
}  # fmt: skip

_TO_BGR = {
    "rgb8": cv2.COLOR_RGB2BGR, "rgba8": cv2.COLOR_RGBA2BGR, "bgra8": cv2.COLOR_BGRA2BGR, "8uc4": cv2.COLOR_BGRA2BGR,
    "mono8": cv2.COLOR_GRAY2BGR, "8uc1": cv2.COLOR_GRAY2BGR, "yuv422": cv2.COLOR_YUV2BGR_UYVY,
    "uyvy": cv2.COLOR_YUV2BGR_UYVY, "yuyv": cv2.COLOR_YUV2BGR_YUY2, "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2,
}  # fmt: skip
_ENDS = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND\xaeB`\x82"}  # how a complete JPEG or PNG ends, by how it begins


def pixels(image: Colour) -> UInt8[np.ndarray, "row column 3"]:
    """Blue, green and red of each pixel. Raises ValueError for a damaged image or an unknown format."""
    if image.step:
        size = PIXELS[image.encoding]
        rows, columns = image.shape
        if trouble := too_large("the image has", rows * columns, "pixels", "pixels"):
            raise ValueError(trouble)
        if rows * columns == 0:
            raise ValueError("the image is empty")
        view = array_at(image.data, np.uint8, (rows, columns, size), strides=(image.step, size, 1))
        code = _TO_BGR.get(image.encoding)
        return np.ascontiguousarray(view) if code is None else cv2.cvtColor(np.ascontiguousarray(view), code)
    # as it was stored: with its orientation tag applied it would no longer fit the calibration
    as_stored = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    return np.asarray(stored(image.data, image.encoding, as_stored), np.uint8)


def stored(data: np.ndarray | bytes, what: str, how: int = cv2.IMREAD_UNCHANGED) -> np.ndarray:
    """The image [row, column, ...] in the bytes of a JPEG, PNG and so on. Raises ValueError, which names `what`, if it
    is damaged."""
    data = array_at(data, np.uint8)
    end = _ENDS.get(data[:2].tobytes())
    # the decoder fills what is missing at the end of a file
    if end is not None and end not in data[-64:].tobytes():
        raise ValueError(f"the {what} image is cut off")
    # in the header, before the decoder asks for memory
    try:
        size = packed_size(data.tobytes())
    except struct.error:
        raise ValueError(f"the {what} image is damaged: its head ends early") from None
    if trouble := too_large(f"the {what} image has", size, "pixels", "pixels"):
        raise ValueError(trouble)
    try:
        made = cv2.imdecode(data, how)
    except cv2.error as problem:
        raise ValueError(f"the {what} image cannot be decoded: {problem.err}") from None
    if made is None:
        raise ValueError(f"the {what} image cannot be decoded")
    return np.asarray(made)
