"""Kinds of damaged and hostile logs, each made of a small sound one by a seed.

The same seed and name give the same bytes. Of damage to a file (`files`) what is still read must be as it was.
"""

import random
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from experiments.fuzz import mcap_bytes as mcap
from experiments.fuzz.logs import U32, U64, Base, Log, Style, written

HOWS = ("", "lz4", "zstd")
GIB = 1 << 30


@dataclass(frozen=True)
class Input:
    """A log to try."""

    name: str  # kind/what
    make: Callable[[], bytes]
    damaged: bool = False  # the file, not its contents: frames must be as they were, and a refusal must say so
    large: bool = False  # takes seconds, or hundreds of megabytes
    by_chance: bool = False  # another seed makes another one

    @property
    def kind(self) -> str:
        return self.name.split("/")[0]


def chance(seed: int, name: str) -> random.Random:
    """What an input is made by."""
    return random.Random(f"{seed} {name}")


def mutated(data: bytes, rng: random.Random, most: int = 8) -> bytes:
    """With some bits turned, and bytes that are others, gone or more; or cut off."""
    out = bytearray(data)
    for _ in range(rng.randint(1, most)):
        if not out:
            return rng.randbytes(8)
        how, at = rng.random(), rng.randrange(len(out))
        if how < 0.5:
            out[at] ^= 1 << rng.randrange(8)
        elif how < 0.7:
            words = (0xFFFFFFFF, 0, 0x7FFFFFFF, 0x80000000, 0x7FC00000, 0x7F800000)  # the last ones: NaN and infinite
            out[at : at + 4] = struct.pack("<I", rng.choice(words))
        elif how < 0.8:
            del out[at : at + rng.randint(1, 16)]
        elif how < 0.9:
            out[at:at] = rng.randbytes(rng.randint(1, 16))
        else:
            del out[max(1, at) :]
    return bytes(out)


def files(base: Base, seed: int) -> Iterator[Input]:
    """Damage to the file."""
    for how in HOWS:
        said = how or "none"
        for number in range(30):
            yield _bytes(base, seed, f"bits/{said}/{number}", Style(how), _bits)
            yield _bytes(base, seed, f"head and tail/{said}/{number}", Style(how), _ends)
        for number in range(20):
            yield _bytes(base, seed, f"cut/{said}/{number}", Style(how), lambda d, rng: d[: rng.randrange(len(d))])
            yield _bytes(base, seed, f"blocks/{said}/{number}", Style(how), _blocks)
            # without checksums, as rosbag2 writes by default, nobody can know that a number is another one
            unseen = _bytes(base, seed, f"bits unchecked/{said}/{number}", Style(how, crc=False), _bits)
            yield replace(unseen, damaged=False)
        yield from _lengths(base, how)
    yield from _bombs(base)
    yield from _records(base)


def _bytes(base: Base, seed: int, name: str, style: Style, change: Callable[[bytes, random.Random], bytes]) -> Input:
    return Input(name, lambda: change(written(base.log, style), chance(seed, name)), damaged=True, by_chance=True)


def _bits(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 8, 64])):
        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _ends(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data)
    at_head = rng.random() < 0.5
    for _ in range(rng.choice([1, 4, 16])):
        out[rng.randrange(8, 90) if at_head else len(out) - rng.randrange(9, 900)] = rng.randrange(256)
    return bytes(out)


def _blocks(data: bytes, rng: random.Random) -> bytes:
    at, other, size = rng.randrange(8, len(data)), rng.randrange(8, len(data)), rng.choice([1, 9, 100, 4096, 65536])
    gone = data[:at], data[at + size :]
    return rng.choice([bytes(size), rng.randbytes(size), b"", data[other : other + size]]).join(gone)


