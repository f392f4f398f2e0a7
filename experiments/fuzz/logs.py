"""Small logs that can be changed part by part, and written with lies in them."""

import struct
from collections.abc import Callable, Iterable
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from experiments.fuzz import mcap_bytes as mcap
from voodoo_jax.io.log_reader import open_log

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
U16, U32, U64 = 2**16 - 1, 2**32 - 1, 2**64 - 1


@dataclass(frozen=True)
class Message:
    """One message."""

    channel: int
    time: int  # of the log, nanoseconds
    data: bytes


@dataclass(frozen=True)
class Log:
    """What is in a log: schemas (name, encoding, text) and channels (topic, encoding, schema) by number, messages."""

    schemas: dict[int, tuple[str, str, bytes]]
    channels: dict[int, tuple[str | bytes, str, int]]
    messages: tuple[Message, ...]

    def number(self, topic: str) -> int:
        """Of a topic's channel."""
        return next(n for n, c in self.channels.items() if c[0] == topic)

    def of(self, topic: str) -> list[Message]:
        """Messages of a topic."""
        return [m for m in self.messages if m.channel == self.number(topic)]

    def changed(self, topic: str, change: Callable[[bytes, int], bytes], only: Iterable[int] | None = None) -> "Log":
        """With other contents of a topic's messages: all, or those of some numbers."""
        mine, count, out = self.number(topic), 0, []
        chosen = None if only is None else set(only)
        for m in self.messages:
            if m.channel == mine:
                touched = chosen is None or count in chosen
                m, count = replace(m, data=change(m.data, count)) if touched else m, count + 1
            out.append(m)
        return replace(self, messages=tuple(out))

    def renamed(self, topic: str, to: str | bytes | None = None, encoding: str | None = None) -> "Log":
        """With another name or encoding of a channel."""
        n = self.number(topic)
        name, how, schema = self.channels[n]
        new = name if to is None else to, how if encoding is None else encoding, schema
        return replace(self, channels={**self.channels, n: new})

    def typed(self, topic: str, **parts: Any) -> "Log":
        """With another name, encoding or text of a channel's schema."""
        n = self.channels[self.number(topic)][2]
        old = dict(zip(("name", "encoding", "text"), self.schemas[n]))
        return replace(self, schemas={**self.schemas, n: tuple((old | parts).values())})

    def without(self, *topics: str) -> "Log":
        """Without some topics."""
        gone = {self.number(topic) for topic in topics}
        channels = {n: c for n, c in self.channels.items() if n not in gone}
        return replace(self, channels=channels, messages=tuple(m for m in self.messages if m.channel not in gone))

    def added(self, topic: str, kind: tuple[str, str, bytes], encoding: str, items: list[tuple[int, bytes]]) -> "Log":
        """With one more topic: type (name, encoding, text), and messages (log time, content)."""
        s, c = max(self.schemas) + 1, max(self.channels) + 1
        more = [Message(c, time, data) for time, data in items]
        messages = tuple(sorted((*self.messages, *more), key=lambda m: m.time))
        return Log({**self.schemas, s: kind}, {**self.channels, c: (topic, encoding, s)}, messages)


@dataclass(frozen=True)
class Style:
    """How a log is written."""

    how: str = ""  # compression
    crc: bool = True  # with checksums
    index: bool = True
    per_chunk: int = 8  # messages
    lies: dict[str, Any] = field(default_factory=dict)  # of the second chunk: size, length, record, how, body
    before: bytes = b""  # records before the chunks, in the first one, and after them
    inside: bytes = b""
    after: bytes = b""


def written(log: Log, style: Style | None = None) -> bytes:
    """The file."""
    s = style or Style()
    schemas = {n: mcap.schema(n & U16, *parts) for n, parts in log.schemas.items()}
    channels = {n: mcap.channel(n & U16, c[2], c[0], c[1]) for n, c in log.channels.items()}
    out, indexes, known = mcap.MAGIC + mcap.record(mcap.HEADER, mcap.text("ros2") * 2) + s.before, [], set()
    for k, at in enumerate(range(0, len(log.messages), s.per_chunk)):
        group = log.messages[at : at + s.per_chunk]
        data = b"" if k else s.inside + b"".join(mcap.record(mcap.SCHEMA, body) for body in schemas.values())
        for m in group:
            if m.channel in channels and m.channel not in known:
                data += mcap.record(mcap.CHANNEL, channels[m.channel])
                known.add(m.channel)
            data += mcap.record(mcap.MESSAGE, mcap.message(m.channel & U16, m.time & U64, m.data))
        times = min(m.time for m in group) & U64, max(m.time for m in group) & U64
        made = _chunk(data, times, s, s.lies if k == 1 else {})
        index = struct.pack("<QQQQ", *times, len(out), len(made)) + mcap.offsets({m.channel: len(out) for m in group})
        index += struct.pack("<Q", 0) + mcap.text(s.how) + struct.pack("<QQ", len(made), len(data))
        indexes.append(mcap.record(mcap.CHUNK_INDEX, index))
        out += made
    out += s.after + mcap.record(mcap.DATA_END, bytes(4))
    start = len(out)
    if s.index:
        out += b"".join(mcap.record(mcap.SCHEMA, body) for body in schemas.values())
        out += b"".join(mcap.record(mcap.CHANNEL, body) for body in channels.values())
        each = {n: sum(m.channel == n for m in log.messages) for n in log.channels}
        logged = [m.time & U64 for m in log.messages] or [0]
        counts = len(log.messages), len(schemas) & U16, len(channels), 0, 0, len(indexes)
        out += mcap.record(mcap.STATISTICS, mcap.statistics(counts, (min(logged), max(logged)), each))
        out += b"".join(indexes)
    return out + mcap.record(mcap.FOOTER, struct.pack("<QQI", start if s.index else 0, 0, 0)) + mcap.MAGIC


