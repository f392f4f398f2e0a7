"""Frames of a log that is still being recorded, by the same plan as those of a finished one.

The messages of the last seconds are repeatedly planned like a small log; topics, units, clocks and the fixed frame stay
as determined at the beginning. A frame is yielded once no later message can belong to it, so that it equals the frame
of the finished log.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from voodoo_jax.config.limited import limits
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.chunks import Clock, LogError
from voodoo_jax.io.container import Item, LogFile
from voodoo_jax.io.decode.registry import DECODE_ERRORS, DEPTH_KINDS, FEATURE_KINDS, Decoder, is_static, kind_of
from voodoo_jax.io.frame_sync import period_of
from voodoo_jax.io.live.sources import ITEM, Source
from voodoo_jax.io.log_index import Known, Scan
from voodoo_jax.io.opened_log import LogReader
from voodoo_jax.io.read_plan import Plan, make_plan
from voodoo_jax.io.topic import DEPTH_USES
from voodoo_jax.io.transforms import Transform
from voodoo_jax.records.messages import PAIRS, RAYS
from voodoo_jax.records.recording import Frame

SECOND = 1_000_000_000
OPENING = 2.0  # seconds of a log from which it is told what is in it: topics, units, transforms; by hand
WINDOW = 1.5  # seconds that are looked at: periods of slow sensors, and transforms before a frame; by hand
WAITING = 30.0  # seconds that are kept while nothing can be used yet; by hand
LATE = 0.15  # seconds that a frame waits for other sensors and for transforms: more than they usually take; by hand
NEAR = 0.25  # of a period: another sensor's message so near to a frame is the one that belongs to it; by hand
POLL = 0.1  # seconds; by hand


class HeldLog(LogFile):
    """Messages in memory as a log."""

    def __init__(self, path: str, items: Sequence[Item]):
        self.path, self._items = path, items
        self.size = sum(len(message.data) for _, _, message in items)
        self.clock = Clock(self.size)
        self.channels = {channel.id: channel for _, channel, _ in items}
        self.schemas = {schema.id: schema for schema, _, _ in items if schema is not None}
        self.declared, self.time_range, self.counts, self.damage = {}, None, Counter(), []

    def messages(self, wanted: Callable[[Schema | None, Channel], bool]) -> Iterator[Item]:
        """Messages in order of arrival."""
        for item in self._items:
            if wanted(item[0], item[1]):
                self.counts[item[1].id] += 1
                yield item


class Remembering(Decoder):
    """Caches decoded small messages, which each frame reads again."""

    def __init__(self):
        super().__init__()
        self._known: dict[int, Any] = {}  # by the message's bytes, which are kept as long

    def message(self, schema: Schema, channel: Channel, data: bytes) -> Any:
        if kind_of(schema, channel) not in ("transforms", "calibration", *FEATURE_KINDS):
            return super().message(schema, channel, data)
        if id(data) not in self._known:
            self._known[id(data)] = super().message(schema, channel, data)
        return self._known[id(data)]

    def forget(self, data: bytes) -> None:
        """Removes the entries of deleted bytes."""
        self._known.pop(id(data), None)


class LiveLog:
    """A log that is still being recorded.

    **Arguments:** `opened` makes a reader of the first messages, such as detect.opening.open_checked; `say` gets
    messages about waiting.
    """

    def __init__(
        self,
        source: Source,
        settings: ReadSettings,
        opened: Callable[[LogFile, ReadSettings], LogReader],
        say: Callable[[str], None] = lambda text: None,
    ):
        self.source, self._settings, self._opened, self._say = source, settings, opened, say
        self._items: list[Item] = []
        self._came: list[float] = []  # when each came, by time.monotonic
        self._after = -1  # stamp of the last frame that was given, nanoseconds
        self._held: dict[tuple[str, str], list[Transform]] = {}  # that are older than what is looked at
        self._static: dict[tuple[str, str], Transform] = {}
        self._decoder = Remembering()
        self._losses: Counter[tuple[str, str]] = Counter()
        self._problem = ""
        self.arrived: dict[int, float] = {}  # of the frames given last, by stamp: when they were complete
        self.log_times: dict[int, int] = {}  # and when the recorder got them, nanoseconds

    # -- the beginning

    def open(self) -> LogReader:
        """Waits for the required messages, and returns a reader of the messages so far. Raises LogError if they do not
        come before the source ends."""
        tried, waiting = 0, ""
        while True:
            items = self._poll()
            span = self._newest - self._items[0][2].log_time if self._items else 0
            if self.source.ended or (items and span >= OPENING * SECOND and span - tried >= OPENING / 4 * SECOND):
                tried = span
                try:
                    self.reader = self._opened(HeldLog(self.source.path, self._items), self._settings)
                    return self._settle()
                except LogError as problem:
                    if self.source.ended:
                        raise
                    if str(problem) != waiting:
                        self._say(f"waiting: {problem}")
                        waiting = str(problem)
                self._drop(WAITING, self._first_messages())
            elif not items and not waiting:
                self._say("waiting: no message has come yet")
                waiting = "nothing"

    def _first_messages(self) -> set[int]:
        """The first messages of each topic, among them those that are sent only once."""
        seen: Counter[int] = Counter()
        kept = set()
        for k, (_, channel, _) in enumerate(self._items):
            seen[channel.id] += 1
            if seen[channel.id] <= 3:
                kept.add(k)
        return kept

    def _settle(self) -> LogReader:
        """What was found out holds from now on."""
        r, s = self.reader, self._settings
        self._origins = r.no_origins()
        units = [f"{name}={unit:g}" for name, unit in r.scan.units.items()]  # of named points, found by their extent
        scale, transform = (*s.scale, *units), (*s.transform, *r.placed)
        self._fixed = replace(s, fixed_frame=r.fixed_frame, scale=scale, transform=transform, delays=())
        return r

    # -- frames

    def frames(self) -> Iterator[Frame]:
        """Yields frames as they become complete, until the source ends. Only after `open`."""
        yield from self._ready()
        while not self.source.ended:
            try:
                came = self._poll()
            except (LogError, OSError) as problem:  # what was read before is tracked all the same
                self._problem, self.source.ended, came = str(problem), True, []
            if came:
                yield from self._ready()
        yield from self._ready()

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out, missing or damaged, one sentence each."""
        losses = [f"'{topic}': {count} messages {what}." for (topic, what), count in self._losses.items()]
        problem = [f"Some of it could not be used: {self._problem}"] if self._problem else []
        return (*self.reader.notes, *losses, *problem, *self.source.notes)

    @property
    def held(self) -> Sequence[Item]:
        """The messages in memory."""
        return self._items

    def _poll(self) -> list[Item]:
        items = self.source.poll(POLL)
        self._items += items
        self._came += [time.monotonic()] * len(items)
        held, gone = sum(len(message.data) + ITEM for _, _, message in self._items), 0
        while held > limits().memory // 2:  # of one moment, if its stamps are to be believed
            held, gone = held - len(self._items[gone][2].data) - ITEM, gone + 1
        del self._items[:gone], self._came[:gone]
        self._losses.update({("all", "came at once and were left out"): gone} if gone else {})
        return items

    @property
    def _newest(self) -> int:
        return max((message.log_time for _, _, message in self._items), default=0)

    def _ready(self) -> Iterable[Frame]:
        """Frames that are complete by now."""
        try:
            self.arrived, self.log_times = {}, {}
            scan, plan = self._look()
            frames = self._settled(scan, plan) if plan is not None else range(0)
            if plan is not None and len(frames):
                self._note_times(plan, frames)
                self._after = plan.frames[frames.stop - 1][0]
                reader = self.reader.continued(scan, plan.only(frames))
                try:
                    yield from reader.frames(origins=self._origins)
                finally:
                    self._losses.update(reader.counted)
        except LogError as problem:  # of this part of it
            self._problem = str(problem)
        self._drop(WINDOW)

    def _look(self) -> tuple[Scan, Plan | None]:
        """What is there of the last seconds, and how it becomes frames."""
        moving = [(t, False) for some in self._held.values() for t in some]
        s, transforms = self.reader.scan, [*((t, True) for t in self._static.values()), *moving]
        known = Known(s.topics, s.uses, s.skin, s.stereo, s.shifts, transforms, self._decoder)
        scan = Scan(HeldLog(self.source.path, self._items), self._fixed, known)
        if not any(scan.topics[name].stamps for name in self.reader.sensors):
            return scan, None
        plan = make_plan(scan, self._fixed, self.reader.origin, self._after)
        return scan, plan if plan.sensors == self.reader.sensors else None

    def _settled(self, scan: Scan, plan: Plan) -> range:
        """Which of the planned frames are new, and complete."""
        times = np.array([t for t, _ in plan.frames], np.int64)
        first = int(np.searchsorted(times, self._after, "right"))
        if self.source.ended:
            return range(first, len(times))
        half = 0.5 * min(period_of(times), 2 * LATE * SECOND)
        now, stop = self._newest, first
        for t in times[first:].tolist():
            if now - self._logged(scan, plan, t) < LATE * SECOND and not self._complete(scan, plan, t, half):
                break
            stop += 1
        return range(first, stop)

    def _complete(self, scan: Scan, plan: Plan, t: int, half: float) -> bool:
        """Whether nothing that may still come belongs to a frame."""
        if any(last < t for last in scan.tree.known_until.values()):
            return False
        leads = len([name for name in plan.sensors if scan.uses[name] in DEPTH_USES]) == 1
        for name, topic in scan.topics.items():
            use = scan.uses[name]
            if name in plan.sensors and topic.stamps and not leads:
                stamps = np.array(topic.stamps, np.int64)
                if stamps.max() < t + half and np.abs(stamps - t).min() > 2 * NEAR * half:
                    return False
            elif use in (RAYS, PAIRS) and topic.gathered is not None and len(topic.gathered.message_stamps):
                if topic.gathered.message_stamps.max() < t + half:
                    return False
        return True

    def _logged(self, scan: Scan, plan: Plan, t: int) -> int:
        """About when the recorder got the frame's messages, nanoseconds."""
        late = [
            int(np.median(np.array(scan.topics[n].log_times) - np.array(scan.topics[n].stamps)))
            for n in plan.sensors
            if scan.topics[n].stamps
        ]
        return t + max(late)

    def _note_times(self, plan: Plan, frames: range) -> None:
        """When the messages of frames came."""
        came: dict[str, list[tuple[float, int]]] = {}
        for (schema, channel, message), when in zip(self._items, self._came):
            if channel.topic in plan.sensors and kind_of(schema, channel) in (*DEPTH_KINDS, "image"):
                came.setdefault(channel.topic, []).append((when, message.log_time))
        for i in frames:
            t, members = plan.frames[i]
            each = [came[plan.sensors[sensor]][number] for sensor, number in members if plan.sensors[sensor] in came]
            if each:
                self.arrived[t], self.log_times[t] = max(when for when, _ in each), max(at for _, at in each)

    def _drop(self, seconds: float, but: set[int] = frozenset()) -> None:  # type: ignore[assignment]
        """Lets go of messages that are older; the transforms among them are kept."""
        oldest = self._newest - int(seconds * SECOND)
        gone = [k for k, (_, _, m) in enumerate(self._items) if m.log_time < oldest and k not in but]
        for k in gone:
            schema, channel, message = self._items[k]
            if schema is not None and kind_of(schema, channel) == "transforms":
                self._keep(schema, channel, message.data)
            self._decoder.forget(message.data)
        out = set(gone)
        self._items = [item for k, item in enumerate(self._items) if k not in out]
        self._came = [when for k, when in enumerate(self._came) if k not in out]

    def _keep(self, schema: Schema, channel: Channel, data: bytes) -> None:
        try:
            transforms = self._decoder.message(schema, channel, data)
        except DECODE_ERRORS:
            return
        shifts = self.reader.scan.shifts if hasattr(self, "reader") else {}
        for t in transforms:
            if is_static(channel):
                self._static[t.child, t.parent] = t
                continue
            by = shifts.get(f"{channel.topic} {t.child}", 0)
            self._held[t.child, t.parent] = [
                *self._held.get((t.child, t.parent), [])[-1:],
                replace(t, stamp_ns=t.stamp_ns + by),
            ]
