"""Packed images to pixels."""

import struct

import cv2
import numpy as np
from jaxtyping import UInt8

from voodoo_jax.io.limits import PIXELS as LARGEST
from voodoo_jax.io.limits import of_size
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
SEGMENTS = 4096  # of a JPEG before its pixels: cameras write about 20, and 255 at most of one kind
_ENDS = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND\xaeB`\x82"}  # how a complete JPEG or PNG ends, by how it begins


def pixels(image: Colour) -> UInt8[np.ndarray, "row column 3"]:
    """Blue, green and red of each pixel. Raises ValueError for an image that is broken or in a format not known."""
    if image.step:
        size = PIXELS[image.encoding]
        raw = np.frombuffer(image.data, np.uint8)
        rows, columns = image.shape
        if rows * columns > LARGEST:
            raise ValueError(of_size("the image has", rows * columns, LARGEST, "pixels"))
        if rows * columns == 0 or len(raw) < (rows - 1) * image.step + columns * size:
            raise ValueError(
                f"{len(raw)} bytes are too few for {rows} x {columns} pixels of {image.encoding}, or it is empty"
            )
        view = np.ndarray((*image.shape, size), np.uint8, buffer=raw, strides=(image.step, size, 1))
        code = _TO_BGR.get(image.encoding)
        return np.ascontiguousarray(view) if code is None else cv2.cvtColor(np.ascontiguousarray(view), code)
    # as it was stored: with its orientation tag applied it would no longer fit the calibration
    as_stored = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    return np.asarray(stored(image.data, image.encoding, as_stored), np.uint8)


def stored(data: np.ndarray | bytes, what: str, how: int = cv2.IMREAD_UNCHANGED) -> np.ndarray:
    """The image [row, column, ...] in the bytes of a JPEG, PNG and so on. Raises ValueError that names `what` it is of,
    where it is broken."""
    data = np.frombuffer(data, np.uint8)
    end = _ENDS.get(data[:2].tobytes())
    # the decoder fills what is missing at the end of a file
    if end is not None and end not in data[-64:].tobytes():
        raise ValueError(f"the {what} image is cut off")
    # in the header, before the decoder asks for memory
    size = _png_size(data) if end == _ENDS[b"\x89P"] else _jpeg_size(data) if end is not None else 0
    if size > LARGEST:
        raise ValueError(of_size(f"the {what} image has", size, LARGEST, "pixels"))
    try:
        made = cv2.imdecode(data, how)
    except cv2.error as problem:
        raise ValueError(f"the {what} image cannot be decoded: {problem.err}") from None
    if made is None:
        raise ValueError(f"the {what} image cannot be decoded")
    return np.asarray(made)


def _png_size(data: UInt8[np.ndarray, " byte"]) -> int:
    """Pixels of a PNG. Raises ValueError where its parts are longer than the file: the decoder would believe them."""
    raw, at, size = data.tobytes(), 8, 0
    while at + 12 <= len(raw):
        length, kind = struct.unpack_from(">I4s", raw, at)
        if at + 12 + length > len(raw):
            break
        if kind == b"IHDR" and length >= 8:
            columns, rows = struct.unpack_from(">II", raw, at + 8)
            size = rows * columns
        if kind == b"IEND":
            return size
        at += 12 + length
    raise ValueError("the PNG image is damaged: a part of it is longer than the file")


def _jpeg_size(data: UInt8[np.ndarray, " byte"]) -> int:
    """Pixels of a JPEG, 0 if it does not say: ITU-T T.81 annex B, a frame header before the first scan."""
    raw, at, size = data.tobytes(), 2, 0
    for _ in range(SEGMENTS):
        at = raw.find(b"\xff", at)  # the decoder looks for the next marker, too
        if at < 0 or at + 9 > len(raw):
            return size
        kind = raw[at + 1]
        if kind == 0xDA:  # the pixels follow
            return size
        if kind in (0x00, 0x01, 0xFF) or 0xD0 <= kind <= 0xD9:  # markers without content
            at += 1 if kind == 0xFF else 2
            continue
        length, _, rows, columns = struct.unpack_from(">HBHH", raw, at + 2)
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            size = max(size, rows * columns)
        at += 2 + length
    raise ValueError("the JPEG image is damaged: its head does not end")
