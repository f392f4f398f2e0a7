"""A client of a Foxglove WebSocket: foxglove_bridge of ROS 2, or any program with the Foxglove SDK.

Source: https://github.com/foxglove/ws-protocol, docs/spec.md; the SDK's protocol names itself foxglove.sdk.v1.
"""

import base64
import binascii
import json
import struct
import threading
import time
from collections import deque
from typing import Any

from mcap.records import Channel, Message, Schema

from voodoo_jax.io.chunks import LogError, clean_channel, clean_schema, unpacked_message
from voodoo_jax.io.container import Item
from voodoo_jax.io.decode.registry import kind_of
from voodoo_jax.io.limits import TIME, limited, limits, too_large

PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
DATA = struct.Struct("<BIQ")  # head of a message: 1, number of the subscription, log time in nanoseconds
MESSAGE = 1
# of schemas where the server does not say it, as the protocol has it
SCHEMA_ENCODINGS = {"cdr": "ros2msg", "ros1": "ros1msg", "json": "jsonschema"}
TEXTS = ("ros2msg", "ros1msg", "ros2idl", "omgidl", "jsonschema")  # schemas that are sent as they are
ITEM = 500  # bytes of memory of a message beside its content (measured)
OPEN_SECONDS = 10.0  # by hand


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
