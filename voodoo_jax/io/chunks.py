"""Reads the chunks of an MCAP file, each unpacked within limits, and escapes texts in it."""

import struct
import time
import zlib
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from threading import Lock

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import CRCValidationError

from voodoo_jax.config.limited import limits, too_large
from voodoo_jax.records.notes import SENTENCE, plain, plain_name

ZSTD = b"\x28\xb5\x2f\xfd"  # how data packed with zstd begin
METADATA = ("latching", "offered_qos_profiles", "up")  # of a channel
COMPRESSIONS = ("", "lz4", "zstd")
# What mcap 1.6 and its decompressors raise on bad bytes (lz4: RuntimeError; lengths over 2^63: OverflowError).
READ_ERRORS = (
    McapError,
    CRCValidationError,
    struct.error,
    KeyError,
    UnicodeDecodeError,
    zstandard.ZstdError,
    RuntimeError,
    OSError,
    OverflowError,
    EOFError,
    MemoryError,
)

_RECORD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")  # heads: of a record, and of a message behind it


class LogError(Exception):
    """A log cannot be used. The text states the fault, its place and a remedy; names in it are escaped."""

    def __init__(self, text: str):
        super().__init__(plain(text, 2 * SENTENCE))


class Clock:
    """Processor time of this thread since a log last yielded something, seconds."""

    def __init__(self, size: int):
        self.most = limits().seconds * (1 + (size >> 30))
        self.restart()

    def restart(self) -> None:
        """Restarts the clock, after a result."""
        self._wall, self._began = time.monotonic(), time.thread_time()

    def check(self) -> None:
        """Raises LogError if it took too long."""
        # the processor's time is asked for where all time could be enough only: that takes ten times as long
        if 0 < self.most < time.monotonic() - self._wall and self.most < time.thread_time() - self._began:
            raise LogError(
                f"The log took {self.most:g} s of processor time without yielding a frame: it is damaged, or made "
                "to take long. If it is intact, allow more (--limits.seconds)."
            )


class Budget:
    """Bytes to which a log may still unpack."""

    def __init__(self, size: int):
        self.most = self.left = limits().log_bytes + limits().log_times * size
        self.lock = Lock()

    def take(self, count: int) -> None:
        """Subtracts bytes. Raises LogError if they are too many: unlike a bad chunk, this ends reading."""
        with self.lock:
            self.left -= count
        if self.left < 0:
            raise LogError(
                f"The log unpacks to more than {self.most} bytes, over {limits().log_times} times its size: it is "
                "damaged, or made to take long. It is not used (--limits.log_bytes, --limits.log_times)."
            )


def chunk_records(body: bytes, budget: Budget) -> tuple[list, str]:
    """Schemas, channels and messages of one chunk record, and the reason for missing ones; raises one of READ_ERRORS if
    it is damaged."""
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    if chunk.compression not in COMPRESSIONS:
        # mcap 1.6 would take the bytes for uncompressed ones and lose them without a word.
        raise McapError(f"compression '{chunk.compression}' is unknown")
    if not chunk.uncompressed_crc and not chunk.compression and len(chunk.data) != chunk.uncompressed_size:
        raise McapError("its length is not the one stated")
    data = _unpacked(chunk)
    budget.take(len(data))
    if chunk.uncompressed_crc and (crc := zlib.crc32(data)) != chunk.uncompressed_crc:
        raise CRCValidationError(expected=chunk.uncompressed_crc, actual=crc, record=chunk)
    return _records(data)


def _unpacked(chunk: Chunk) -> bytes:
    """The unpacked content of a chunk, if it is not too large: its header is checked before memory is allocated."""
    size, most = len(chunk.data), limits().chunk_bytes
    if chunk.compression == "zstd":
        # -1 where the packed data do not say it; where they do, the chunk's own word does not count
        size = zstandard.frame_content_size(chunk.data)
        size = chunk.uncompressed_size if size < 0 else size
    elif chunk.compression == "lz4":
        size = lz4.frame.get_frame_info(chunk.data)["content_size"]
    if trouble := too_large("it unpacks to", size, "chunk_bytes"):
        raise McapError(trouble)
    if chunk.compression == "zstd":
        return zstandard.decompress(chunk.data, chunk.uncompressed_size)
    if chunk.compression == "lz4":
        decoder = lz4.frame.LZ4FrameDecompressor()
        data = decoder.decompress(chunk.data, max_length=most)
        if not decoder.eof:
            raise McapError(f"it is cut off, or unpacks to more than {most} bytes (--limits.chunk_bytes)")
        return data
    return chunk.data


def _records(data: bytes) -> tuple[list, str]:
    """Schemas, channels and messages in the bytes of a chunk, and "" or why it ends early."""
    records, at, end, most = [], 0, len(data), limits().chunk_messages
    while at < end:
        opcode, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        stop = at + length
        if stop > end:
            return records, "a message in it is longer than the rest of it"
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise McapError("a message in it has no head")
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, at)
            records.append(Message(channel, log_time, data[at + _MESSAGE.size : stop], publish_time, sequence))
        elif opcode == Opcode.CHANNEL:
            records.append(Channel.read(ReadDataStream(BytesIO(data[at:stop]))))
        elif opcode == Opcode.SCHEMA:
            records.append(Schema.read(ReadDataStream(BytesIO(data[at:stop]))))
        elif opcode == 0:  # MCAP has no such record: a chunk of zeros would be millions of them
            raise McapError("it has bytes that are no records")
        if len(records) > most:
            raise McapError(f"it has more than {most} messages (--limits.chunk_messages)")
        at = stop
    return records, ""


def clean_channel(channel: Channel) -> Channel:
    """A channel with escaped names."""
    topic, encoding = plain_name(channel.topic), plain(channel.message_encoding)
    if (topic, encoding) == (channel.topic, channel.message_encoding) and not channel.metadata:
        return channel
    # what is looked at (registry.is_static), and no more of it than recorders write: there may be 65,536 channels
    metadata = {key: channel.metadata[key][:4096] for key in METADATA if key in channel.metadata}
    return replace(channel, topic=topic, message_encoding=encoding, metadata=metadata)


def clean_schema(schema: Schema) -> Schema:
    """The same of a schema."""
    name, encoding = plain_name(schema.name), plain(schema.encoding)
    if (name, encoding) == (schema.name, schema.encoding):
        return schema
    return replace(schema, name=name, encoding=encoding)


def unpacked_message(channel: Channel, message: Message) -> Message:
    """The message, unpacked if a bag was recorded with compression of each message."""
    if channel.message_encoding in ("cdr", "ros1") and message.data[:4] == ZSTD:
        with suppress(zstandard.ZstdError):  # what cannot be unpacked cannot be decoded, and is said to be so there
            with zstandard.ZstdDecompressor().stream_reader(message.data) as stream:
                data = stream.read(limits().chunk_bytes + 1)
            return replace(message, data=data) if len(data) <= limits().chunk_bytes else message
    return message


def words(error: BaseException) -> str:
    if isinstance(error, CRCValidationError):
        return "checksum mismatch, bytes were changed"
    return str(error).strip().rstrip(".") or f"broken off ({type(error).__name__})"
