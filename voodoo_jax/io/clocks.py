"""Stamps of several clocks in one log: distinguished by the log time, which is one clock for all, and brought together.

A sensor may count from its power-on, a computer may not have its time from the network, or get it in the middle of a
recording. What a user says of a topic's clock (`read.delays`) is taken as said. Where the network sets the recorder's
clock back, log times and the stamps of that computer run through the same seconds twice: in the order of time the
frames of both would alternate, so these times are put one after the other.
"""

import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import BinaryIO

import numpy as np
from jaxtyping import Int64
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Message

from voodoo_jax.geometry.arrays_file import array_at

SECOND = 1_000_000_000
LATE = 10 * SECOND  # by so much no measurement is delivered later than another one: it is another clock
EARLY = SECOND // 10  # a stamp so long after the recorder got the message is of another clock
LATENCY = 2 * SECOND  # within which messages are delivered, usually: such a clock is the recorder's, too
STEP = SECOND // 2  # between two successive messages of a topic: more is a step of the clock, if it stays
FEWEST = 3  # messages between two steps: fewer are stamps gone wrong
AROUND = 15  # messages on each side of a step, whose medians show whether the clock is the recorder's; by hand
MOST_STEPS = 4  # more is no clock that was set
EPOCH = 86400 * SECOND  # one day: a log with a longer pause holds two settings of a clock, not two recordings
LEAST = SECOND // 20  # less is the order in which threads write; clocks are set where they are off by 0.128 s (ntpd)
_INDEX = struct.Struct("<BQHI")  # head of a message index: opcode, length, channel, bytes of its entries


@dataclass(frozen=True)
class Stamps:
    """Times of the messages of one topic in the order of reading, nanoseconds."""

    topic: str
    own: Int64[np.ndarray, " message"]  # by the messages' headers; 0: not said
    logged: Int64[np.ndarray, " message"]  # by the recorder
    measured: bool = True  # else transforms, which may be given in advance

    @property
    def stamped(self) -> np.ndarray:
        """Which messages have a stamp."""
        return self.own != 0

    @property
    def late(self) -> Int64[np.ndarray, " message"]:
        """Log time minus stamp."""
        return self.logged - self.own


def shifts(
    topics: Sequence[Stamps], delays: dict[str, float], notes: list[str], set_backs: Sequence[tuple[int, int]] = ()
) -> tuple[dict[str, Int64[np.ndarray, " message"]], dict[str, str]]:
    """What is to be added to the stamps of each topic, nanoseconds, so that all are of one clock, and why some topics
    cannot be brought to it; says in `notes` what was done.

    The clock of all is the one that most measurements agree with the recorder on; where none does (a log of a
    simulation, or of a recording that was played), the one of most topics.

    **Arguments:** `delays` seconds by which the stamps of a topic are late: nothing else is done to these; `set_backs`
    when the recorder's clock was set back and by how much, nanoseconds, where log times are without that.
    """
    moved = {t.topic: np.zeros(len(t.own), np.int64) for t in topics}
    for t in topics:
        if t.topic in delays:
            moved[t.topic] -= round(delays[t.topic] * SECOND)
    timed = [t for t in topics if t.topic not in delays and t.stamped.any() and len(np.unique(t.logged)) > 1]
    late = {}
    for t in timed:
        same = sum((_set_back_with_it(t, at, by) for at, by in set_backs), np.zeros(len(t.own), np.int64))
        moved[t.topic] += same + _without_steps(replace(t, own=t.own + same * t.stamped), notes)
        late[t.topic] = int(np.median((t.late - moved[t.topic])[t.stamped]))
    if late:
        usual = _usual(timed, late)
        for t in timed:
            apart = late[t.topic] - usual
            early = t.measured and late[t.topic] < -EARLY and apart < -EARLY and usual > -EARLY // 5
            if abs(apart) > LATE or early:
                moved[t.topic] += apart
                way = "ahead" if apart < 0 else "behind"
                notes.append(
                    f"'{t.topic}': its stamps are of another clock, {seconds(apart)} {way}; they were "
                    "shifted by the log time. If that is wrong, read.delays says by how much they are late."
                )
    return moved, _one_epoch(topics, moved, notes)


