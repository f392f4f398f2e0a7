"""The first pass over a log: what each topic holds, and what replay can use it for."""

import os
from collections import Counter
from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from voodoo_jax.config.limited import TIME, limits
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.config.toml import check_pairs
from voodoo_jax.io.clocks import Stamps, note_of, shifts
from voodoo_jax.io.container import Item, LogError, LogFile, Place, guarded
from voodoo_jax.io.decode.image_codec import COLOUR_KIND
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
from voodoo_jax.io.given import given_cameras, given_transforms
from voodoo_jax.io.landmark_table import Gathered, gather, unit_of, without_held, without_placeholders
from voodoo_jax.io.point_order import in_known_order
from voodoo_jax.io.several_files import open_files
from voodoo_jax.io.stereo_pairs import STEREO_USE, Pair, find_pairs
from voodoo_jax.io.topic import POSE_USE, SKIN_USE, Topic, Unused
from voodoo_jax.io.topic_roles import UNSEARCHED, camera_topics, decide_uses
from voodoo_jax.io.transforms import Moving, Transform, TransformTree
from voodoo_jax.records.messages import PAIRS, Calibration, Features, Image, Unusable, many, moved
from voodoo_jax.records.notes import plain
from voodoo_jax.storage.urls import bag_of

LONG = 300  # characters of an error that are kept


@dataclass(frozen=True)
class Known:
    """What an earlier look at the same recording has settled: for a look at what came after."""

    topics: dict[str, Topic]
    uses: dict[str, str]
    skin: dict[str, Calibration]
    stereo: list[Pair]
    shifts: dict[str, int]  # see Scan
    transforms: list[tuple[Transform, bool]]  # those that hold without being said again, and whether they are static
    decoder: Decoder

    def bare_topics(self) -> dict[str, Topic]:
        """The topics without their messages."""
        emptied = {"stamps": [], "log_times": [], "features": [], "gathered": None, "count": 0, "broken": 0}
        return {
            name: replace(topic, **{key: value[:] if value == [] else value for key, value in emptied.items()})
            for name, topic in self.topics.items()
        }


