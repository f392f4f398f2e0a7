"""Message iteration over an MCAP file that may be damaged: keeps all that can be read and says what could not be."""

import os
import struct
import weakref
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from functools import partial
from io import BytesIO
from operator import attrgetter
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, ChunkIndex, DataEnd, Message, Schema, Statistics
from mcap.summary import Summary

from voodoo_jax.config.limited import TIME, limits
from voodoo_jax.io.chunks import (
    READ_ERRORS,
    ZSTD,
    Budget,
    Clock,
    LogError,
    chunk_records,
    clean_channel,
    clean_schema,
    unpacked_message,
    words,
)
from voodoo_jax.io.clocks import SetBack, put_after, set_backs
from voodoo_jax.records.notes import INCOMPLETE
from voodoo_jax.storage.scratch import named_file

MAGIC = b"\x89MCAP0\r\n"
# how files of other formats begin that can be converted
FOREIGN = {b"#ROSBAG": "a ROS 1 bag", b"SQLite": "an SQLite bag of ROS 2", b"PathFile": "a TRC file"}
KEPT = 256 << 20  # bytes of unpacked chunks that stay in memory until the next pass
UNPACKERS = 2  # threads that unpack chunks: as many as a small machine has cores; by hand
SMALL = 16 << 20  # bytes of chunks of which two more in memory do not count; recorders write 1 to 5 MB; by hand
_BY_TIME = attrgetter("log_time")

Item = tuple[Schema | None, Channel, Message]
Place = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]  # of a log: a file, a folder, or several files


class Reassembled:
    """Makes messages of records of an MCAP file: `channels` and `schemas` by id, `counts` of messages per channel."""

    def __init__(self):
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.counts: Counter[int] = Counter()
        self._schema_room = limits().schemas_bytes
        self._left_out: set[tuple[int, str]] = set()  # numbers and names of schemas for which there was no room
        self._lost = self._absurd = 0  # messages of no known channel, and at impossible times

    def items(
        self, records: list, wanted: Callable[[Schema | None, Channel], bool] = lambda *_: True
    ) -> Iterator[Item]:
        """The messages of wanted channels in some successive records, such as a chunk's, in order of log time."""
        held = []
        for record in records:
            kind = type(record)
            if kind is Message:
                held.append(record)
            elif kind is Schema:
                self._learn(record)
            elif kind is Channel:
                self.channels[record.id] = clean_channel(record)
        held.sort(key=_BY_TIME)
        for message in held:
            channel = self.channels.get(message.channel_id)
            if channel is None:
                self._lost += 1
                continue
            if message.log_time >= TIME:
                self._absurd += 1
                continue
            self.counts[channel.id] += 1
            schema = self.schemas.get(channel.schema_id)
            if wanted(schema, channel):
                yield schema, channel, unpacked_message(channel, message)

    def _learn(self, schema: Schema) -> None:
        """Keeps a schema, if there is room for it."""
        schema = clean_schema(schema)
        if self.schemas.get(schema.id) == schema:
            return
        self._schema_room -= len(schema.data)
        if self._schema_room >= 0:
            self.schemas[schema.id] = schema
        else:
            self._left_out.add((schema.id, schema.name))
            self.schemas.pop(schema.id, None)


