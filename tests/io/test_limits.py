"""Logs that ask for too much, or hold what nobody can mean: refused by their heads, with a sentence, and quickly."""

import random
import struct
import tracemalloc
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
import zstandard
from mcap.records import Channel, Schema

from tests.support.logs import PERIOD, START, K, depth_log, ros_point, ros_tf
from voodoo_jax.config.limited import limited
from voodoo_jax.config.options import LimitSettings
from voodoo_jax.geometry.lens import pixel_rays
from voodoo_jax.io.decode.image_codec import packed_depth, stored
from voodoo_jax.io.decode.registry import Decoder
from voodoo_jax.io.log_reader import LogError, read_log, survey
from voodoo_jax.io.transforms import Moving, Transform, TransformTree
from voodoo_jax.model.body_file import BodyFileError, load_on_host
from voodoo_jax.records.notes import plain, plain_name

# ten fields of the next type in each, five deep
NESTED = "".join(
    (f"{'=' * 80}\nMSG: a/T{depth}\n" if depth else "")
    + "".join(f"{f'a/T{depth + 1}' if depth < 5 else 'float64'} f{i}\n" for i in range(10))
    for depth in range(6)
)


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def chunk(packed: bytes, size: int) -> bytes:
    return record(6, struct.pack("<QQQII4sQ", 0, 0, size, 0, 4, b"zstd", len(packed)) + packed)


@pytest.mark.parametrize("told", [True, False])
def test_a_bomb_costs_itself(tmp_path, told):
    maker = zstandard.ZstdCompressor(write_content_size=told).compressobj(**({"size": 1 << 30} if told else {}))
    packed = b"".join([*(maker.compress(bytes(1 << 24)) for _ in range(64)), maker.flush()])
    path = tmp_path / "bomb.mcap"
    data = depth_log(3).write(path).read_bytes()
    path.write_bytes(data[:8] + chunk(packed, 1 << 30) + data[8:])
    recording = read_log(path)
    assert len(recording) == 3 and "unpacks to 1073741824 bytes, more than" in " ".join(recording.notes)


def test_a_chunk_of_zeros_is_no_messages(tmp_path):
    path = tmp_path / "zeros.mcap"
    data = depth_log(3).write(path).read_bytes()
    path.write_bytes(data[:8] + chunk(zstandard.compress(bytes(1 << 26)), 1 << 26) + data[8:])
    assert "bytes that are no records" in " ".join(read_log(path).notes)


def png(rows: int, columns: int) -> bytes:
    made = bytearray(cv2.imencode(".png", np.zeros((8, 8), np.uint16))[1].tobytes())
    made[16:24] = struct.pack(">II", columns, rows)
    made[29:33] = struct.pack(">I", zlib.crc32(made[12:29]))
    return bytes(made)


def jpeg(rows: int, columns: int) -> bytes:
    made = bytearray(cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes())
    at = made.index(b"\xff\xc0")
    made[at + 5 : at + 9] = struct.pack(">HH", rows, columns)
    return bytes(made)


@pytest.mark.parametrize("data", [png(30_000, 30_000), jpeg(30_000, 30_000)])
def test_pixels_are_counted_in_the_header(data):
    with pytest.raises(ValueError, match=f"900000000 pixels, more than the {LimitSettings().pixels}"):
        stored(data, "test")
    assert stored(png(8, 8), "test").shape == (8, 8) and stored(jpeg(8, 8), "test").shape == (8, 8, 3)


def packed(rows: int, columns: int, ending: str) -> bytes:
    """A small image whose header says that it is large."""
    made = bytearray(cv2.imencode(ending, np.full((8, 8, 3), 90, np.uint8))[1].tobytes())
    if ending == ".bmp":
        made[18:26] = struct.pack("<ii", columns, -rows)
    elif ending == ".webp":
        at = made.index(b"VP8 ") + 14 if b"VP8 " in made else made.index(b"VP8L") + 9
        made[at : at + 4] = (
            struct.pack("<HH", columns, rows)
            if b"VP8 " in made
            else struct.pack("<I", (columns - 1) | (rows - 1) << 14)
        )
    else:
        at = struct.unpack_from("<I", made, 4)[0] + 2
        for place in range(at, at + 12 * struct.unpack_from("<H", made, at - 2)[0], 12):
            if (tag := struct.unpack_from("<H", made, place)[0]) in (256, 257):
                struct.pack_into("<HHII", made, place, tag, 4, 1, columns if tag == 256 else rows)
    return bytes(made)


