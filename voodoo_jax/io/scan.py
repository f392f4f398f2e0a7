"""The first pass over a log: what each topic holds, and what replay can use it for."""

import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from voodoo_jax.io import camera
from voodoo_jax.io.container import READ_ERRORS, Item, LogError, LogFile
from voodoo_jax.io.decode import (
    DECODE_ERRORS,
    Calibration,
    Decoder,
    Image,
    is_static,
    kind_of,
    quick_stamp,
    reason_unused,
)
from voodoo_jax.io.transforms import TransformTree
from voodoo_jax.settings import ReadSettings

DEPTH_USES = ("depth image", "point cloud")


@dataclass
class Topic:
    """What the first pass learns of a topic."""

    type: str
    encoding: str
    kind: str
    why_not: str
    stamps: list[int] = field(default_factory=list)
    log_times: list[int] = field(default_factory=list)
    sample: Any = None  # first message that could be decoded
    error: str = ""  # why the first broken message could not be
    broken: int = 0
    calibration: Calibration | None = None
    count: int = 0
    stated: int = 0  # number of messages by the file's own statistics


def guarded(log: LogFile, wanted: Callable[[Schema | None, Channel], bool]) -> Iterator[Item]:
    """The messages of a log; what goes wrong below the level of chunks (a failing disk) comes out as LogError."""
    try:
        yield from log.messages(wanted)
    except READ_ERRORS as error:
        raise LogError(f"'{log.path}' cannot be read: {error}. Check the disk, and copy the file again.") from error


def many(n: int) -> str:
    return "1 message" if n == 1 else f"{n} messages"