def _lengths(base: Base, how: str) -> Iterator[Input]:
    def lie(name: str, crc: bool = False, index: bool = True, **lies: object) -> Input:
        return Input(f"{name}/{how or 'none'}", lambda: written(base.log, Style(how, crc, index, lies=lies)), True)

    for value in (0, 1, 1000, 2**31, 2**32, 2**40, 2**63, U64):
        for crc in (True, False):
            yield lie(f"size/{value}/crc {crc}", crc, size=value)
        yield lie(f"records length/{value}", length=value)
        for index in (True, False):
            yield lie(f"record length/{value}/index {index}", True, index, record=value)
    for other in (*HOWS, "zztd"):
        yield lie(f"compression/as {other or 'none'}", how=other)


def _bombs(base: Base) -> Iterator[Input]:
    def bomb(name: str, how: str, body: Callable[[], bytes], size: int, index: bool) -> Input:
        make = lambda: written(base.log, Style(how, False, index, lies={"body": body(), "size": size}))  # noqa: E731
        return Input(f"bomb/{name}/index {index}", make, damaged=True, large=True)

    for index in (True, False):
        for size in (1, 4, 64):
            for told in (0, size * GIB, 2**63):
                make = lambda s=size: mcap.zstd_zeros(s * GIB, False)  # noqa: E731
                yield bomb(f"zstd {size} GiB/told {told}", "zstd", make, told, index)
            make = lambda s=size: mcap.zstd_zeros(s * GIB, True)  # noqa: E731
            yield bomb(f"zstd head {size} GiB", "zstd", make, size * GIB, index)
        yield bomb("lz4 3 GiB", "lz4", lambda: mcap.lz4_zeros(3 * GIB), 3 * GIB, index)

    def eight() -> bytes:
        body = mcap.chunk(b"", (0, 2**63), "zstd", 0, GIB, mcap.zstd_zeros(GIB, True))
        return written(base.log, Style("zstd", index=False, after=8 * mcap.record(mcap.CHUNK, body)))

    yield Input("bomb/zstd 1 GiB eight times", eight, damaged=True, large=True)


def _records(base: Base) -> Iterator[Input]:
    log, r = base.log, mcap.record
    depth = log.number(base.depth)
    kind, other = log.channels[depth][2], log.channels[log.number(base.info)][2]
    first = log.of(base.depth)[0]
    whole = mcap.message(depth, first.time, first.data)
    strange = {
        "channel twice, other topic": r(mcap.CHANNEL, mcap.channel(depth, kind, "/other", "cdr")),
        "channel twice, other schema": r(mcap.CHANNEL, mcap.channel(depth, other, base.depth, "cdr")),
        "channel of no schema": r(mcap.CHANNEL, mcap.channel(77, 999, "/ghost", "cdr")),
        "channel without schema": r(mcap.CHANNEL, mcap.channel(78, 0, "/ghost", "cdr")),
        "schema 0": r(mcap.SCHEMA, mcap.schema(0, "x", "ros2msg", b"")),
        "schema twice": r(mcap.SCHEMA, mcap.schema(kind, "std_msgs/msg/String", "ros2msg", b"string data")),
        "message of no channel": r(mcap.MESSAGE, mcap.message(4242, first.time, first.data)),
        "message before its channel": r(mcap.MESSAGE, whole),
        "message too short": r(mcap.MESSAGE, b"\1\0"),
        "empty records": b"".join(r(opcode, b"") for opcode in range(1, 16)),
        "schema cut": r(mcap.SCHEMA, b"\1\0\xff\xff\xff\xff"),
        "topic of 4 GiB": r(mcap.CHANNEL, struct.pack("<HHI", 9, 1, U32) + b"x"),
        "metadata of 4 GiB": r(mcap.CHANNEL, mcap.channel(9, 1, "/t", "cdr")[:-4] + struct.pack("<I", U32)),
        "records of no kind": b"".join(r(opcode, b"abc") for opcode in (0, 16, 127, 128, 255)),
        "chunk in a chunk": r(mcap.CHUNK, mcap.chunk(r(mcap.MESSAGE, whole), (0, 1))),
        "attachment of 2^63": r(mcap.ATTACHMENT, bytes(16) + mcap.text("a") * 2 + struct.pack("<Q", 2**63)),
        "metadata of garbage": r(mcap.METADATA, bytes(range(256))),
        "end of the data": r(mcap.DATA_END, bytes(4)),
        "footer": r(mcap.FOOTER, bytes(20)),
        "mark": mcap.MAGIC,
        "no record": bytes(range(256)),
        "topic that is no UTF-8": r(mcap.CHANNEL, mcap.channel(79, other, b"/\xff\xfe\xc0", "cdr")),
        "10,000 records": r(200, b"") * 10_000,
    }
    for name, record in strange.items():
        for place in ("before", "inside", "after"):
            for index in (True, False):
                style = replace(Style("zstd", index=index), **{place: record})
                made = lambda style=style: written(log, style)  # noqa: E731
                yield Input(f"records/{name}/{place}/index {index}", made)