@pytest.mark.parametrize("ending", [".bmp", ".webp", ".tiff"])
def test_pixels_of_other_formats_are_counted_in_the_header(ending):
    whole = cv2.imencode(ending, np.full((8, 8, 3), 90, np.uint8))[1].tobytes()
    assert stored(whole, "test").shape[:2] == (8, 8)
    with pytest.raises(ValueError, match=f"{16_000 * 16_000} pixels, more than .*--limits.pixels"):
        stored(packed(16_000, 16_000, ending), "test")
    for cut in range(2, 26):
        with pytest.raises(ValueError):
            stored(whole[:cut], "test")


def test_formats_that_are_not_read_are_named():
    with pytest.raises(ValueError, match="not read"):
        stored(b"P5 30000 30000 255 " + bytes(64), "test")


def test_limits_are_settings(tmp_path):
    """Each of them changes what is read of a sound log, and what is left out says which option it was."""
    path = depth_log(3).write(tmp_path / "sound.mcap")
    whole = read_log(path)
    assert len(whole) == 3 and not any("--limits" in note for note in whole.notes)
    for name, value in [
        ("chunk_bytes", 100), ("chunk_messages", 1), ("pixels", 10), ("schema_bytes", 50),
        ("schema_lines", 2), ("schema_fields", 3), ("schemas_bytes", 10), ("topics", 1),
        ("log_bytes", 10), ("seconds", 1e-9),
    ]:  # fmt: skip
        with limited(replace(LimitSettings(), log_times=1, **{name: value})):
            try:
                said = " ".join(read_log(path).notes)
            except LogError as problem:
                said = str(problem)
        assert f"--limits.{name}" in said, (name, said)
    assert len(read_log(path)) == 3  # what was refused before is not remembered


def test_what_moves_and_what_is_named_is_bounded(tmp_path):
    """What comes after the limit is left out, with a sentence; what comes before it counts as ever."""
    log = depth_log(20)
    for i in range(20):
        at = START + i * PERIOD
        log.add("/tf", at, ros_tf((at, "base", "hand", (0.01 * i, 0, 0), (0, 0, 0, 1))))
        log.add("/wrist", at, ros_point(at, "hand", (1, 2, 3)))
    path = log.write(tmp_path / "moving.mcap")
    whole = read_log(path)
    assert all(frame.pairs.names for frame in whole) and not whole.notes
    with limited(replace(LimitSettings(), transforms=5)):
        few = read_log(path)
    assert any("20 transforms that move; those after 5 are left out (--limits.transforms)" in n for n in few.notes)
    for a, b in zip(list(whole)[:4], list(few)[:4], strict=True):
        np.testing.assert_array_equal(a.pairs.points, b.pairs.points)
    with limited(replace(LimitSettings(), features=7)):
        few = read_log(path)
    assert any("20 named features; those after 7 are left out (--limits.features)" in n for n in few.notes)
    assert sum(len(frame.pairs.names) for frame in few) == 7 and len(few) == 20


def test_transforms_take_little_memory():
    """A tenth of a gigabyte for a million of them, as the limit says."""
    tree, moving = TransformTree(), Moving()
    turn, place, count = np.array([0, 0, 0, 1.0]), np.zeros(3), 50_000
    tracemalloc.start()
    for i in range(count):
        moving.add(Transform(i, "base", "hand", place, turn), i)
    kept = tracemalloc.get_traced_memory()[0]
    tree.add_moving("hand", moving, np.zeros(count, np.int64))
    tree.close()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert kept < 100 * count and peak < 400 * count


def test_limbs_of_a_body_file_are_bounded():
    with limited(replace(LimitSettings(), limbs=3)), pytest.raises(BodyFileError, match="15 limbs.*--limits.limbs"):
        load_on_host("human")


def test_rays_of_a_huge_image_are_made_for_the_pixels_that_are_read():
    whole = pixel_rays(K, np.array([0.1, -0.05, 0, 0, 0]), "plumb_bob", 320, 240)
    few = pixel_rays(K, np.array([0.1, -0.05, 0, 0, 0]), "plumb_bob", 320, 240, 3)
    np.testing.assert_allclose(few, whole[::3, ::3], rtol=0, atol=1e-12)
    tracemalloc.start()
    pixel_rays(K, np.array([0.1, -0.05, 0, 0, 0]), "plumb_bob", 4096, 4096, 16)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 30e6  # all of them would be 3 GB