def seconds(nanoseconds: int) -> str:
    """A time without its sign, in words."""
    size = abs(nanoseconds) / SECOND
    for name, unit in (("years", 365.25 * 86400), ("days", 86400.0), ("hours", 3600.0)):
        if size >= 2 * unit:
            return f"{size / unit:.1f} {name}"
    return f"{size:.2f} s" if size < 100 else f"{size:.0f} s"


def _usual(timed: list[Stamps], late: dict[str, int]) -> int:
    """How late the messages of the clock that all are brought to are, nanoseconds."""
    near = [t for t in timed if abs(late[t.topic]) <= LATENCY]
    if near:  # of measurements, if there are: transforms may come from anywhere
        near = [t for t in near if t.measured] or near
        near = [t for t in near if late[t.topic] > -EARLY // 5] or near
        return int(np.median([late[t.topic] for t in near]))
    alike = {t.topic: [late[o.topic] for o in timed if abs(late[o.topic] - late[t.topic]) <= LATE] for t in timed}
    return int(np.median(max(alike.values(), key=len)))


def _set_back_with_it(t: Stamps, at: int, by: int) -> np.ndarray:
    """What is to be added to the stamps of a topic if they are of the recorder's clock, which was set back then."""
    sides = [t.late[t.stamped & side] for side in (t.logged < at, t.logged >= at)]
    if not all(len(side) for side in sides):
        return np.zeros(len(t.own), np.int64)
    later = np.median(sides[1][:AROUND]) - np.median(sides[0][-AROUND:])
    return by * (t.logged >= at) * (2 * later > by)


def _without_steps(t: Stamps, notes: list[str]) -> np.ndarray:
    """What is to be added to the stamps of a topic so that its clock was never set while it was recorded."""
    out, stamped = np.zeros(len(t.own), np.int64), np.flatnonzero(t.stamped)
    late = t.late[stamped]
    steps = np.flatnonzero(np.abs(np.diff(late)) > STEP) + 1
    parts = [p for p in np.split(np.arange(len(late)), steps) if len(p)]
    whole = [p for p in parts if len(p) >= FEWEST]
    middles = [int(np.median(late[p])) for p in whole]
    if not whole or len(whole) > MOST_STEPS + 1:
        return out
    best = min(range(len(whole)), key=lambda k: (abs(middles[k]) > LATENCY, -len(whole[k])))
    good = middles[best]
    set_at = [
        (p, m)
        for p, m in zip(whole, middles)
        if abs(m - good) > STEP and _stamps_jumped(t.own[stamped], t.logged[stamped], p)
    ]
    for p, m in set_at:
        out[stamped[p]] += m - good
    if set_at:
        notes.append(
            f"'{t.topic}': its clock was set during the recording (by {seconds(set_at[0][1] - good)}, "
            f"{sum(len(p) for p, _ in set_at)} stamps shifted by the log time)."
        )
    corrected = late - out[stamped]
    odd = np.abs(corrected - good) > LATE
    few = odd & np.isin(np.arange(len(late)), np.concatenate([[-1], *(p for p in parts if len(p) < FEWEST)]))
    if few.any():
        out[stamped[few]] += corrected[few] - good
        notes.append(f"'{t.topic}': {int(few.sum())} stamps are of no clock; the log time is used for them.")
    return out


def _stamps_jumped(own: np.ndarray, logged: np.ndarray, part: np.ndarray) -> bool:
    """Whether it is the stamps, not the log time, that jump at the borders of a part: messages come regularly."""
    edges = [e for e in (part[0], part[-1] + 1) if 0 < e < len(own)]
    period = np.median(np.abs(np.diff(own)))
    jumps = lambda x: max((abs(x[e] - x[e - 1] - period) for e in edges), default=0.0)  # noqa: E731
    return bool(jumps(own.astype(float)) > jumps(logged.astype(float)))


def _one_epoch(topics: Sequence[Stamps], moved: dict[str, np.ndarray], notes: list[str]) -> dict[str, str]:
    """Adds to `moved` what places the part before the clock was set right before the part after. Returns the topics
    that are wholly of another epoch than most, and why they cannot be used."""
    times = {t.topic: (t.own + moved[t.topic])[t.stamped] for t in topics if t.measured and t.stamped.any()}
    every = np.unique(np.concatenate([np.zeros(0, np.int64), *times.values()]))
    foreign: dict[str, str] = {}
    for k in np.flatnonzero(np.diff(every) > EPOCH)[::-1]:
        last, by = every[k], int(every[k + 1] - every[k])
        sides = {name: ((mine <= last).any(), (mine > last).any()) for name, mine in times.items()}
        before = [name for name, side in sides.items() if side == (True, False)]
        after = [name for name, side in sides.items() if side == (False, True)]
        if before and after:  # nothing says how their clocks are related
            count = lambda some: sum(len(times[name]) for name in some)  # noqa: E731
            fewer = before if count(before) <= count(after) else after
            way = "behind" if fewer is before else "ahead"
            why = f"its clock is {seconds(by)} {way} of the others', and the log times do not say by how much exactly"
            foreign |= {name: f"{why} (read.delays says it)" for name in fewer}
            continue
        by -= int(np.median(np.diff(every)))
        for t in topics:
            moved[t.topic][t.stamped & (t.own + moved[t.topic] <= last)] += by
        notes.append(
            f"The clock was set during the recording, by {seconds(by)}: what came before is placed right before "
            "what came after; how long it was in between is not known."
        )
    return foreign


@dataclass(frozen=True)
class SetBack:
    """A step of the clock: at which message of a channel in which chunk (place in the file), by how many ns."""

    chunk: int
    channel: int
    message: int  # of the channel's messages in that chunk, in the order in which they were written
    by: int
    at: int  # the log time without it, nanoseconds


def set_backs(stream: BinaryIO, chunks: Sequence[ChunkIndex]) -> tuple[SetBack, ...]:
    """Where the clock was set back, by the index of the channel that is in most chunks.

    A channel's messages are written in order: its clock was set back where its log time returns to a time that it has
    been through. A part whose times all lie before is one of a file that was joined in another order.
    """
    counts = Counter(channel for chunk in chunks for channel in chunk.message_index_offsets)
    if not counts:
        return ()
    channel = counts.most_common(1)[0][0]
    used = sorted((c for c in chunks if channel in c.message_index_offsets), key=lambda c: c.chunk_start_offset)
    times = [_written(stream, chunk.message_index_offsets[channel], channel) for chunk in used]
    every = np.concatenate(times)
    after = np.flatnonzero(np.diff(every) < -LEAST) + 1
    if not 0 < len(after) <= MOST_STEPS:
        return ()
    period, start, found = int(np.median(np.diff(every))), np.cumsum([0, *map(len, times)]), []
    for i in after.tolist():
        if every[i] > every[:i].min():
            k = int(np.searchsorted(start, i, "right")) - 1
            by = int(every[i - 1] - every[i]) + period
            at = int(every[i]) + sum(step.by for step in found) + by
            found.append(SetBack(used[k].chunk_start_offset, channel, i - int(start[k]), by, at))
    return tuple(found)


def put_after(steps: Sequence[SetBack], chunk: int, records: Sequence[object]) -> None:
    """Adds to the log times of a chunk's messages, in place, what the clock was set back by."""
    added, within = (
        sum(step.by for step in steps if step.chunk < chunk),
        [step for step in steps if step.chunk == chunk],
    )
    seen = 0
    for record in records:
        if isinstance(record, Message):
            if within and record.channel_id == within[0].channel:
                added += sum(step.by for step in within if step.message == seen)
                seen += 1
            record.log_time += added


def note_of(steps: Sequence[SetBack]) -> str:
    """What was done, for people."""
    return (
        f"The recorder's clock was set back during the recording, by {', '.join(seconds(s.by) for s in steps)}: what "
        "was recorded after that is placed right after what was recorded before."
    )


def _written(stream: BinaryIO, place: int, channel: int) -> np.ndarray:
    """Log times of a channel's messages in a chunk, in the order of writing; none if no index is at that place."""
    stream.seek(place)
    head = stream.read(_INDEX.size)
    if len(head) < _INDEX.size:
        return np.zeros(0, np.int64)
    opcode, _, found, length = _INDEX.unpack(head)
    body = stream.read(length)
    if opcode != Opcode.MESSAGE_INDEX or found != channel or length % 16 or len(body) < length:
        return np.zeros(0, np.int64)
    entries = array_at(body, "<i8", (length // 16, 2))
    return entries[np.argsort(entries[:, 1], kind="stable"), 0]
