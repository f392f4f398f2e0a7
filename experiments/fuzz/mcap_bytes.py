"""MCAP records, each made from its fields, so that any number in them can be another one than it should be.

Source: the MCAP specification, https://mcap.dev/spec; its records are named here as there.
"""

import struct
import zlib
from collections.abc import Mapping

import lz4.frame
import zstandard

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)
BLOCK = 128 << 10  # bytes of a block of zstd, at most


def text(words: str | bytes) -> bytes:
    """A string behind its length."""
    data = words if isinstance(words, bytes) else words.encode()
    return struct.pack("<I", len(data)) + data


def mapping(entries: Mapping[str, str]) -> bytes:
    """A map of strings behind its length in bytes."""
    data = b"".join(text(key) + text(value) for key, value in entries.items())
    return struct.pack("<I", len(data)) + data


def offsets(entries: Mapping[int, int]) -> bytes:
    """A map of numbers by channel behind its length in bytes."""
    data = b"".join(struct.pack("<HQ", key & 0xFFFF, value) for key, value in entries.items())
    return struct.pack("<I", len(data)) + data


def record(opcode: int, body: bytes, length: int | None = None) -> bytes:
    """A record; `length` that it states, if it is another one than its own."""
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def schema(number: int, name: str | bytes, encoding: str, data: bytes) -> bytes:
    """Content of a schema record."""
    return struct.pack("<H", number) + text(name) + text(encoding) + text(data)


# 5 fields of the record
def channel(
    number: int, schema_number: int, topic: str | bytes, encoding: str, more: Mapping[str, str] | None = None
) -> bytes:
    """Content of a channel record."""
    return struct.pack("<HH", number, schema_number) + text(topic) + text(encoding) + mapping(more or {})


def message(channel_number: int, log_time: int, data: bytes, publish_time: int | None = None, order: int = 0) -> bytes:
    """Content of a message record."""
    published = log_time if publish_time is None else publish_time
    return struct.pack("<HIQQ", channel_number, order, log_time, published) + data


def statistics(counts: tuple[int, int, int, int, int, int], times: tuple[int, int], each: Mapping[int, int]) -> bytes:
    """Content of a statistics record: messages, schemas, channels, attachments, metadata and chunks; first and last log
    time; messages by channel."""
    return struct.pack("<QHIIIIQQ", *counts, *times) + offsets(each)


def packed(data: bytes, how: str) -> bytes:
    """Records as a chunk holds them, compressed by "zstd", "lz4" or not at all ("")."""
    if how == "zstd":
        return zstandard.compress(data)
    return lz4.frame.compress(data) if how == "lz4" else data


# 6 fields of the record
def chunk(
    data: bytes, times: tuple[int, int], how: str = "", crc: int | None = None, size: int | None = None,
    body: bytes | None = None,
) -> bytes:  # fmt: skip
    """Content of a chunk record that holds other records.

    **Arguments:** `crc`, `size` that it states of them unpacked; `body` what stands there instead of them, packed.
    """
    inside = packed(data, how) if body is None else body
    check = zlib.crc32(data) if crc is None else crc
    head = struct.pack("<QQQI", *times, len(data) if size is None else size, check)
    return head + text(how) + struct.pack("<Q", len(inside)) + inside


def zstd_zeros(size: int, told: bool) -> bytes:
    """A frame of zstd that unpacks to so many zeros, in whole blocks of one repeated byte; `told`: its head says so."""
    count = max(1, size // BLOCK)
    window = bytes([7 << 3])  # of 128 KiB
    head = b"\xc0" + window + struct.pack("<Q", count * BLOCK) if told else b"\x00" + window
    block = (1 << 1 | BLOCK << 3).to_bytes(3, "little") + b"\x00"
    last = (1 | 1 << 1 | BLOCK << 3).to_bytes(3, "little") + b"\x00"
    return b"\x28\xb5\x2f\xfd" + head + block * (count - 1) + last


def lz4_zeros(size: int) -> bytes:
    """A frame of lz4 that unpacks to about so many zeros."""
    one = 4 << 20
    frame = lz4.frame.compress(bytes(one), block_size=lz4.frame.BLOCKSIZE_MAX4MB, store_size=False, block_linked=False)
    return frame[:7] + frame[7:-4] * max(1, size // one) + bytes(4)  # head, blocks, end mark
