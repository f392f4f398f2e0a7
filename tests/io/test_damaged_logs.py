"""Damaged logs: what can be read is read and the loss is named, or the error says in its own words what is wrong."""

import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType

from tests.support.logs import START, Log, chunks, definition, depth_log, foxglove_cloud, serialise
from voodoo_jax.io.log_reader import LogError, read_log, survey

N = 40
NONE, ZSTD, LZ4 = CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4


def build(tmp_path: Path, compression: CompressionType = NONE, log: Log | None = None, **options) -> bytes:
    """40 depth images, about five to a chunk; calibration and transform in the first chunk."""
    chunk_size = 5 * 1700
    path = (log or depth_log(N)).write(tmp_path / "built.mcap", compression, chunk_size, **options)
    return path.read_bytes()


def load(tmp_path: Path, data: bytes):
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read_log(path)


def patch(data: bytes, change: Callable[[bytearray, int, int], None], chunk: int = 3) -> bytes:
    found = bytearray(data)
    change(found, *chunks(data)[chunk])
    return bytes(found)


# A chunk's content: start, end, uncompressed size (8 each), crc (4), compression (4 + n), length (8), records.
def flip(b: bytearray, at: int, length: int) -> None:
    b[at + length - 5] ^= 0xFF


def wrong_crc(b: bytearray, at: int, length: int) -> None:
    b[at + 24 : at + 28] = struct.pack("<I", 12345)


def rename(b: bytearray, at: int, length: int) -> None:
    assert b[at + 32 : at + 36] == b"zstd"
    b[at + 32 : at + 36] = b"zztd"


def rename_without_crc(b: bytearray, at: int, length: int) -> None:
    rename(b, at, length)
    b[at + 24 : at + 28] = bytes(4)


def size(value: int) -> Callable:
    def change(b: bytearray, at: int, length: int) -> None:
        b[at + 16 : at + 24] = struct.pack("<Q", value)

    return change


def records_length(value: int) -> Callable:
    def change(b: bytearray, at: int, length: int) -> None:
        n = struct.unpack_from("<I", b, at + 28)[0]
        b[at + 32 + n : at + 40 + n] = struct.pack("<Q", value)

    return change


def record_length(value: int) -> Callable:
    def change(b: bytearray, at: int, length: int) -> None:
        b[at - 8 : at] = struct.pack("<Q", value)

    return change


def unknown_channel(b: bytearray, at: int, length: int) -> None:
    position = at + 40 + struct.unpack_from("<I", b, at + 28)[0]
    while b[position] != 5:
        position += 9 + struct.unpack_from("<Q", b, position + 1)[0]
    b[position + 9 : position + 11] = struct.pack("<H", 77)


def footer(data: bytes, value: int) -> bytes:
    return data[:-28] + struct.pack("<Q", value) + data[-20:]


NO_INDEX = {
    "index_types": IndexType.NONE,
    "repeat_channels": False,
    "repeat_schemas": False,
    "use_statistics": False,
    "use_summary_offsets": False,
}


@pytest.mark.parametrize("compression", [NONE, LZ4, ZSTD])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"use_chunking": False},
        NO_INDEX,
        {"index_types": IndexType.CHUNK},
        {"repeat_channels": False, "repeat_schemas": False},
        {"use_statistics": False},
        {"enable_crcs": False},
        {"enable_data_crcs": True},
    ],
    ids=lambda options: "-".join(options)[:30] or "plain",
)
def test_legal_layouts_are_read_in_full(tmp_path, compression, options):
    recording = load(tmp_path, build(tmp_path, compression, **options))
    assert len(recording) == N and recording.notes == ()
    assert survey(tmp_path / "damaged.mcap").topics[1].count == N


@pytest.mark.parametrize(
    "compression, change",
    [
        (NONE, flip),
        (LZ4, flip),
        (ZSTD, flip),
        (NONE, wrong_crc),
        (ZSTD, rename),
        (ZSTD, rename_without_crc),
        (NONE, records_length(0)),
        (ZSTD, records_length(0)),
        (NONE, records_length(2**63)),
        (NONE, unknown_channel),
    ],
)
@pytest.mark.parametrize("indexed", [True, False])
def test_a_broken_chunk_costs_only_itself(tmp_path, compression, change, indexed):
    data = build(tmp_path, compression, **({} if indexed else NO_INDEX))
    recording = load(tmp_path, patch(data, change))
    lost = N - len(recording)
    assert 3 <= lost <= 8 and len(chunks(data)) >= 6
    assert any("1 of" in n and "chunks cannot be read" in n for n in recording.notes)
    if indexed:
        assert any(f"'/cam/depth': kept {N - lost} of {N} messages, {lost} cannot" in n for n in recording.notes)


