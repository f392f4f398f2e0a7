"""Messages with colour, grey, compressed or packed depth images, and their decoders: JPEG, PNG and so on, depth images
of image_transport (compressedDepth: PNG or RVL), and plain 16-bit PNG. The number of pixels is read from the header
before a decoder allocates memory; nothing is decompressed before it is needed."""

import struct
from typing import Any

import cv2
import numpy as np
from jaxtyping import Int, UInt8, UInt16

from voodoo_jax.config.limited import too_large
from voodoo_jax.geometry.arrays_file import array_at
from voodoo_jax.records.messages import DEPTH_ENCODINGS, Colour, Image, frame_name, pb_stamp, ros_stamp

SEGMENTS = 4096  # of a JPEG before its pixels: cameras write about 20, and 255 at most of one kind
READ = "JPEG, PNG, TIFF, WebP, AVIF, BMP"
PNG = b"\x89PNG\r\n\x1a\n"
LONGEST = 4  # bytes of a pixel packed by RVL: a difference has 3, a count before and behind it half a byte each
RVL = 4  # pixels for which one of an image in RVL counts
HEADER = 12  # bytes before the packed image: int32 format, float32 parameters A and B
COLOUR_KIND = "colour image"
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


def packed_size(data: bytes) -> int:
    """Pixels of an image; the largest number in any part of its header.

    Raises ValueError for another format or an invalid header; struct.error if the data ends within the header.
    """
    if data[:2] == b"\xff\xd8":
        return _jpeg(data)
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return _png(data)
    if data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return _tiff(data)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _webp(data)
    if data[4:12] in (b"ftypavif", b"ftypavis", b"ftypmif1"):
        return _avif(data)
    if data[:2] == b"BM":
        return _bmp(data)
    raise ValueError(f"the image is of a format that is not read ({READ} are), or damaged")


def _png(data: bytes) -> int:
    """Raises ValueError where its parts are longer than the file: the decoder would believe them."""
    at, size = 8, 0
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        if at + 12 + length > len(data):
            break
        if kind == b"IHDR" and length >= 8:
            columns, rows = struct.unpack_from(">II", data, at + 8)
            size = max(size, rows * columns)
        if kind == b"IEND":
            return size
        at += 12 + length
    raise ValueError("the PNG image is damaged: a part of it is longer than the file")


def _jpeg(data: bytes) -> int:
    """0 if it does not say: ITU-T T.81 annex B, a frame header before the first scan."""
    at, size = 2, 0
    for _ in range(SEGMENTS):
        at = data.find(b"\xff", at)  # the decoder looks for the next marker, too
        if at < 0 or at + 9 > len(data):
            return size
        kind = data[at + 1]
        if kind == 0xDA:  # the pixels follow
            return size
        if kind in (0x00, 0x01, 0xFF) or 0xD0 <= kind <= 0xD9:  # markers without content
            at += 1 if kind == 0xFF else 2
            continue
        length, _, rows, columns = struct.unpack_from(">HBHH", data, at + 2)
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            size = max(size, rows * columns)
        at += 2 + length
    raise ValueError("the JPEG image is damaged: its head does not end")


def _tiff(data: bytes) -> int:
    """Of its first page (TIFF 6.0, sec. 2, and BigTIFF), or of one of its tiles, for which a decoder has a buffer."""
    order, big = "<" if data[:1] == b"I" else ">", data[2:4] in (b"+\0", b"\0+")
    at = struct.unpack_from(order + ("Q" if big else "I"), data, 8 if big else 4)[0]
    count = struct.unpack_from(order + ("Q" if big else "H"), data, at)[0]
    at, step = at + (8 if big else 2), 20 if big else 12
    if at + count * step > len(data):
        raise ValueError("the TIFF image is damaged: its directory is longer than the file")
    found: dict[int, int] = {}
    for place in range(at, at + count * step, step):
        tag, kind = struct.unpack_from(order + "HH", data, place)
        form = {1: "B", 3: "H", 4: "I", 16: "Q"}.get(kind)
        if form and tag in (256, 257, 322, 323):  # columns, rows, those of tiles
            value = struct.unpack_from(order + form, data, place + (12 if big else 8))[0]
            found[tag] = max(value, found.get(tag, 0))
    if 256 not in found or 257 not in found:
        raise ValueError("the TIFF image is damaged: it does not say how large it is")
    return max(found[256] * found[257], found.get(322, 0) * found.get(323, 0))