class Scan:
    """The first pass over a log.

    `topics` by name; `uses`: what replay takes each for, or "not used: <reason>"; `tree`: the transforms; `log_times`:
    first and last, nanoseconds; `notes`: what was odd. Raises LogError if nothing can be read, or if a topic that
    `settings` name is not in the log.
    """

    def __init__(self, path: str | os.PathLike[str], settings: ReadSettings):
        self.log = LogFile(path)
        self.topics: dict[str, Topic] = {}
        self.tree = TransformTree()
        self.notes: list[str] = []
        self.log_times: tuple[int, int] | None = None
        self._decoder = Decoder()
        # Without statistics the only way to know the number of messages is to read them all.
        everything = self.log.declared is None
        wanted = lambda s, c: everything or bool(kind_of(s, c))  # noqa: E731
        for schema, channel, message in guarded(self.log, wanted):
            first, last = self.log_times or (message.log_time, message.log_time)
            self.log_times = min(first, message.log_time), max(last, message.log_time)
            topic = self._topic(schema, channel)
            topic.count += 1
            if schema is not None and topic.kind and kind_of(schema, channel) == topic.kind:
                self._take(topic, schema, channel, message)
        self.tree.close()
        self._count()
        if not self.topics:
            damage = " ".join(self.log.damage)
            raise LogError(f"'{self.log.path}' holds no messages. {damage or 'Nothing was recorded.'}")
        self.uses = self._uses(settings)

    def _topic(self, schema: Schema | None, channel: Channel) -> Topic:
        if channel.topic not in self.topics:
            encoding = "/".join(filter(None, [channel.message_encoding, schema.encoding if schema else ""]))
            name, why = schema.name if schema else "?", reason_unused(schema, channel)
            self.topics[channel.topic] = Topic(name, encoding, kind_of(schema, channel), why)
        return self.topics[channel.topic]

    def _take(self, topic: Topic, schema: Schema, channel: Channel, message: Any) -> None:
        content, stamp = None, quick_stamp(channel, message.data)
        depth = topic.kind in ("image", "point cloud")
        if topic.sample is None or stamp is None or not depth:
            try:
                content = self._decoder.message(schema, channel, message.data)
            except DECODE_ERRORS as error:
                topic.broken += 1
                topic.error = topic.error or f"{type(error).__name__}: {error}"
        if content is not None and topic.sample is None:
            topic.sample = content
        if isinstance(content, list):
            for transform in content:
                self.tree.add(transform, is_static(schema, channel))
        elif isinstance(content, Calibration):
            old = topic.calibration
            if old is None or (old.K[0, 0] == 0 and content.K[0, 0] != 0):
                topic.calibration = content
            elif content.K[0, 0] != 0 and not (np.array_equal(old.K, content.K) and np.array_equal(old.D, content.D)):
                note = f"The calibration on '{channel.topic}' changes during the log; its first value is used."
                if note not in self.notes:
                    self.notes.append(note)
        elif depth:
            if content is not None:
                stamp = content.stamp_ns
            topic.stamps.append(message.log_time if stamp is None else stamp)
            topic.log_times.append(message.log_time)

    def _count(self) -> None:
        """Number of messages per topic as the file states it, and a note where fewer were found."""
        log = self.log
        for channel in log.channels.values():
            self._topic(log.schemas.get(channel.schema_id), channel)
        stated: Counter[str] = Counter()
        for i, n in (log.declared or {}).items():
            if i in log.channels:
                stated[log.channels[i].topic] += n
        self.notes += log.damage
        for name, topic in self.topics.items():
            topic.stated = stated[name]
            if topic.kind and topic.count < stated[name]:
                lost = stated[name] - topic.count
                self.notes.append(f"'{name}': kept {topic.count} of {stated[name]} messages, {lost} cannot be read.")
            elif not topic.kind:
                topic.count = max(topic.count, stated[name])
            if topic.broken and topic.kind in ("calibration", "transforms"):
                self.notes.append(f"'{name}': {many(topic.broken)} cannot be decoded ({topic.error}).")

    def _uses(self, settings: ReadSettings) -> dict[str, str]:
        """What each topic is used as; a camera that gives both an image and a cloud is used once."""
        uses = {}
        for name, topic in self.topics.items():
            uses[name] = topic.kind if topic.kind in ("calibration", "transforms") else f"not used: {topic.why_not}"
            if topic.kind in ("image", "point cloud"):
                uses[name] = self._depth_use(name, topic)
        if settings.topics:
            depth = [name for name, use in uses.items() if use in DEPTH_USES]
            for name in settings.topics:
                if name not in depth:
                    why = f" ({uses[name]})" if name in uses else ""
                    raise LogError(
                        f"'{self.log.path}' has no depth topic '{name}'{why}. It has: {', '.join(depth) or 'none'}."
                    )
            return {n: "not used: not among the topics asked for" if n in depth and n not in settings.topics else use
                    for n, use in uses.items()}  # fmt: skip
        order = {"depth image": 0, "point cloud": 1}
        seen: dict[str, str] = {}
        ranked = sorted((n for n in uses if uses[n] in order), key=lambda n: (self._is_mono(n), order[uses[n]], n))
        for name in ranked:
            frame = self.topics[name].sample.frame
            # Two clouds of one frame may be two sensors given in a common frame, so only images shadow others.
            first = seen.get(frame)
            if first and (uses[first] == "depth image" or self._is_mono(name)):
                uses[name] = f"not used: the same camera as '{first}' (frame '{frame}')"
                self.notes.append(f"'{name}' is left out: it is the same camera as '{first}' (frame '{frame}').")
            seen.setdefault(frame, name)
        return uses

    def _is_mono(self, name: str) -> bool:
        sample = self.topics[name].sample
        return isinstance(sample, Image) and sample.encoding.upper() == "MONO16"

    def _depth_use(self, name: str, topic: Topic) -> str:
        if topic.count == 0:
            return (
                f"not used: none of its {topic.stated} messages can be read"
                if topic.stated
                else "not used: no messages"
            )
        if topic.sample is None:
            return f"not used: no message can be decoded ({topic.error})"
        if topic.kind == "point cloud":
            return "point cloud"
        if topic.sample.raw is None:
            return f"not used: encoding {topic.sample.encoding} is not a depth image"
        tokens = name.lower().replace("/", "_").split("_")
        if self._is_mono(name) and {"ir", "infra", "infra1", "infra2", "infrared", "amplitude", "intensity"} & {
            *tokens
        }:
            return "not used: brightness, to judge by its name"
        calibration = self.calibration(name)
        if calibration is None:
            return f"not used: a depth image without calibration (none for frame '{topic.sample.frame}')"
        try:
            # A small part is enough to learn whether the lens model is known.
            camera.pixel_rays(calibration.K, calibration.D, calibration.model, 2, 2)
        except ValueError as error:
            return f"not used: a depth image whose calibration is unusable: {error}"
        return "depth image"

    def calibration(self, name: str) -> Calibration | None:
        """That of the same frame, else of the same namespace; then the one of the same size."""
        image: Image = self.topics[name].sample
        space = name.rsplit("/", 1)[0]
        found = []
        for other, topic in self.topics.items():
            c = topic.calibration
            if c is not None and (c.frame == image.frame or other.rsplit("/", 1)[0] == space):
                key = (
                    c.frame != image.frame,
                    (c.height, c.width) != image.shape,
                    other.rsplit("/", 1)[0] != space,
                    other,
                )
                found.append((key, c))
        return min(found, key=lambda pair: pair[0])[1] if found else None