def test_every_chunk_broken(tmp_path):
    data = build(tmp_path)
    for chunk in range(len(chunks(data))):
        data = patch(data, flip, chunk)
    with pytest.raises(LogError, match="is damaged: no message of '/cam/depth' can be read.*the first at byte"):
        load(tmp_path, data)
    assert survey(tmp_path / "damaged.mcap").topics[1].use == f"not used: none of its {N} messages can be read"


@pytest.mark.parametrize(
    "change", [size(0), size(2**40), records_length(2**40), record_length(2**63), record_length(3 * 2**30)]
)
@pytest.mark.parametrize("compression", [NONE, ZSTD])
def test_wrong_lengths_that_cost_nothing(tmp_path, compression, change):
    assert len(load(tmp_path, patch(build(tmp_path, compression), change))) == N


def test_impossible_record_length_without_index(tmp_path):
    recording = load(tmp_path, patch(build(tmp_path, **NO_INDEX), record_length(2**63)))
    assert 10 <= len(recording) < 20
    assert any("incomplete" in n and "impossible length" in n for n in recording.notes)


@pytest.mark.parametrize("compression", [NONE, LZ4, ZSTD])
def test_truncated(tmp_path, compression):
    data = build(tmp_path, compression)
    recording = load(tmp_path, data[: len(data) // 2])
    assert N / 4 <= len(recording) <= N * 3 / 4
    (note,) = recording.notes
    assert f"kept the {len(recording) + 2} messages before that" in note and "incomplete" in note
    assert survey(tmp_path / "damaged.mcap").warnings == recording.notes


def test_cut_at_a_record(tmp_path):
    data = build(tmp_path)
    recording = load(tmp_path, data[: chunks(data)[3][0] - 9])
    assert 10 <= len(recording) < 20 and any("how many are missing is not known" in n for n in recording.notes)


def test_crashed_recorder(tmp_path):
    recording = load(tmp_path, build(tmp_path, log=depth_log(N + 1), finish=False))
    assert N - 10 <= len(recording) <= N and any("Was the recorder stopped hard" in n for n in recording.notes)


@pytest.mark.parametrize("missing", [1, 8, 20, 36])
def test_end_of_file_missing(tmp_path, missing):
    recording = load(tmp_path, build(tmp_path)[:-missing])
    assert len(recording) == N and any("index at the end is damaged" in n for n in recording.notes)


def test_two_files_in_one(tmp_path):
    data = build(tmp_path)
    assert len(load(tmp_path, data + data)) == N


@pytest.mark.parametrize("value", [2**40, 9, 0])
def test_wrong_footer(tmp_path, value):
    assert len(load(tmp_path, footer(build(tmp_path), value))) == N


def test_index_points_nowhere(tmp_path):
    data = build(tmp_path, enable_crcs=False)
    for value in (2**40, 8):
        found, at = bytearray(data), 8
        while found[at] != 8:
            at += 9 + struct.unpack_from("<Q", found, at + 1)[0]
        found[at + 25 : at + 33] = struct.pack("<Q", value)
        recording = load(tmp_path, bytes(found))
        assert len(recording) == N and any("where no chunk is" in n for n in recording.notes)


def test_changed_byte_in_the_index(tmp_path):
    data = bytearray(build(tmp_path))
    at = data.rfind(b"/cam/depth")
    data[at + 1 : at + 4] = b"rat"
    recording = load(tmp_path, bytes(data))
    assert len(recording) == N and recording.sensors == ("/cam/depth",)


def test_unknown_channel_without_crc(tmp_path):
    data = patch(build(tmp_path, enable_crcs=False), unknown_channel)
    recording = load(tmp_path, data)
    assert len(recording) == N - 1
    assert any("Messages of no known channel, left out: 1" in n for n in recording.notes)
    assert any(f"kept {N - 1} of {N} messages" in n for n in recording.notes)


@pytest.mark.parametrize(
    "data, words",
    [
        (b"", "is empty"),
        (b"hello world, this is not mcap\n" * 20, "is not an MCAP log"),
        (b"PathFileType\t4\t(X/Y/Z)\twalk.trc\n" * 5, "TRC"),
        (b"\x02\x50" + bytes(510), "C3D"),
        (b"RRF2" + bytes(100), "Rerun"),
        (b"#ROSBAG V2.0\n" * 20, "is a ROS 1 bag"),
        (b"\x89MCAP0\r\n", "holds no messages.*incomplete"),
        (b"\x89MCAP0\r\n" * 2, "holds no messages"),
    ],
)
def test_no_log_at_all(tmp_path, data, words):
    with pytest.raises(LogError, match=words):
        load(tmp_path, data)


def test_no_file_and_directory(tmp_path):
    with pytest.raises(LogError, match="There is no file"):
        read_log(tmp_path / "nothing.mcap")
    with pytest.raises(LogError, match="is a directory"):
        read_log(tmp_path)


def test_empty_log(tmp_path):
    with pytest.raises(LogError, match="holds no messages. Nothing was recorded"):
        read_log(Log().write(tmp_path / "a.mcap"))


def spoil(change: Callable[[bytes], bytes], which: set[int]) -> Log:
    """depth_log with some raw images changed."""
    log, image = Log(), -1
    for topic, time, message in depth_log(N).items:
        if topic == "/cam/depth":
            image += 1
            if image in which:
                name, _, data = serialise(message)
                # The type's definition is taken from the first message, which is whole.
                message = (name, change(data))
        log.add(topic, time, message)
    return log


BAD_IMAGE = {
    "empty": lambda data: b"",
    "cut": lambda data: data[:200],
    "header only": lambda data: data[:14],
    "string of 4 GiB": lambda data: data[:12] + struct.pack("<I", 2**32 - 1) + data[16:],
    "other byte order": lambda data: bytes(4) + data[4:],
}


@pytest.mark.parametrize("name", BAD_IMAGE)
def test_broken_messages_are_counted(tmp_path, name):
    recording = load(tmp_path, build(tmp_path, log=spoil(BAD_IMAGE[name], {5, 9})))
    assert len(recording) == N - 2
    assert any("'/cam/depth': 2 messages cannot be decoded, left out" in n for n in recording.notes)


@pytest.mark.parametrize("name", BAD_IMAGE)
def test_all_messages_broken(tmp_path, name):
    log = spoil(BAD_IMAGE[name], set(range(N)))
    log.schema_text["sensor_msgs/msg/Image"] = definition("sensor_msgs/msg/Image", "cdr", None)
    with pytest.raises(LogError, match="no depth message can be decoded"):
        load(tmp_path, build(tmp_path, log=log))


@pytest.mark.parametrize(
    "text", [b"this is { not a msg def", b"std_msgs/Header header\nPoint point\n", b"\xff\xfe", b"\n"]
)
def test_broken_schema(tmp_path, text):
    log = depth_log(3)
    log.schema_text["sensor_msgs/msg/Image"] = text
    with pytest.raises(LogError, match="no depth message can be decoded"):
        load(tmp_path, build(tmp_path, log=log))


def test_broken_transform_is_named(tmp_path):
    log = depth_log(3)
    log.add("/tf_static", START, ("tf2_msgs/msg/TFMessage", b"\x00\x01\x00\x00\xff\xff\xff\xff"))
    recording = load(tmp_path, build(tmp_path, log=log))
    assert len(recording) == 3 and any("'/tf_static': 1 message cannot be decoded" in n for n in recording.notes)


def test_empty_protobuf_cloud_is_broken(tmp_path):
    points = np.array([[1.0, 2.0, 3.0]])
    log = Log().add("/p", START, foxglove_cloud(START, "l", points))
    log.add("/p", START + 1, ("foxglove.PointCloud", b"")).add("/p", START + 2, ("foxglove.PointCloud", b"\xff\xff"))
    recording = load(tmp_path, build(tmp_path, log=log))
    assert len(recording) == 1 and any("2 messages cannot be decoded" in n for n in recording.notes)


def test_shuffled_log_times(tmp_path):
    log = depth_log(N)
    log.items = [(t, START + (7 * i * 33_000_000) % (41 * 33_000_000), m) for i, (t, _, m) in enumerate(log.items)]
    recording = load(tmp_path, build(tmp_path, log=log))
    assert len(recording) == N and [f.time_ns for f in recording] == sorted(f.time_ns for f in recording)