def _webp(data: bytes) -> int:
    """Of its canvas or of a picture on it (RFC 9649, sec. 2)."""
    at, size = 12, 0
    while at + 18 <= len(data):
        kind, length = struct.unpack_from("<4sI", data, at)
        body = at + 8
        if kind == b"VP8X":
            columns, rows = (1 + int.from_bytes(data[body + k : body + k + 3], "little") for k in (4, 7))
            size = max(size, rows * columns)
        elif kind == b"VP8L":
            bits = int.from_bytes(data[body + 1 : body + 5], "little")
            size = max(size, (1 + (bits & 0x3FFF)) * (1 + (bits >> 14 & 0x3FFF)))
        elif kind == b"VP8 ":
            columns, rows = struct.unpack_from("<HH", data, body + 6)
            size = max(size, (columns & 0x3FFF) * (rows & 0x3FFF))
        elif kind == b"ANMF":
            columns, rows = (1 + int.from_bytes(data[body + k : body + k + 3], "little") for k in (6, 9))
            size = max(size, rows * columns)
        at = body + length + length % 2
    if not size:
        raise ValueError("the WebP image is damaged: it does not say how large it is")
    return size


def _avif(data: bytes) -> int:
    """The largest of its pictures (ISO/IEC 23008-12, sec. 6.5.3)."""
    at, size = data.find(b"ispe"), 0
    while at >= 0:
        columns, rows = struct.unpack_from(">II", data, at + 8)
        size, at = max(size, rows * columns), data.find(b"ispe", at + 4)
    if not size:
        raise ValueError("the AVIF image is damaged: it does not say how large it is")
    return size


def _bmp(data: bytes) -> int:
    """Its header's width and height, of which the latter is negative where rows go down."""
    old = struct.unpack_from("<I", data, 14)[0] == 12
    columns, rows = struct.unpack_from("<HH" if old else "<ii", data, 18)
    return abs(columns) * abs(rows)


def packed_depth(stamp_ns: int, frame: str, format: str, data: np.ndarray | bytes) -> Image | None:
    """The depth image in a compressed image, still packed; None for colour or grey.

    `format` as image_transport writes it ("16UC1; compressedDepth png"; older ones say "; compressedDepth" only), or
    "png", if its header states one channel of 16 bits. Raises ValueError if it is too short.
    """
    encoding, _, how = (part.strip() for part in format.partition(";"))
    whole, start = "compresseddepth" not in how.lower(), 0
    if not whole:
        start, encoding = HEADER, encoding.upper()
    elif encoding.upper() not in DEPTH_ENCODINGS:
        encoding = "16UC1"
    head = bytes(data[start : start + 26])
    if whole and not (head.startswith(PNG) and head[24:26] == b"\x10\x00"):  # bits, and one channel of grey
        return None
    is_png = head.startswith(PNG)
    if len(head) < (24 if is_png else 8):
        raise ValueError(f"{len(data)} bytes are too few for a compressed depth image")
    # a PNG begins with width and height, big-endian; RVL as the computer has them
    columns, rows = struct.unpack(">ii", head[16:24]) if is_png else struct.unpack("<ii", head[:8])
    if not (is_png or "rvl" in how.lower()) or not (0 < rows and 0 < columns):
        raise ValueError("the depth image is neither PNG nor RVL")
    # RVL is unpacked by NumPy with some arrays of 64-bit numbers for each nibble: some hundred bytes a pixel at worst
    if trouble := too_large("the depth image has", rows * columns * (1 if is_png else RVL), "pixels", "pixels"):
        raise ValueError(trouble)
    kind, unit = DEPTH_ENCODINGS.get(encoding.upper(), ("", 1.0))
    packed = bytes(data) if kind else None
    return Image(stamp_ns, frame, encoding, (rows, columns), None, unit, packed=packed, start=start)


