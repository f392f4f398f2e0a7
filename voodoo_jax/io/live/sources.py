"""Sources of messages during recording: a growing MCAP file, or a Foxglove WebSocket."""

import os
import struct
import time
from io import BytesIO
from typing import BinaryIO, Protocol, runtime_checkable

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from voodoo_jax.io.chunks import (
    READ_ERRORS,
    Budget,
    LogError,
    chunk_records,
    clean_channel,
    clean_schema,
    unpacked_message,
)
from voodoo_jax.io.container import MAGIC, Item, check_head
from voodoo_jax.io.limits import TIME, limits

LOOK = 0.005  # seconds between two looks at a file that has not grown: far below a frame's time; by hand
URLS = ("ws://", "wss://")


@runtime_checkable
class Source(Protocol):
    """Yields messages as they arrive."""

    path: str
    ended: bool  # nothing more will come
    notes: list[str]  # what could not be read, a sentence each

    def poll(self, seconds: float) -> list[Item]:
        """Messages since the last call; waits for at most the given time if there are none."""
        ...

    def close(self) -> None: ...


def open_source(place: str, idle: float) -> Source:
    """Opens a file or folder, or a Foxglove WebSocket.

    **Arguments:** `idle` seconds without growth after which a file is finished. Raises LogError.
    """
    if place.startswith(URLS):
        from voodoo_jax.io.live.foxglove_client import FoxgloveClient

        return FoxgloveClient(place)
    return GrowingFile(place, idle)


class Reassembled:
    """Makes messages, with channels and schemas, from records of an MCAP file."""

    def __init__(self):
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._room = limits().schemas_bytes

    def items(self, records: list) -> list[Item]:
        """The messages of some successive records, such as those of a chunk, in order of log time."""
        held: list[Message] = []
        for record in records:
            if isinstance(record, Message):
                held.append(record)
            elif isinstance(record, Schema):
                self._learn(record)
            elif isinstance(record, Channel):
                self._channels.setdefault(record.id, clean_channel(record))
        held.sort(key=lambda message: message.log_time)
        found = []
        for message in held:
            channel = self._channels.get(message.channel_id)
            if channel is not None and message.log_time < TIME:
                found.append((self._schemas.get(channel.schema_id), channel, unpacked_message(channel, message)))
        return found

    def _learn(self, record: Schema) -> None:
        if record.id in self._schemas:
            return
        self._room -= len(record.data)
        if self._room >= 0:
            self._schemas[record.id] = clean_schema(record)


class GrowingFile:
    """An MCAP file that a recorder still writes, read up to its last whole record. In a folder of `ros2 bag record`,
    the newest file, and those that follow it.

    Raises LogError if the file is missing or is not MCAP.
    """

    def __init__(self, path: str, idle: float):
        self.path, self.ended, self.notes = path, False, list[str]()
        self._idle, self._grown = idle, time.monotonic()
        self._stream: BinaryIO | None = None
        self._complete = False  # whether the present file has come to its end
        self._done: set[str] = set()  # files of the folder that are read
        self._bad = 0  # chunks that cannot be read
        self._next()

    def poll(self, seconds: float) -> list[Item]:
        """See Source. Raises LogError if the data is not MCAP."""
        until = time.monotonic() + seconds
        while True:
            found = self._read()
            if found or self.ended:
                return found
            now = time.monotonic()
            if now - self._grown > self._idle:
                self.ended = True
                return []
            if now >= until:
                return []
            time.sleep(LOOK)

    def close(self) -> None:
        if self._stream is not None:
            self._stream.close()

    def _next(self) -> bool:
        """Begins with the next file of a folder, or with the one there is; whether there is one."""
        path = self.path
        if os.path.isdir(path):
            names = sorted(name for name in os.listdir(path) if name.endswith(".mcap"))
            left = [name for name in names if os.path.join(path, name) not in self._done]
            if not left:
                if not self._done:
                    raise LogError(f"The folder '{path}' has no .mcap file. Was the recording started?")
                return False
            path = os.path.join(path, left[0] if self._done else left[-1])
            self._done |= {os.path.join(self.path, name) for name in names if not self._done and name != left[-1]}
        elif self._done:
            return False
        self._done.add(path)
        self.close()
        self._file, self._at, self._records, self._complete = path, 0, Reassembled(), False
        check_head(path, path, growing=True)
        self._stream = open(path, "rb")
        return True

    def _read(self) -> list[Item]:
        """The messages of all whole records that have come; of one chunk at a time, so that none waits for others."""
        if self._complete:  # of a folder: until another file is begun, or for as long as one waits for growth
            if not self._next():
                self.ended = self.ended or not os.path.isdir(self.path)
                return []
        assert self._stream is not None
        if self._at == 0:
            self._stream.seek(0)
            head = self._stream.read(len(MAGIC))
            if len(head) < len(MAGIC):
                return []
            check_head(self._file, self._file)
            self._at, self._grown = len(MAGIC), time.monotonic()
        found: list[Item] = []
        while not found and not self.ended and not self._complete:
            self._stream.seek(self._at)
            head = self._stream.read(9)
            if len(head) < 9:
                break
            opcode, length = struct.unpack("<BQ", head)
            if length > 2 * limits().chunk_bytes:
                raise LogError(f"'{self._file}' is damaged: the record at byte {self._at} has an impossible length.")
            body = self._stream.read(length)
            if len(body) < length:
                break
            self._at, self._grown = self._at + 9 + length, time.monotonic()
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                self._complete = True
            else:
                found = self._items(opcode, body)
        return found

    def _items(self, opcode: int, body: bytes) -> list[Item]:
        try:
            if opcode == Opcode.CHUNK:
                return self._records.items(chunk_records(body, Budget(len(body)))[0])
            if opcode == Opcode.SCHEMA:
                return self._records.items([Schema.read(ReadDataStream(BytesIO(body)))])
            if opcode == Opcode.CHANNEL:
                return self._records.items([Channel.read(ReadDataStream(BytesIO(body)))])
            if opcode == Opcode.MESSAGE:
                return self._records.items([Message.read(ReadDataStream(BytesIO(body)), len(body))])
        except READ_ERRORS as error:
            self._bad += 1
            self.notes[:] = [f"{self._bad} chunks cannot be read (the last one: {error})."]
        return []
