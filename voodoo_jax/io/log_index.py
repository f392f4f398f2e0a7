"""The first pass over a log: what each topic holds, and what replay can use it for."""

import os
from collections import Counter
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.container import LogError, LogFile, guarded
from voodoo_jax.io.decode.colour import COLOUR_KIND
from voodoo_jax.io.decode.registry import (
    DECODE_ERRORS,
    DEPTH_KINDS,
    FEATURE_KINDS,
    Decoder,
    is_static,
    kind_of,
    quick_stamp,
    reason_unused,
)
from voodoo_jax.io.landmark_table import gather
from voodoo_jax.io.skin_rays import SKIN_USE, skin_topics
from voodoo_jax.io.stereo_pairs import STEREO_USE, find_pairs
from voodoo_jax.io.topic import Topic
from voodoo_jax.io.topic_roles import decide_uses
from voodoo_jax.io.transforms import TransformTree
from voodoo_jax.records.messages import Calibration, Features, Image, many


class Scan:
    """The first pass over a log.

    `topics` by name; `uses`: what replay takes each for, or "not used: <reason>"; `stereo`: the pairs among them;
    `skin`: calibrations of the images in which skin is looked for, by topic; `tree`: the transforms; `log_times`: first
    and last, nanoseconds; `notes`: what was odd. Raises LogError if nothing can be read, or if a topic that
    `settings` name is not in the log.
    """

    def __init__(self, path: str | os.PathLike[str], settings: ReadSettings):
        self.log = LogFile(path)
        self.topics: dict[str, Topic] = {}
        self.tree = TransformTree()
        self.notes: list[str] = []
        self.log_times: tuple[int, int] | None = None
        self._decoder = Decoder()
        self._off = (() if settings.features else FEATURE_KINDS) + (() if settings.laser else ("laser scan",))
        # Without statistics the only way to know the number of messages is to read them all.
        everything = self.log.declared is None
        wanted = lambda s, c: everything or bool(self.kind(s, c))  # noqa: E731
        for schema, channel, message in guarded(self.log, wanted):
            first, last = self.log_times or (message.log_time, message.log_time)
            self.log_times = min(first, message.log_time), max(last, message.log_time)
            topic = self._topic(schema, channel)
            topic.count += 1
            if schema is not None and topic.kind and self.kind(schema, channel) == topic.kind:
                self._take(topic, schema, channel, message)
        self.tree.close()
        self._count()
        if not self.topics:
            damage = " ".join(self.log.damage)
            raise LogError(f"'{self.log.path}' holds no messages. {damage or 'Nothing was recorded.'}")
        for name, topic in self.topics.items():
            if topic.kind in FEATURE_KINDS:
                topic.gathered = gather(name, topic.features, topic.log_times, self.notes)
                topic.features.clear()
        pairs = find_pairs(self.topics, self.tree) if settings.stereo else []
        self.uses = decide_uses(self.log.path, self.topics, settings, self.notes, pairs)
        self.skin, notes = skin_topics(self.topics, self.uses) if settings.skin else ({}, [])
        self.notes += notes
        self.uses |= {name: SKIN_USE for name in self.skin if self.uses[name].startswith("not used")}
        self.stereo = [pair for pair in pairs if self.uses[pair.left] == STEREO_USE]

    def kind(self, schema: Schema | None, channel: Channel) -> str:
        """What a channel may be used for; "" also for what is switched off."""
        kind = kind_of(schema, channel)
        known = self.topics.get(channel.topic)
        if kind == COLOUR_KIND and known is not None and known.kind in DEPTH_KINDS:
            kind = known.kind  # its compressed images turned out to be of depth
        return "" if kind in self._off else kind

    def _topic(self, schema: Schema | None, channel: Channel) -> Topic:
        if channel.topic not in self.topics:
            encoding = "/".join(filter(None, [channel.message_encoding, schema.encoding if schema else ""]))
            name, why = schema.name if schema else "?", reason_unused(schema, channel)
            self.topics[channel.topic] = Topic(name, encoding, self.kind(schema, channel), why)
        return self.topics[channel.topic]

    def _take(self, topic: Topic, schema: Schema, channel: Channel, message: Any) -> None:
        content, stamp = None, quick_stamp(channel, message.data)
        depth = topic.kind in (*DEPTH_KINDS, COLOUR_KIND)
        if topic.sample is None or stamp is None or not depth:
            try:
                content = self._decoder.message(schema, channel, message.data)
            except DECODE_ERRORS as error:
                topic.broken += 1
                topic.error = topic.error or f"{type(error).__name__}: {error}"
        if content is not None and topic.sample is None:
            topic.sample = content
            if isinstance(content, Image) and topic.kind == COLOUR_KIND:
                topic.kind = "image"
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
        elif isinstance(content, Features):
            topic.features.append(content)
            topic.log_times.append(message.log_time)
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
            if topic.broken and topic.kind in ("calibration", "transforms", *FEATURE_KINDS):
                self.notes.append(f"'{name}': {many(topic.broken)} cannot be decoded ({topic.error}).")