def names(base: Base) -> Iterator[Input]:
    """Names that harm terminals and folders, and many of them."""
    log, c = base.log, base.log.channels[base.log.number(base.depth)]
    odd: dict[str, str | bytes] = {
        "newline": "/a\nb", "control": "/\x1b[31m\x1b]0;owned\x07\x00\x7f", "way out": "../../../../voodoo_owned",
        "1 MB": "/" + "x" * 10**6, "empty": "", "right to left": "/\u202egnp.exe", "of another": base.info,
        "half a letter": "/\ud800".encode("utf-8", "surrogatepass"), "format": "/%s%n{0}{x.__class__}",
    }  # fmt: skip
    for name, topic in odd.items():
        yield Input(f"names/topic {name}", lambda topic=topic: written(log.renamed(base.depth, topic)))
        if isinstance(topic, str):
            yield Input(f"names/frame {name}", lambda topic=topic: written(_framed(base, topic)))
    empty = {1000 + n: (f"/t{n}", "cdr", c[2]) for n in range(5000)}
    yield Input("topics/5000 without messages", lambda: written(replace(log, channels={**log.channels, **empty})))
    for count in (300, 2000):
        yield Input(
            f"topics/{count} of depth", lambda count=count: written(_topics(base, count), Style("zstd")), large=True
        )


def _framed(base: Base, frame: str) -> Log:
    """With another name of the camera's frame."""
    old = base.images[0].header.frame_id
    log = base.edited(base.depth, lambda m, n: setattr(m.header, "frame_id", frame))

    def rename(m, n: int) -> None:
        for t in m.transforms:
            t.child_frame_id = frame if t.child_frame_id == old else t.child_frame_id

    return replace(base, log=log).edited(base.tf, rename)


def _topics(base: Base, count: int) -> Log:
    log = base.log
    kind, first = log.channels[log.number(base.depth)][2], log.of(base.depth)[0]
    channels = {1000 + n: (f"/camera{n}/depth", "cdr", kind) for n in range(count)}
    more = tuple(replace(first, channel=n) for n in channels)
    return replace(log, channels={**log.channels, **channels}, messages=(*log.messages, *more))


