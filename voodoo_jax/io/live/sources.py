"""Sources of messages during recording: a growing MCAP file, or a Foxglove WebSocket (foxglove_bridge of ROS 2, or any
program with the Foxglove SDK).

Source of the protocol: https://github.com/foxglove/ws-protocol, docs/spec.md; the SDK's names itself foxglove.sdk.v1.
"""

import base64
import binascii
import json
import os
import struct
import threading
import time
from collections import deque
from typing import Any, BinaryIO, Protocol, runtime_checkable

from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from voodoo_jax.config.limited import TIME, limited, limits, too_large
from voodoo_jax.io.chunks import (
    READ_ERRORS,
    Budget,
    LogError,
    chunk_records,
    clean_channel,
    clean_schema,
    unpacked_message,
)
from voodoo_jax.io.container import MAGIC, Item, Reassembled, check_head, single_record
from voodoo_jax.io.decode.registry import kind_of

PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
DATA = struct.Struct("<BIQ")  # head of a message: 1, number of the subscription, log time in nanoseconds
MESSAGE = 1
# of schemas where the server does not say it, as the protocol has it
SCHEMA_ENCODINGS = {"cdr": "ros2msg", "ros1": "ros1msg", "json": "jsonschema"}
TEXTS = ("ros2msg", "ros1msg", "ros2idl", "omgidl", "jsonschema")  # schemas that are sent as they are
ITEM = 500  # bytes of memory of a message beside its content (measured)
OPEN_SECONDS = 10.0  # by hand
LOOK = 0.005  # seconds between two looks at a file that has not grown: far below a frame's time; by hand
URLS = ("ws://", "wss://")


class FoxgloveClient:
    """Subscribes to all usable topics of a server. Raises LogError without a server, or if the package `websockets` is
    missing."""

    def __init__(self, url: str, socket: Any = None):
        """`socket` an open connection, another one than to `url`."""
        try:
            from websockets.exceptions import WebSocketException
            from websockets.sync.client import connect
            from websockets.typing import Subprotocol
        except ImportError as problem:
            raise LogError(f"'{url}' needs the package websockets: pip install \"voodoo_jax[live]\"") from problem
        self.path, self.ended, self.notes = url, False, list[str]()
        self._said = dict[str, str]()  # notes, by what they are on
        self._waiting, self._bytes, self._there = deque[Item](), 0, threading.Condition()
        self._lost, self._of = 0, dict[int, tuple[Schema | None, Channel]]()
        self._room, self._most, self._unknown = limits().schemas_bytes, limits().memory // 2, 0
        try:
            self._socket: Any = socket
            if socket is None:
                self._socket = connect(
                    url, subprotocols=[Subprotocol(name) for name in PROTOCOLS], max_size=limits().chunk_bytes,
                    open_timeout=OPEN_SECONDS, compression=None,
                )  # fmt: skip
        except (OSError, WebSocketException, ValueError) as problem:
            raise LogError(
                f"'{url}': no connection: {problem}. Is the server (foxglove_bridge, or another one of "
                "Foxglove) running there?"
            ) from problem
        self._errors = WebSocketException, OSError, EOFError
        self._limits = limits()
        threading.Thread(target=self._receive, daemon=True).start()

    def poll(self, seconds: float) -> list[Item]:
        """See Source."""
        with self._there:
            self._there.wait_for(lambda: self._waiting or self._over, seconds)
            found = list(self._waiting)
            self._waiting.clear()
            self._bytes = 0
            self.ended = self.ended or self._over
        return found

    def close(self) -> None:
        self._socket.close()

    _over = False  # the connection has ended

    def _receive(self) -> None:
        """In a thread of its own: what comes is taken at once."""
        try:
            with limited(self._limits):
                for data in self._socket:
                    try:
                        self._heard(data) if isinstance(data, str) else self._got(data)
                    except self._errors:
                        raise
                    except Exception as problem:  # whatever a server sends costs itself only
                        self._unknown += 1
                        text = f"{type(problem).__name__}: {problem}"
                        self._said["unknown"] = f"{self._unknown} messages cannot be understood (the last: {text})."
                        self.notes[:] = self._said.values()
        except self._errors as problem:
            self._said["end"] = f"The connection ended: {problem}."
            self.notes[:] = self._said.values()
        finally:
            with self._there:
                self._over = True
                self._there.notify()

    def _heard(self, text: str) -> None:
        """A message of the protocol itself."""
        if trouble := too_large("what it says has", len(text), "schemas_bytes", "characters"):
            raise ValueError(trouble)
        said, wanted = json.loads(text), []
        for one in list(said["channels"]) if said["op"] == "advertise" else ():
            try:
                schema, channel = _described(one)
            except (KeyError, TypeError, ValueError, OverflowError):
                continue
            if channel.id not in self._of and len(self._of) < limits().topics and kind_of(schema, channel):
                self._room -= len(schema.data) if schema is not None else 0
                if self._room < 0:
                    raise ValueError(too_large("all schemas have over", limits().schemas_bytes + 1, "schemas_bytes"))
                self._of[channel.id] = schema, channel
                wanted.append({"id": channel.id, "channelId": channel.id})
        if wanted:
            self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def _got(self, data: bytes) -> None:
        """A message of a topic."""
        if len(data) < DATA.size or data[0] != MESSAGE:
            return
        _, number, log_time = DATA.unpack_from(data)
        if number not in self._of:
            return
        schema, channel = self._of[number]
        # servers without a clock of their own say 0
        log_time = log_time if 0 < log_time < TIME else time.time_ns()
        message = Message(channel.id, log_time, data[DATA.size :], log_time, 0)
        with self._there:
            self._waiting.append((schema, channel, unpacked_message(channel, message)))
            self._bytes += len(self._waiting[-1][2].data) + ITEM
            while self._bytes > self._most:
                self._bytes -= len(self._waiting.popleft()[2].data) + ITEM
                self._lost += 1
                self._said["lost"] = f"{self._lost} messages came faster than they were processed, and were dropped."
                self.notes[:] = self._said.values()
            self._there.notify()


def _described(one: dict[str, Any]) -> tuple[Schema | None, Channel]:
    """Schema and channel that a server advertises. Raises KeyError, TypeError or ValueError."""
    number, encoding = int(one["id"]), str(one["encoding"])
    kind = str(one.get("schemaEncoding") or SCHEMA_ENCODINGS.get(encoding, encoding))
    text = str(one.get("schema", ""))
    try:
        data = text.encode() if kind in TEXTS else base64.b64decode(text, validate=True)
    except binascii.Error as problem:
        raise ValueError("a schema that is not base64") from problem
    schema = clean_schema(Schema(id=number + 1, name=str(one["schemaName"]), encoding=kind, data=data))
    return schema, clean_channel(
        Channel(id=number, topic=str(one["topic"]), message_encoding=encoding, metadata={}, schema_id=number + 1)
    )


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
    return FoxgloveClient(place) if place.startswith(URLS) else GrowingFile(place, idle)


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
            records = (
                chunk_records(body, Budget(len(body)))[0] if opcode == Opcode.CHUNK else single_record(opcode, body)
            )
            return list(self._records.items(records))
        except READ_ERRORS as error:
            self._bad += 1
            self.notes[:] = [f"{self._bad} chunks cannot be read (the last one: {error})."]
        return []