def test_a_jpeg_without_an_end_of_its_head():
    """Whatever its length, it costs no more than some thousand steps."""
    for filling in (b"\xff", b"\xff\x01"):
        with pytest.raises(ValueError, match="head does not end"):
            stored(b"\xff\xd8" + 5_000_000 * filling + b"\xff\xd9", "test")


def test_rvl_and_png_of_impossible_sizes():
    with pytest.raises(ValueError, match="1073741824 pixels"):
        packed_depth(0, "f", "16UC1; compressedDepth rvl", bytes(12) + struct.pack("<ii", 16384, 16384) + bytes(64))
    broken = bytearray(png(8, 8))
    broken[33:37] = b"\x70\0\0\0"  # the length of the pixels
    with pytest.raises(ValueError, match="damaged"):
        stored(bytes(broken), "test")


@pytest.mark.parametrize(
    "text, words",
    [
        ("a/B b\n" + "=" * 80 + "\nMSG: a/B\na/B[] b", "holds itself"),
        ("".join(f"float64 f{i}\n" for i in range(100_000)), "more than the"),
        (NESTED, "fields, more than"),
    ],
)
def test_schemas(text, words):
    """Looked at once, however many messages there are."""
    schema = Schema(data=text.encode(), encoding="ros2msg", id=1, name="tf2_msgs/msg/TFMessage")
    channel, decoder = Channel(topic="/tf", message_encoding="cdr", metadata={}, schema_id=1, id=1), Decoder()
    for _ in range(1000):
        with pytest.raises(ValueError, match=words):
            decoder.message(schema, channel, bytes(64))


@pytest.mark.parametrize(
    "translation, rotation",
    [
        ([1e38, 0, 0], [0, 0, 0, 1]),
        ([0, np.nan, 0], [0, 0, 0, 1]),
        ([0, 0, 0], [0, 0, 0, 1e-200]),
        ([0, 0, 0], [1e200, 0, 0, 0]),
        ([0, 0, 0], [0, np.inf, 0, 1]),
    ],
)
def test_transforms_that_nobody_can_mean(translation, rotation):
    tree = TransformTree()
    tree.add(Transform(0, "base", "camera", np.array(translation, float), np.array(rotation, float)), True)
    tree.add(Transform(0, "map", "base", np.array([5e5, 5e6, 1e2]), np.array([0, 0, 0, 2.0])), True)
    tree.close()
    assert tree.frames == ("base", "map") and "possible numbers" in tree.notes[0]


def test_names_that_differ_stay_different():
    long = ["x" * 150 + middle + "y" * 150 for middle in "ab"]
    shown = {plain_name(name) for name in (*long, "a\x1b", "a\\x1b", "/tiefe/ä")}
    assert len(shown) == 5 and "/tiefe/ä" in shown and all(name.isprintable() and len(name) < 220 for name in shown)


def test_names_are_spelt_out():
    assert plain("a\x1b[2J\nb\u202e") == "a\\x1b[2J\\nb\\u202e" and plain("/tiefe/ä") == "/tiefe/ä"
    assert len(plain("x" * 1_000_000)) < 200 and plain("caf\udce9") == "caf\\udce9"


def test_fuzz(tmp_path):
    """Bytes changed, cut out and doubled anywhere: frames, or a LogError that names the file."""
    path, chance = tmp_path / "fuzz.mcap", random.Random(40)
    whole = depth_log(3).write(path).read_bytes()
    for _ in range(60):
        data, at = bytearray(whole), chance.randrange(8, len(whole))
        how = chance.randrange(3)
        if how == 0:
            data[at : at + 8] = chance.choice([bytes(8), b"\xff" * 8, struct.pack("<d", 1e300), chance.randbytes(8)])
        elif how == 1:
            del data[at : at + chance.randrange(1, 200)]
        else:
            data[at:at] = data[at : at + chance.randrange(1, 2000)]
        path.write_bytes(data)
        try:
            table = str(survey(path))
            recording = read_log(path)
        except LogError as problem:
            assert "fuzz.mcap" in str(problem)
            continue
        assert table.isascii() and all(np.isfinite(frame.points).all() for frame in recording.frames)
        assert len(recording) == 3 or recording.notes  # never fewer without a word
