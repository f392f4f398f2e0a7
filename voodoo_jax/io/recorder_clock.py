"""The recorder's clock, where it was set back during the recording: times that occur twice are put one after the other.

Where the network sets a computer's clock back, log times and the stamps of that computer run through the same seconds
twice: in the order of time the frames of both would alternate.
"""

import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Message

from voodoo_jax.geometry.from_bytes import array_at
from voodoo_jax.io.clocks import MOST_STEPS, SECOND, seconds

LEAST = SECOND // 20  # less is the order in which threads write; clocks are set where they are off by 0.128 s (ntpd)
_INDEX = struct.Struct("<BQHI")  # head of a message index: opcode, length, channel, bytes of its entries


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