class LogFile(Reassembled):
    """An MCAP file, read by its index where that can be trusted and else from start to end.

    After `messages` has run through: `channels` and `schemas` by id, `counts` messages met per channel id, `declared`
    the number per channel id that the file itself states (None if it does not), `damage` one sentence for each
    damaged part; `set_backs` where the recorder's clock was set back, which log times are without then. Raises
    `LogError` if the file is missing, empty, or not MCAP.
    """

    set_backs: tuple[SetBack, ...] = ()

    def __init__(self, path: str | os.PathLike[str]):
        super().__init__()
        self.path = os.fspath(path)
        self._file = self._unpacked()
        self.size = check_head(self.path, self._file)
        self.clock = Clock(self.size)
        self.declared: dict[int, int] | None = None
        self.time_range: tuple[int, int] | None = None
        self.damage: list[str] = []
        self._trouble = ""  # why the index is not used, if that is a sign of damage
        self._kept: dict[int, list] = {}  # records of the chunk at each place in the file
        with open(self._file, "rb") as stream:
            self._summary = self._read_summary(stream)

    def messages(self, wanted: Callable[[Schema | None, Channel], bool]) -> Iterator[Item]:
        """The messages of wanted channels: in order of log time within a chunk, chunks by their start time if there
        is an index, else in file order. Two runs give the same messages in the same order."""
        self.counts, self.damage = Counter(), []
        with open(self._file, "rb") as stream:
            if self._summary is not None:
                source = self._indexed(stream, self._summary, wanted)
            else:
                source = self._linear(stream)
            self._lost = self._absurd = 0
            for records in source:
                self.clock.check()
                yield from self.items(records, wanted)
            if self._lost:
                self.damage.append(f"Messages of no known channel, left out: {self._lost}.")
            if self._absurd:
                self.damage.append(f"Messages with an impossible log time, left out: {self._absurd}.")
            if self._left_out:
                self.damage.append(
                    f"Schemas beyond {limits().schemas_bytes} bytes together, left out: {len(self._left_out)} "
                    "(--limits.schemas_bytes)."
                )

    def _unpacked(self) -> str:
        """The file itself, or an unpacked copy of one that was compressed as a whole, for as long as this lives."""
        try:
            if not os.path.isfile(self.path):  # a pipe would be waited for
                return self.path
            with open(self.path, "rb") as packed:
                if packed.read(len(ZSTD)) != ZSTD:
                    return self.path
                packed.seek(0)
                handle, copy = named_file(".mcap")
                weakref.finalize(self, os.unlink, copy)
                size, most = 0, Budget(os.fstat(packed.fileno()).st_size).most
                with os.fdopen(handle, "wb") as out:
                    for part in zstandard.ZstdDecompressor().read_to_iter(packed):
                        size += out.write(part)
                        if size > most:
                            raise zstandard.ZstdError(f"it unpacks to more than {most} bytes (--limits.log_bytes)")
                return copy
        except zstandard.ZstdError as error:
            raise LogError(
                f"'{self.path}' is damaged: it is compressed and cannot be unpacked ({error}). Copy it again."
            ) from error
        except OSError:
            return self.path  # what is wrong with it is said when it is looked at

    def _read_summary(self, stream: BinaryIO) -> Summary | None:
        """The index at the end of the file, None if it is missing or cannot be trusted."""
        try:
            # No record can be longer than the file: this limit stops absurd lengths before any memory is asked for.
            summary = SeekingReader(stream, record_size_limit=self.size).get_summary()
            if summary is None:
                return None
            stream.seek(-28, os.SEEK_END)
            start, _, crc = struct.unpack("<QQI", stream.read(20))
            stream.seek(start)
            # The summary's own checksum covers the footer up to the checksum itself.
            if crc and zlib.crc32(stream.read(self.size - start - 12)) != crc:
                raise McapError("its checksum does not match")
            known = all(c.schema_id == 0 or c.schema_id in summary.schemas for c in summary.channels.values())
            for index in summary.chunk_indexes:
                stream.seek(min(index.chunk_start_offset, self.size))
                if stream.read(1) != bytes([Opcode.CHUNK]):
                    raise McapError("it points to places where no chunk is")
                known = known and all(i in summary.channels for i in index.message_index_offsets)
            if not known or not summary.channels or not summary.chunk_indexes:
                return None  # legal: channels not repeated at the end, or a file without chunks
            self.set_backs = set_backs(stream, summary.chunk_indexes)
        except READ_ERRORS as error:
            self._trouble = words(error)
            return None
        self.channels = {i: clean_channel(channel) for i, channel in summary.channels.items()}
        for schema in summary.schemas.values():
            self._learn(schema)
        if summary.statistics is not None:
            self._note_statistics(summary.statistics)
        return summary

    def _note_statistics(self, statistics: Statistics) -> None:
        self.declared = dict(statistics.channel_message_counts)
        if statistics.message_count and statistics.message_end_time < TIME:
            self.time_range = (statistics.message_start_time, statistics.message_end_time)

    def _indexed(self, stream: BinaryIO, summary: Summary, wanted: Callable) -> Iterator[list]:
        ids = {i for i, c in self.channels.items() if wanted(self.schemas.get(c.schema_id), c)}
        bad: list[str] = []
        keep, room = not self._kept, KEPT  # what one pass keeps the next one takes
        in_order = not self.set_backs
        chunks = sorted(summary.chunk_indexes, key=lambda c: (c.message_start_time * in_order, c.chunk_start_offset))
        used = [c for c in chunks if not c.message_index_offsets or not ids.isdisjoint(c.message_index_offsets)]
        for index, found in self._unpacked_ahead(stream, used):
            try:
                records, trouble = found()
                if trouble:
                    bad.append(f"at byte {index.chunk_start_offset}: {trouble}")
            except READ_ERRORS as error:
                bad.append(f"at byte {index.chunk_start_offset}: {words(error)}")
                continue
            if keep:
                room -= sum(len(record.data) for record in records if isinstance(record, Message))
                keep = room >= 0
            if keep:
                self._kept[index.chunk_start_offset] = records
            yield records
        self._note_chunks(bad, len(summary.chunk_indexes))

    def _unpacked_ahead(
        self, stream: BinaryIO, chunks: list[ChunkIndex]
    ) -> Iterator[tuple[ChunkIndex, Callable[[], tuple[list, str]]]]:
        """Chunks and what gives the records of each, see chunk_records: unpacked by other threads while the ones before
        are gone through, which takes less time than to unpack them."""
        budget, waiting = Budget(self.size), deque()
        small = all(index.uncompressed_size <= SMALL for index in chunks)
        with ThreadPoolExecutor(UNPACKERS) as pool:
            for index in chunks:
                if (known := self._kept.pop(index.chunk_start_offset, None)) is not None:
                    waiting.append((index, partial(tuple, (known, ""))))
                else:
                    # the limits that hold here hold there, too
                    made = pool.submit(copy_context().run, self._read_chunk, stream, index, budget)
                    waiting.append((index, made.result))
                while len(waiting) > UNPACKERS * small:
                    yield waiting.popleft()
            yield from waiting

    def _read_chunk(self, stream: BinaryIO, index: ChunkIndex, budget: "Budget") -> tuple[list, str]:
        """As chunk_records, of a chunk that is still in the file."""
        with budget.lock:  # there is one place in the file at a time
            stream.seek(index.chunk_start_offset + 9)
            body = stream.read(max(min(index.chunk_length - 9, self.size), 0))
        records, trouble = chunk_records(body, budget)
        if self.set_backs:
            put_after(self.set_backs, index.chunk_start_offset, records)
        return records, trouble

    def _linear(self, stream: BinaryIO) -> Iterator[list]:
        """All records from the start. Each is bounded by its own length, so that one bad chunk costs only itself."""
        stream.seek(len(MAGIC))
        crc, chunks, bad, ended, stop = zlib.crc32(MAGIC), 0, [], False, ""
        budget = Budget(self.size)
        position = len(MAGIC)
        while True:
            head = stream.read(9)
            if len(head) < 9:
                stop = "" if ended and head == MAGIC else "the file ends before its closing mark"
                break
            opcode, length = struct.unpack("<BQ", head)
            if opcode == MAGIC[0] and ended:
                break
            if length > self.size - position - 9:
                stop = f"the record at byte {position} is cut off or has an impossible length"
                break
            body = stream.read(length)
            try:
                if opcode == Opcode.CHUNK:
                    chunks += 1
                    records, trouble = chunk_records(body, budget)
                    if trouble:
                        bad.append(f"at byte {position}: {trouble}")
                    yield records
                elif opcode == Opcode.DATA_END:
                    expected = DataEnd.read(ReadDataStream(BytesIO(body))).data_section_crc
                    if expected and expected != crc and not bad:
                        self.damage.append("The checksum of the whole data does not match: some messages may be wrong.")
                    ended = True
                elif opcode == Opcode.STATISTICS:
                    self._note_statistics(Statistics.read(ReadDataStream(BytesIO(body))))
                elif opcode == Opcode.FOOTER:
                    stop = "" if stream.read() == MAGIC else "the file ends before its closing mark"
                    break
                elif not ended or opcode == Opcode.MESSAGE:
                    yield single_record(opcode, body)
            except READ_ERRORS as error:
                bad.append(f"at byte {position}: {words(error)}")
            if not ended:
                crc = zlib.crc32(body, zlib.crc32(head, crc))
            position += 9 + length
        self._note_chunks(bad, chunks)
        kept = sum(self.counts.values())
        if ended and (stop or self._trouble):
            why = stop or self._trouble
            self.damage.append(f"The index at the end is damaged ({why}); the data before it were read in file order.")
        elif stop or not ended:
            self.damage.append(
                f"{INCOMPLETE}{stop or 'it ends early'} (byte {position} of {self.size}); "
                f"kept the {kept} messages before that, how many are missing is not known. "
                "Was the recorder stopped hard, or the copy broken off?"
            )

    def _note_chunks(self, bad: list[str], total: int) -> None:
        if bad:
            first = "the first " if len(bad) > 1 else ""
            self.damage.append(f"{len(bad)} of {max(total, len(bad))} chunks cannot be read ({first}{bad[0]}).")


