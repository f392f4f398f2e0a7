"""Reads the number of pixels from the header of a compressed image, before a decoder allocates memory."""

import struct

SEGMENTS = 4096  # of a JPEG before its pixels: cameras write about 20, and 255 at most of one kind
READ = "JPEG, PNG, TIFF, WebP, AVIF, BMP"


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
