"""Disks that are full, memory that is not there, links and others' files in the way: a sentence; nothing is lost."""

import os
from contextlib import suppress
from pathlib import Path

import pytest

from tests.exporters.test_tracks_files import make_tracks
from tests.support.faults import fail_writing
from voodoo_jax.config.limited import limited
from voodoo_jax.config.options import LimitSettings
from voodoo_jax.exporters.formats import export
from voodoo_jax.exporters.foxglove import GrowingTracks
from voodoo_jax.io.convert.errors import ConvertError
from voodoo_jax.io.convert.sources import convert
from voodoo_jax.storage.troubles import NotWritten
from voodoo_jax.storage.urls import file_system, within

TRC = "PathFileType\nUnits\nmm\nFrame#\tTime\tA\n\n" + "".join(f"{k}\t{k / 100}\t1\t2\t{k}\n" for k in range(1, 200))


@pytest.fixture
def source(tmp_path) -> Path:
    (tmp_path / "a.trc").write_text(TRC)
    return tmp_path / "a.trc"


@pytest.fixture(scope="module")
def tracks():
    return make_tracks()


def one_of(tracks):
    """Tracks of one frame."""
    return tracks.only(slice(3, 4))


@pytest.mark.parametrize("room", [0, 100, -1])
def test_a_full_disk_costs_no_earlier_log(room, source, tmp_path, monkeypatch):
    target = tmp_path / "a.mcap"
    convert(source, target)
    earlier = target.read_bytes()
    with monkeypatch.context() as faulty:
        fail_writing(faulty, "a.mcap", room)
        with pytest.raises(NotWritten, match="a.mcap' cannot be written: the disk"):
            convert(source, target)
    assert target.read_bytes() == earlier and sorted(os.listdir(tmp_path)) == ["a.mcap", "a.trc"]
    convert(source, target)


@pytest.mark.parametrize(
    ("allowed", "said"),
    [
        (LimitSettings(memory=1 << 18), "--limits.memory"),
        (LimitSettings(features=100), "198 points, more than the 100 .*--limits.features|--limits.features"),
        (LimitSettings(chunk_bytes=1000), "bytes, more than the 1000"),
        (LimitSettings(log_bytes=1000, log_times=0), "--limits.log_bytes"),
    ],
)
def test_what_asks_for_too_much_is_refused(allowed, said, source, tmp_path):
    with limited(allowed), pytest.raises(ConvertError, match=said):
        convert(source, tmp_path / "a.mcap")
    assert os.listdir(tmp_path) == ["a.trc"]


def test_nothing_is_written_through_links_or_over_what_is_not_ours(source, tmp_path):
    precious, target = tmp_path / "precious.mcap", tmp_path / "a.mcap"
    precious.write_bytes(b"precious")
    with pytest.raises(ConvertError, match="was not made by convert"):
        convert(source, precious)
    target.symlink_to(precious)
    with pytest.raises(ConvertError, match="was not made by convert"):
        convert(source, target)
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(ConvertError, match="pipe or a device"):
        convert(source, tmp_path / "pipe.mcap")
    (tmp_path / "new.mcap").symlink_to(tmp_path / "nowhere")  # is replaced, not followed
    convert(source, tmp_path / "new.mcap")
    assert precious.read_bytes() == b"precious" and not (tmp_path / "nowhere").exists()
    assert not (tmp_path / "new.mcap").is_symlink()


@pytest.mark.parametrize("room", [0, -1])
def test_live_keeps_an_earlier_result_until_there_is_another(room, tracks, tmp_path, monkeypatch):
    target = tmp_path / "a.voodoo.mcap"
    (tmp_path / "other").write_bytes(b"other")
    target.symlink_to("other")
    GrowingTracks(target).close()  # no frame came
    assert target.is_symlink() and sorted(os.listdir(tmp_path)) == ["a.voodoo.mcap", "other"]
    with monkeypatch.context() as faulty:
        fail_writing(faulty, target.name, room)
        grows = GrowingTracks(target)
        with pytest.raises(OSError):
            for _ in range(30):
                grows.frame(one_of(tracks))
        with suppress(OSError):
            grows.close()
        assert target.is_symlink()
    grows = GrowingTracks(target)
    grows.frame(one_of(tracks))
    assert not target.is_symlink() and (tmp_path / "other").read_bytes() == b"other"
    grows.close()


@pytest.mark.parametrize("kind", ["csv", "bvh", "gltf"])
def test_an_export_without_memory_or_disk_costs_no_earlier_one(kind, tracks, tmp_path, monkeypatch):
    ending = {"gltf": "glb"}.get(kind, kind)
    target = export(tracks, tmp_path / f"a.{ending}")
    earlier = target.read_bytes()
    with monkeypatch.context() as faulty:
        fail_writing(faulty, target.name, 10)
        with pytest.raises(NotWritten, match="the disk is full"):
            export(tracks, target)
    with monkeypatch.context() as faulty:
        faulty.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(MemoryError()))
        with pytest.raises(MemoryError):
            export(tracks, target)
    assert target.read_bytes() == earlier and os.listdir(tmp_path) == [target.name]


@pytest.mark.parametrize(
    "place", ["zip://a::http://x/y.zip", "ftp://x/a.mcap", "reference://x", "http://x/a::file://b"]
)
def test_addresses_within_addresses_are_refused(place):
    with pytest.raises(ValueError, match="unsupported URL"):
        file_system(place)


def test_within_a_folder(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "out").symlink_to(tmp_path)
    assert within(str(tmp_path / "in" / "a"), str(tmp_path / "in")) and within("s3://b/c/d", "s3://b/c")
    for place in (str(tmp_path / "in" / "out" / "a"), str(tmp_path / "in" / ".." / "a"), "http://x/a", "s3://b/cd"):
        assert not within(place, "s3://b/c" if place.startswith("s3") else str(tmp_path / "in"))
    assert not within("s3://b/c/../d", "s3://b/c")
