"""Unpacks depth images of image_transport (compressedDepth: PNG or RVL), and plain 16-bit PNG."""

import struct

import numpy as np
from jaxtyping import Int, UInt16

from voodoo_jax.geometry.from_bytes import array_at
from voodoo_jax.io.limits import too_large
from voodoo_jax.records.messages import DEPTH_ENCODINGS, Image

PNG = b"\x89PNG\r\n\x1a\n"
LONGEST = 4  # bytes of a pixel packed by RVL: a difference has 3, a count before and behind it half a byte each
RVL = 4  # pixels for which one of an image in RVL counts
HEADER = 12  # bytes before the packed image: int32 format, float32 parameters A and B


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
    raw = _png(body) if body.startswith(PNG) else _rvl(body[8:], image.shape[0] * image.shape[1]).reshape(image.shape)
    if raw.shape != image.shape or raw.dtype != np.uint16:
        raise ValueError(f"the depth image is {raw.shape} of {raw.dtype}, not {image.shape} of 16 bits")
    if image.encoding != "32FC1" or image.start == 0:
        return raw
    a, b = struct.unpack_from("<ff", image.packed, 4)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(raw > 0, np.float32(a) / (raw.astype(np.float32) - np.float32(b)), np.float32(np.nan))


def _png(data: bytes) -> np.ndarray:
    from voodoo_jax.io.decode.image_codec import stored  # takes a tenth of a second, which other logs need not wait for

    return stored(data, "depth")


def _rvl(data: bytes, count: int) -> UInt16[np.ndarray, " pixel"]:
    """Runs of zeros and of differences, as numbers of groups of three bits (Wilson, Fast lossless depth image
    compression, 2017, DOI 10.1145/3132272.3134144)."""
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
    return out.astype(np.uint16)


def _numbers(groups: Int[np.ndarray, " group"]) -> Int[np.ndarray, " number"]:
    """Numbers of as many groups of three bits as there are, the lowest first; the fourth bit says that more follow."""
    last = np.flatnonzero(groups < 8)
    if not len(last):
        return last
    first = np.concatenate([[0], last[:-1] + 1])
    groups = groups[: last[-1] + 1]
    place = np.arange(len(groups)) - np.repeat(first, last - first + 1)
    return np.add.reduceat((groups & 7) << 3 * np.minimum(place, 20), first)