def single_record(opcode: int, body: bytes) -> list:
    """The schema, channel or message of a record outside of chunks, or nothing."""
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.MESSAGE:
        return [Message.read(stream, len(body))]
    if opcode == Opcode.SCHEMA:
        return [Schema.read(stream)]
    return [Channel.read(stream)] if opcode == Opcode.CHANNEL else []


def check_head(path: str, file: str, growing: bool = False) -> int:
    """Size of the file (itself or unpacked) in bytes; LogError unless it starts as MCAP, or, if it is still `growing`,
    unless it may come to do so."""
    if os.path.isdir(path):
        if not os.access(path, os.R_OK | os.X_OK):
            raise LogError(f"The folder '{path}' cannot be looked into. Check that you may read it.")
        raise LogError(f"'{path}' is a directory. Give the .mcap file itself (ROS 2 keeps it inside the bag's folder).")
    try:
        if os.path.exists(file) and not os.path.isfile(file):
            raise LogError(f"'{path}' is a pipe or a device, which can be read once only. Give a file.")
        with open(file, "rb") as stream:
            head = stream.read(len(MAGIC))
        size = os.path.getsize(file)
    except FileNotFoundError:
        raise LogError(f"There is no file '{path}'. Check the name and the folder.") from None
    except OSError as error:
        raise LogError(f"'{path}' cannot be opened: {error.strerror}. Check that you may read it.") from error
    if growing and MAGIC.startswith(head):
        return size
    if not head:
        raise LogError(f"'{path}' is empty (0 bytes). Was the recording started, and the copy finished?")
    if head != MAGIC:
        kind = next((kind for mark, kind in FOREIGN.items() if head.startswith(mark)), "")
        kind = "a C3D file" if head[1:2] == b"\x50" and head[0] < 32 else kind
        hint = f"It is {kind}: `voodoo-jax convert` makes an MCAP file of it." if kind else ""
        if head.startswith(b"RRF"):
            hint = "It is a recording of Rerun: give the log that it was made of."
        hint = hint or "Give a .mcap file; if this was one, it is damaged: copy it again."
        raise LogError(f"'{path}' is not an MCAP log: it does not start with the MCAP mark. {hint}")
    return size


def guarded(log: LogFile, wanted: Callable[[Schema | None, Channel], bool]) -> Iterator[Item]:
    """The messages of a log; what goes wrong below the level of chunks (a failing disk) comes out as LogError."""
    try:
        yield from log.messages(wanted)
    except READ_ERRORS as error:
        raise LogError(
            f"'{log.path}' cannot be read, or is damaged: {error}. Check the disk, and copy the file again."
        ) from error
