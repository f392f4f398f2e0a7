"""The layouts of MCAP's conformance tests, made anew: six contents, each with and without the parts that a file may
have. 416 files, byte for byte those of foxglove/mcap's tests/conformance/data (without the packed ones).

Packed chunks, which are not among those, are made in the same way.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations

from experiments.fuzz import mcap_bytes as mcap

# ch: chunks; mx: message indexes; chx: chunk index; rsh, rch: schemas and channels repeated at the end; st: statistics;
# ax, mdx: indexes of attachments and metadata; sum: where each group of these is; pad: records longer than needed
FEATURES = {
    "NoData": ("pad", "st", "sum"),
    "OneAttachment": ("ax", "pad", "st", "sum"),
    "OneMetadata": ("mdx", "pad", "st", "sum"),
    "OneMessage": ("ch", "chx", "mx", "pad", "rch", "rsh", "st", "sum"),
    "OneSchemalessMessage": ("ch", "chx", "mx", "pad", "rch", "st", "sum"),
    "TenMessages": ("ch", "chx", "mx", "pad", "rch", "rsh", "st", "sum"),
}
ENDING = {"ax", "mdx", "chx", "rch", "rsh", "st"}  # what `sum` tells the place of
PADDING = b"\x01\xff\xff"
DATA = b"\x01\x02\x03"
TIMES = (0, 2, 1, 3, 3, 5, 4, 7, 8, 9)  # of ten messages, not in order


@dataclass(frozen=True)
class Layout:
    """A file of the conformance tests."""

    case: str  # key of FEATURES
    features: frozenset[str]
    compression: str = ""  # of chunks

    @property
    def name(self) -> str:
        """As the file is called there."""
        return "-".join([self.case, *sorted(self.features), *filter(None, [self.compression])])


@dataclass(frozen=True)
class Content:
    """What a file holds."""

    schema: bytes = b""
    channel: bytes = b""
    # log time, publish time, number, content
    messages: list[tuple[int, int, int, bytes]] = field(default_factory=list)


def layouts(compression: str = "") -> Iterator[Layout]:
    """All files; packed: those that have chunks."""
    for case, known in FEATURES.items():
        for count in range(len(known) + 1):
            for chosen in map(frozenset, combinations(known, count)):
                legal = "ch" in chosen or not chosen & {"mx", "chx"}
                legal &= "sum" not in chosen or bool(chosen & ENDING)
                if legal and (not compression or "ch" in chosen):
                    yield Layout(case, chosen, compression)


def content(case: str) -> Content:
    """What files of a case hold."""
    if case in ("OneMessage", "TenMessages"):
        known = [mcap.schema(1, "Example", "c", b"\x04\x05\x06"), mcap.channel(1, 1, "example", "a", {"foo": "bar"})]
    elif case == "OneSchemalessMessage":
        known = [b"", mcap.channel(1, 0, "example", "text")]
    else:
        return Content()
    times = [(t, t, k) for k, t in enumerate(TIMES)] if case == "TenMessages" else [(2, 1, 10)]
    return Content(known[0], known[1], [(*some, DATA) for some in times])


class _Writer:
    """The bytes so far, and where things are in them."""

    def __init__(self, layout: Layout):
        self.layout, self.has, self.content = layout, layout.features, content(layout.case)
        self.out = mcap.MAGIC
        self.chunk_index = b""
        self.index: bytes | None = None  # of what else there is
        self.kind = mcap.METADATA_INDEX if layout.case == "OneMetadata" else mcap.ATTACHMENT_INDEX
        self.groups: list[bytes] = []

    def add(self, opcode: int, body: bytes, pad: bool = True) -> int:
        """Writes a record; where it begins."""
        at = len(self.out)
        self.out += mcap.record(opcode, body + (PADDING if pad and "pad" in self.has else b""))
        return at

    def group(self, opcode: int, body: bytes | None) -> None:
        """Writes what is repeated at the end, if there is such a thing."""
        if body:
            at = self.add(opcode, body)
            self.groups.append(struct.pack("<BQQ", opcode, at, len(self.out) - at))

    def data(self) -> None:
        known = [(mcap.SCHEMA, self.content.schema), (mcap.CHANNEL, self.content.channel)]
        messages = [mcap.message(1, log, data, sent, k) for log, sent, k, data in self.content.messages]
        if "ch" in self.has:
            return self.chunk(known, messages)
        for opcode, body in known:
            if body:
                self.add(opcode, body)
        for body in messages:
            self.add(mcap.MESSAGE, body, pad=False)
        if self.layout.case == "OneMetadata":
            at = self.add(mcap.METADATA, mcap.text("myMetadata") + mcap.mapping({"foo": "bar"}))
            self.index = struct.pack("<QQ", at, len(self.out) - at) + mcap.text("myMetadata")
        elif self.layout.case == "OneAttachment":
            names = mcap.text("myFile") + mcap.text("application/octet-stream")
            body = struct.pack("<QQ", 2, 1) + names + struct.pack("<Q", len(DATA)) + DATA
            at = self.add(mcap.ATTACHMENT, body + struct.pack("<I", zlib.crc32(body)))
            self.index = struct.pack("<QQQQQ", at, len(self.out) - at, 2, 1, len(DATA)) + names

    def chunk(self, known: list[tuple[int, bytes]], messages: list[bytes]) -> None:
        inside, entries = b"".join(mcap.record(opcode, body) for opcode, body in known if body), b""
        for body, (log, *_) in zip(messages, self.content.messages):
            entries += struct.pack("<QQ", log, len(inside))
            inside += mcap.record(mcap.MESSAGE, body)
        logged = [log for log, *_ in self.content.messages]
        times = min(logged), max(logged)
        body = mcap.chunk(inside, times, self.layout.compression)
        at = self.add(mcap.CHUNK, body, pad=False)
        end, places = len(self.out), {}
        if "mx" in self.has:
            places = {1: self.add(mcap.MESSAGE_INDEX, struct.pack("<HI", 1, len(entries)) + entries)}
        self.chunk_index = struct.pack("<QQQQ", *times, at, end - at) + mcap.offsets(places)
        self.chunk_index += struct.pack("<Q", len(self.out) - end) + mcap.text(self.layout.compression)
        self.chunk_index += struct.pack("<QQ", len(mcap.packed(inside, self.layout.compression)), len(inside))

    def ending(self) -> None:
        self.add(mcap.DATA_END, struct.pack("<I", zlib.crc32(self.out)), pad=False)
        start, c = len(self.out), self.content
        self.group(mcap.SCHEMA, c.schema if "rsh" in self.has else None)
        self.group(mcap.CHANNEL, c.channel if "rch" in self.has else None)
        if "st" in self.has:
            others = int(self.layout.case == "OneAttachment"), int(self.layout.case == "OneMetadata")
            counts = len(c.messages), int(bool(c.schema)), int(bool(c.channel)), *others, int("ch" in self.has)
            logged = [log for log, *_ in c.messages] or [0]
            each = {1: len(c.messages)} if c.messages else {}
            self.group(mcap.STATISTICS, mcap.statistics(counts, (min(logged), max(logged)), each))
        self.group(self.kind, self.index if self.has & {"ax", "mdx"} else None)
        self.group(mcap.CHUNK_INDEX, self.chunk_index if "chx" in self.has else None)
        summary = start if len(self.out) > start else 0
        places = len(self.out) if "sum" in self.has else 0
        for body in self.groups if "sum" in self.has else ():
            self.add(mcap.SUMMARY_OFFSET, body)
        footer = struct.pack("<BQQQ", mcap.FOOTER, 20, summary, places)
        self.out += footer + struct.pack("<I", zlib.crc32(self.out[start:] + footer)) + mcap.MAGIC


def written(layout: Layout) -> bytes:
    """The file."""
    writer = _Writer(layout)
    writer.add(mcap.HEADER, mcap.text("") + mcap.text(""))
    writer.data()
    writer.ending()
    return writer.out