def _chunk(data: bytes, times: tuple[int, int], style: Style, lies: dict[str, Any]) -> bytes:
    crc = None if style.crc and "body" not in lies else 0
    body = mcap.chunk(data, times, style.how, crc, lies.get("size"), lies.get("body"))
    at = 32 + len(style.how)  # of the length of what is packed
    if "length" in lies:
        body = body[:at] + struct.pack("<Q", lies["length"]) + body[at + 8 :]
    if "how" in lies:
        body = body[:28] + mcap.text(lies["how"]) + body[at:]
    return mcap.record(mcap.CHUNK, body, lies.get("record"))


def cdr(message: Any) -> bytes:
    """A message of ROS 2 as it lies in a log."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def ros(name: str) -> tuple[str, str, bytes]:
    """A type of ROS 2 as a log has it."""
    return name, "ros2msg", STORE.generate_msgdef(name, ros_version=2)[0].encode()


@dataclass(frozen=True)
class Base:
    """A small sound log of one depth camera, and its messages."""

    log: Log
    depth: str
    info: str
    tf: str = "/tf_static"

    def parsed(self, topic: str) -> list[Any]:
        """Messages of a topic."""
        name = self.log.schemas[self.log.channels[self.log.number(topic)][2]][0]
        return [deepcopy(STORE.deserialize_cdr(m.data, name)) for m in self.log.of(topic)]

    @cached_property
    def images(self) -> list[Any]:
        return self.parsed(self.depth)

    @cached_property
    def times(self) -> list[int]:
        return [m.time for m in self.log.of(self.depth)]

    def header(self, number: int) -> Any:
        """Of an image."""
        return deepcopy(self.images[number].header)

    def edited(self, topic: str, change: Callable[[Any, int], None], only: Iterable[int] | None = None) -> Log:
        """With other messages of ROS 2."""
        name = self.log.schemas[self.log.channels[self.log.number(topic)][2]][0]

        def one(data: bytes, number: int) -> bytes:
            message = deepcopy(STORE.deserialize_cdr(data, name))
            with np.errstate(all="ignore"):
                change(message, number)
            return cdr(message)

        return self.log.changed(topic, one, only)

    def instead(self, topic: str, kind: tuple[str, str, bytes], encoding: str, make: Callable[[int], bytes]) -> Log:
        """With another topic in place of the depth images."""
        items = [(time, make(n)) for n, time in enumerate(self.times)]
        return self.log.without(self.depth).added(topic, kind, encoding, items)

    @cached_property
    def clouds(self) -> list[np.ndarray]:
        """[point, 3] of each image, metres, in the camera's frame."""
        k = self.parsed(self.info)[0].k.reshape(3, 3)
        found = []
        for image in self.images:
            z = image.data.view("<u2").reshape(image.height, image.width) / 1000
            v, u = np.mgrid[0 : image.height, 0 : image.width]
            points = np.stack([(u - k[0, 2]) / k[0, 0] * z, (v - k[1, 2]) / k[1, 1] * z, z], -1)
            found.append(points[z > 0])
        return found


def base_of(path: Path, frames: int) -> Base:
    """The beginning of a log with one depth camera: so many of its images (16 bits), their calibration, fixed
    transforms."""
    topics = open_log(path).sensors
    schemas, channels, messages, number = {}, {}, [], 0
    with open(path, "rb") as stream:
        for schema, channel, m in make_reader(stream).iter_messages():
            number += channel.topic == topics[0]
            if schema is not None and number <= frames:
                schemas[schema.id] = schema.name, schema.encoding, bytes(schema.data)
                channels[channel.id] = channel.topic, channel.message_encoding, channel.schema_id
                messages.append(Message(channel.id, m.log_time, bytes(m.data)))
    info = next(c[0] for c in channels.values() if schemas[c[2]][0] == "sensor_msgs/msg/CameraInfo")
    return Base(Log(schemas, channels, tuple(messages)), topics[0], str(info))