def schemas(base: Base) -> Iterator[Input]:
    """Definitions of types that nobody means."""
    rule = "=" * 80 + "\n"
    texts = {
        "empty": b"", "garbage": bytes(range(256)), "words": b"this is { no definition", "zeros": bytes(1000),
        "itself": b"std_msgs/Header header\nsensor_msgs/Image again\n",
        "loop": f"a/B b\n{rule}MSG: a/B\na/C c\n{rule}MSG: a/C\na/B b\n".encode(),
        "array of 2^31": b"std_msgs/Header header\nfloat64[2147483647] x\n",
        "array of 10^30": b"uint8[1000000000000000000000000000000] x\n", "array of -5": b"uint8[-5] x\n",
        "no such type": b"foo/Bar x\n", "100,000 fields": "".join(f"uint8 f{n}\n" for n in range(100_000)).encode(),
        "1 MB of comments": b"# comment\n" * 100_000, "twice": b"uint8 a\nuint8 a\n",
        "keywords": b"uint8 class\nuint8 lambda\n", "no UTF-8": b"\xff\xfe\xfd",
        "code": b"uint8 x=__import__('os').system('touch voodoo_owned')\n",
        "code in a name": b"uint8 a,b=__import__('os').system('touch${IFS}voodoo_owned')\n",
        "deep": "".join(f"a/T{n} x\n{rule}MSG: a/T{n}\n" for n in range(3000)).encode() + b"uint8 x\n",
    }  # fmt: skip
    for topic in (base.depth, base.info, base.tf):
        edited = lambda topic=topic, **parts: written(base.log.typed(topic, **parts))  # noqa: E731
        for name, text in texts.items():
            yield Input(f"schema/{name}/{topic}", lambda text=text, edited=edited: edited(text=text))
        for encoding in ("", "json", "protobuf", "ros1msg", "ros2idl", "flatbuffer", "\0"):
            yield Input(f"encoding/schema {encoding!r}/{topic}", lambda e=encoding, edited=edited: edited(encoding=e))
            other = lambda topic=topic, e=encoding: written(base.log.renamed(topic, encoding=e))  # noqa: E731
            yield Input(f"encoding/message {encoding!r}/{topic}", other)
        for name in (
            "foxglove.PointCloud",
            "sensor_msgs/msg/PointCloud2",
            "tf2_msgs/msg/TFMessage",
            "x" * 10**6,
            "",
            "a/b/c",
        ):
            yield Input(f"schema name/{name[:30]}/{topic}", lambda name=name, edited=edited: edited(name=name))


def messages(base: Base, seed: int) -> Iterator[Input]:
    """Messages of which bytes are others, with right checksums."""
    for topic in (base.depth, base.info, base.tf):
        change = lambda how, topic=topic: lambda: written(base.log.changed(topic, how))  # noqa: E731
        for number in range(14):
            name = f"cdr/{topic}/{number}"
            yield Input(
                name, lambda name=name, topic=topic: _mutated_messages(base, topic, chance(seed, name)), by_chance=True
            )
        for value in (0, 1, 2**16, 2**31 - 1, 2**31, U32):
            length = lambda d, n, value=value: d[:12] + struct.pack("<I", value) + d[16:]  # noqa: E731
            yield Input(f"cdr/{topic}/frame of {value} letters", change(length))
        yield Input(f"cdr/{topic}/empty", change(lambda d, n: b""))
        yield Input(f"cdr/{topic}/four bytes", change(lambda d, n: d[:4]))
        yield Input(f"cdr/{topic}/other byte order", change(lambda d, n: bytes(4) + d[4:]))
        yield Input(f"cdr/{topic}/last byte", change(lambda d, n: d[:-1]))
        noise = lambda d, n, topic=topic: chance(seed, f"{topic} {n}").randbytes(len(d))  # noqa: E731
        yield Input(f"cdr/{topic}/noise", change(noise), by_chance=True)


def _mutated_messages(base: Base, topic: str, rng: random.Random) -> bytes:
    return written(base.log.changed(topic, lambda d, n: mutated(d, rng)))


def png(columns: int, rows: int, told: tuple[int, int] | None = None) -> bytes:
    """A PNG of zeros, 16 bits; `told` the size that its head says."""
    part = lambda kind, d: struct.pack(">I", len(d)) + kind + d + struct.pack(">I", zlib.crc32(kind + d))  # noqa: E731
    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(bytes(1 + 2 * columns)) for _ in range(rows)) + packer.flush()
    head = struct.pack(">IIBBBBB", *(told or (columns, rows)), 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", data) + part(b"IEND", b"")


def rvl(columns: int, rows: int, numbers: list[int]) -> bytes:
    """An image packed by RVL of such runs and differences."""
    groups = []
    for number in numbers:
        while number >= 8:
            groups.append(number & 7 | 8)
            number >>= 3
        groups.append(number)
    groups += [0] * (-len(groups) % 8)
    words = [sum(v << (28 - 4 * i) for i, v in enumerate(groups[k : k + 8])) for k in range(0, len(groups), 8)]
    return struct.pack(f"<ii{len(words)}I", columns, rows, *words)