class Scan:
    """The first pass over a log, or over what has come of one since it was first looked at (`known`).

    `topics` by name; `uses`: what replay takes each for, or "not used: <reason>"; `stereo`: the pairs among them;
    `skin`: calibrations of the images in which skin is looked for, by topic; `tree`: the transforms; `log_times`: first
    and last, nanoseconds; `notes`: what was odd. Raises LogError if nothing can be read, or if a topic that
    `settings` name is not in the log.
    """

    def __init__(self, path: Place | LogFile, settings: ReadSettings, known: "Known | None" = None):
        self.log = path if isinstance(path, LogFile) else open_files(path)
        self.topics: dict[str, Topic] = known.bare_topics() if known else {}
        cameras = given_cameras(settings.camera)
        self.tree = TransformTree()
        self.notes: list[str] = []
        self.part_of = ""  # if others were recorded with it, what to do
        folder, files = ("", []) if known else bag_of(self.log.path)
        if folder:
            self.part_of = (
                f"This is one of the {len(files)} files of a recording, and what was sent once may be in another: give "
                f"the folder '{os.path.basename(folder)}' to read them as one."
            )
            self.notes.append(self.part_of)
        for transform in given_transforms(settings.transform):
            self.tree.give(transform)
        for transform, static in known.transforms if known else ():
            self.tree.add(transform, static)
        self.log_times: tuple[int, int] | None = None
        self._decoder, self._too_many = known.decoder if known else Decoder(), False
        self._names: set[str] = set()  # of features
        self._moving: dict[tuple[str, str], Moving] = {}  # by topic and child
        self.moves: dict[str, str] = {}  # the topic that says where a frame moves, by frame
        self._transforms = self._features = 0  # how many there are
        self._foreign: dict[str, str] = {}  # topics whose clock is not the others', and why they cannot be used
        self._off = (() if settings.features else FEATURE_KINDS) + (() if settings.laser else ("laser scan",))
        self._pass()
        if self.log.set_backs:
            self.notes.append(note_of(self.log.set_backs))
        self.units: dict[str, float] = {}  # metres, of topics of named points
        self.shifts: dict[str, int] = known.shifts if known else {}  # nanoseconds, by topic, or by topic and child
        self._bring_clocks_together(settings, bool(known))
        self.tree.close()
        self._count()
        if not self.topics:
            damage = " ".join(self.log.damage)
            what = "holds no messages and is damaged" if damage else "holds no messages"
            raise LogError(f"'{self.log.path}' {what}. {damage or 'Nothing was recorded.'}")
        for name, topic in self.topics.items():
            if topic.kind in FEATURE_KINDS:
                found = gather(name, topic.features, topic.log_times, self.notes)
                topic.gathered = without_placeholders(name, found, self.notes)
                topic.features.clear()
                self._settle_unit(name, topic.gathered, settings)
                topic.gathered = self._mirrored(name, without_held(name, topic.gathered, self.notes), settings)
                topic.gathered = in_known_order(name, topic.gathered, self.notes)
        for name in self._mirrors(settings).keys() - self.topics.keys():
            self.notes.append(f"read.mirror does not count here: the log has no topic '{name}'.")
        if known:
            late = Unused.because("it came later than the beginning")
            self.uses = {name: known.uses.get(name, late) for name in self.topics}
            self.skin, self.stereo = known.skin, known.stereo
        else:
            self._decide(settings, cameras)

    def _pass(self) -> None:
        """Takes all messages that may be used."""
        # Without statistics the only way to know the number of messages is to read them all.
        everything = self.log.declared is None
        wanted = lambda s, c: everything or bool(self.kind(s, c))  # noqa: E731
        for schema, channel, message in guarded(self.log, wanted):
            first, last = self.log_times or (message.log_time, message.log_time)
            self.log_times = min(first, message.log_time), max(last, message.log_time)
            topic = self._topic(schema, channel)
            topic.count += 1
            self.log.clock.check()
            if schema is not None and topic.kind and self.kind(schema, channel) == topic.kind:
                self._take(topic, schema, channel, message)

    def _decide(self, settings: ReadSettings, cameras: dict[str, Calibration]) -> None:
        """What topics are used for; `cameras` that are given by the settings."""
        for name, topic in self.topics.items():
            topic.given, topic.fallback = cameras.get(name), cameras.get("")
        for name in cameras.keys() - self.topics.keys() - {""}:
            self.notes.append(f"read.camera does not count here: the log has no topic '{name}'.")
        for name, why in self._foreign.items():
            if name in self.topics:
                self.topics[name].foreign = why
        pairs = find_pairs(self.topics, self.tree) if settings.stereo else []
        self.uses = decide_uses(self.log.path, self.topics, settings, self.notes, pairs)
        self.skin, notes = camera_topics(self.topics, self.uses, UNSEARCHED, True) if settings.skin else ({}, [])
        self.notes += notes
        self.uses |= {name: SKIN_USE for name in self.skin if isinstance(self.uses[name], Unused)}
        self.stereo = [pair for pair in pairs if self.uses[pair.left] == STEREO_USE]
        if settings.pose_net and not self.stereo:  # else the pairs' images are looked at
            cameras = camera_topics(self.topics, self.uses)[0]
            self.uses |= {name: POSE_USE for name in cameras if isinstance(self.uses[name], Unused)}

    @property
    def damage(self) -> list[str]:
        """What of the log is damaged, as far as it is known before depth is decoded: a sentence each."""
        broken = [
            f"'{name}': {many(topic.broken)} cannot be decoded ({topic.error})."
            for name, topic in self.topics.items()
            if topic.broken and not topic.whole
        ]
        return [*self.log.damage, *broken]

    def lost(self, used: Iterable[str]) -> int:
        """How many messages of some topics are known to be missing in the file."""
        return sum(max(0, self.topics[name].stated - self.topics[name].count) for name in used if name in self.topics)

    def kind(self, schema: Schema | None, channel: Channel) -> str:
        """What a channel may be used for; "" also for what is switched off."""
        kind = kind_of(schema, channel)
        known = self.topics.get(channel.topic)
        if kind == COLOUR_KIND and known is not None and known.kind in DEPTH_KINDS:
            kind = known.kind  # its compressed images turned out to be of depth
        return "" if kind in self._off else kind

    def numbered(self, names: Container[str]) -> Iterator[tuple[str, int, Item]]:
        """The messages of some topics: topic, number among its messages, message. Raises LogError."""
        seen: Counter[str] = Counter()
        wanted = lambda s, c: c.topic in names and self.kind(s, c) == self.topics[c.topic].kind  # noqa: E731
        for item in guarded(self.log, wanted):
            topic = item[1].topic
            yield topic, seen[topic], item
            seen[topic] += 1

    def _topic(self, schema: Schema | None, channel: Channel) -> Topic:
        if channel.topic not in self.topics and len(self.topics) >= limits().topics:
            self._too_many = True
            return Topic("", "", "", "too many topics")
        if channel.topic not in self.topics:
            encoding = "/".join(filter(None, [channel.message_encoding, schema.encoding if schema else ""]))
            name, why = schema.name if schema else "?", reason_unused(schema, channel)
            up = channel.metadata.get("up", "")
            self.topics[channel.topic] = Topic(name, encoding, self.kind(schema, channel), why, up=up)
        return self.topics[channel.topic]

    def _take(self, topic: Topic, schema: Schema, channel: Channel, message: Any) -> None:
        content, stamp = None, quick_stamp(schema, channel, message.data)
        depth = topic.kind in (*DEPTH_KINDS, COLOUR_KIND)
        if topic.sample is None or stamp is None or not depth:
            try:
                content = self._decoder.message(schema, channel, message.data)
            except DECODE_ERRORS as error:
                topic.broken, whole = topic.broken + 1, isinstance(error, Unusable)
                topic.whole &= whole
                topic.error = topic.error or plain(f"{error}" if whole else f"{type(error).__name__}: {error}", LONG)
        if content is not None and topic.sample is None:
            topic.sample = content
            if isinstance(content, Image) and topic.kind == COLOUR_KIND:
                topic.kind = "image"
        if isinstance(content, list):
            static = is_static(channel)
            for transform in content:
                if static or abs(transform.stamp_ns) >= TIME:
                    self.tree.add(transform, static)
                    continue
                self._transforms += 1
                if self._transforms <= limits().transforms:
                    key = channel.topic, transform.child
                    self._moving.setdefault(key, Moving()).add(transform, message.log_time)
        elif isinstance(content, Calibration):
            old = topic.calibration
            if old is None or (old.K[0, 0] == 0 and content.K[0, 0] != 0):
                topic.calibration = content
            elif content.K[0, 0] != 0 and not (np.array_equal(old.K, content.K) and np.array_equal(old.D, content.D)):
                note = f"The calibration on '{channel.topic}' changes during the log; its first value is used."
                if note not in self.notes:
                    self.notes.append(note)
        elif isinstance(content, Features):
            self._features += len(content.names)
            if len(self._names) > limits().names or self._features > limits().features:
                return
            self._names.update(content.names)
            topic.features.append(content)
            topic.log_times.append(message.log_time)
        elif depth:
            if content is not None:
                stamp = content.stamp_ns
            # an impossible stamp is none: 0, for which the log time stands
            stamp = message.log_time if stamp is None else stamp
            topic.stamps.append(stamp if abs(stamp) < TIME else 0)
            topic.log_times.append(message.log_time)

    def _mirrors(self, settings: ReadSettings) -> dict[str, str]:
        return check_pairs("read.mirror", settings.mirror)

    def _mirrored(self, name: str, found: Gathered, settings: ReadSettings) -> Gathered:
        """3D features with the axis turned round that a user names."""
        axis = self._mirrors(settings).get(name, "none")
        if axis == "none" or self.topics[name].kind != PAIRS:
            return found
        return replace(found, values=found.values * np.where(np.array(list("xyz")) == axis, -1.0, 1.0))

    def _settle_unit(self, name: str, found: Gathered, settings: ReadSettings) -> None:
        """Brings 3D features to metres."""
        given = check_pairs("read.scale", settings.scale)
        unit = float(given.get(name, 0.0)) or unit_of(found)
        if self.topics[name].kind == PAIRS:
            self.units[name] = unit
        if unit != 1.0 and self.topics[name].kind == PAIRS:
            self.topics[name].gathered = replace(found, values=found.values * unit)
            if name not in given:
                word = {0.001: "millimetres", 0.01: "centimetres"}.get(unit, "")
                self.notes.append(
                    f"'{name}': its coordinates are taken for {word}, to judge by their extent. read.scale settles it."
                )

    def _bring_clocks_together(self, settings: ReadSettings, known: bool) -> None:
        """Shifts the stamps of measurements and transforms that are of another clock than the others'."""
        delays = {n: float(by) for n, by in check_pairs("read.delays", settings.delays).items()}
        for name in delays.keys() - self.topics.keys():
            self.notes.append(f"read.delays does not count here: the log has no topic '{name}'.")
        as_array = lambda numbers: np.array(numbers, np.int64)  # noqa: E731
        given = [Stamps(n, as_array(t.stamps), as_array(t.log_times)) for n, t in self.topics.items() if t.stamps]
        for name, topic in self.topics.items():
            if topic.features:
                given.append(Stamps(name, as_array([f.stamp_ns for f in topic.features]), as_array(topic.log_times)))
        for (topic, child), samples in self._moving.items():
            given.append(Stamps(f"{topic} {child}", samples.stamps_ns, samples.log_times_ns, measured=False))
            self.moves[child] = topic
            delays |= {f"{topic} {child}": delays[topic]} if topic in delays else {}
        if known:
            by = {one.topic: np.full(len(one.own), self.shifts.get(one.topic, 0), np.int64) for one in given}
        else:
            steps = [(step.at, step.by) for step in self.log.set_backs]
            by, self._foreign = shifts(given, delays, self.notes, steps)
            self.shifts = {name: int(np.median(shift)) if len(shift) else 0 for name, shift in by.items()}
        for name, topic in self.topics.items():
            if topic.stamps and by[name].any():
                topic.stamps = (as_array(topic.stamps) + by[name]).tolist()
            elif topic.features and by[name].any():
                topic.features = [moved(f, int(ns)) for f, ns in zip(topic.features, by[name])]
        for topic, child in list(self._moving):
            self.tree.add_moving(child, self._moving.pop((topic, child)), by[f"{topic} {child}"])

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
        if len(self._names) > limits().names:
            most = limits().names
            self.notes.append(f"The log names more than {most} features; the later ones are left out (--limits.names).")
        for what, count, name in (
            ("transforms that move", self._transforms, "transforms"), ("named features", self._features, "features")
        ):  # fmt: skip
            if count > (most := getattr(limits(), name)):
                self.notes.append(f"The log has {count} {what}; those after {most} are left out (--limits.{name}).")
        if self._too_many:
            most = limits().topics
            self.notes.append(f"The log has more than {most} topics; the others are not looked at (--limits.topics).")
        for name, topic in self.topics.items():
            topic.stated = stated[name]
            if topic.kind and topic.count < stated[name]:
                lost = stated[name] - topic.count
                self.notes.append(f"'{name}': kept {topic.count} of {stated[name]} messages, {lost} cannot be read.")
            elif not topic.kind:
                topic.count = max(topic.count, stated[name])
            if topic.broken and topic.kind in ("calibration", "transforms", *FEATURE_KINDS):
                self.notes.append(f"'{name}': {many(topic.broken)} cannot be decoded ({topic.error}).")