def raw_of(image: Image) -> np.ndarray | None:
    """The raw image [row, column], unpacked; 0 or NaN without a measurement; None for another encoding. Raises
    ValueError if it is broken.

    Distances of 32FC1 are packed as A / (raw - B), so that the steps grow with distance.
    """
    if image.packed is None:
        return image.raw
    body = image.packed[image.start :]
    raw = stored(body, "depth") if body.startswith(PNG) else _rvl(body[8:], image.shape)
    if raw.shape != image.shape or raw.dtype != np.uint16:
        raise ValueError(f"the depth image is {raw.shape} of {raw.dtype}, not {image.shape} of 16 bits")
    if image.encoding != "32FC1" or image.start == 0:
        return raw
    a, b = struct.unpack_from("<ff", image.packed, 4)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(raw > 0, np.float32(a) / (raw.astype(np.float32) - np.float32(b)), np.float32(np.nan))


def _rvl(data: bytes, shape: tuple[int, int]) -> UInt16[np.ndarray, "row column"]:
    """Runs of zeros and of differences, as numbers of groups of three bits (Wilson, Fast lossless depth image
    compression, 2017, DOI 10.1145/3132272.3134144)."""
    count = shape[0] * shape[1]
    if len(data) > LONGEST * (count + 16):
        raise ValueError("the depth image is damaged: it is longer than its pixels need")
    words = array_at(data, "<u4")
    groups = (words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32) & 15).ravel().astype(np.int64)
    numbers = _numbers(groups)
    out, at, pixel = np.zeros(count, np.int64), 0, 0
    values: list[np.ndarray] = []
    places: list[np.ndarray] = []
    while pixel < count:
        if at + 2 > len(numbers):
            raise ValueError("the depth image is cut off")
        zeros, some = int(numbers[at]), int(numbers[at + 1])
        first, at, pixel = pixel + zeros, at + 2, pixel + zeros + some
        if pixel > count or at + some > len(numbers) or zeros + some == 0:
            raise ValueError("the depth image cannot be decoded")
        values.append(numbers[at : at + some])
        places.append(np.arange(first, pixel))
        at += some
    steps = np.concatenate([np.zeros(0, np.int64), *values])
    out[np.concatenate([np.zeros(0, np.int64), *places])] = np.cumsum((steps >> 1) ^ -(steps & 1))
    return out.astype(np.uint16).reshape(shape)


def _numbers(groups: Int[np.ndarray, " group"]) -> Int[np.ndarray, " number"]:
    """Numbers of as many groups of three bits as there are, the lowest first; the fourth bit says that more follow."""
    last = np.flatnonzero(groups < 8)
    if not len(last):
        return last
    first = np.concatenate([[0], last[:-1] + 1])
    groups = groups[: last[-1] + 1]
    place = np.arange(len(groups)) - np.repeat(first, last - first + 1)
    return np.add.reduceat((groups & 7) << 3 * np.minimum(place, 20), first)


# 7 parameters: the fields of an image message
def colour_image(stamp_ns: int, frame: str, encoding: str, rows: int, columns: int, step: int, data: Any) -> Colour:
    """An image with an encoding of `PIXELS`."""
    name = encoding.strip().lower()
    step = max(step, columns * PIXELS[name], 1)  # some drivers leave step at 0
    return Colour(stamp_ns, frame_name(frame), name, (rows, columns), step, data)


def _compressed(stamp_ns: int, frame: str, m: Any) -> Colour | Image:
    if not len(m.data):
        raise ValueError("the image is empty")
    # image_transport writes "rgb8; jpeg compressed bgr8"
    colour = Colour(stamp_ns, frame_name(frame), m.format.strip().lower(), (0, 0), 0, m.data)
    return packed_depth(stamp_ns, frame_name(frame), m.format, m.data) or colour


CONVERTERS = {
    "sensor_msgs/msg/CompressedImage": (COLOUR_KIND, lambda m: _compressed(ros_stamp(m.header), m.header.frame_id, m)),
    "foxglove.CompressedImage": (COLOUR_KIND, lambda m: _compressed(pb_stamp(m), m.frame_id, m)),
}


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
