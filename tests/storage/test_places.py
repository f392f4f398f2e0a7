"""Places that cannot be read or written: pipes, links in a circle, folders in the way, disks that are memory."""

import errno
import os
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from voodoo_jax.cli.main import main
from voodoo_jax.exporters.npz import TracksFileError, read_tracks_npz
from voodoo_jax.fitting.checkpoint import load_progress
from voodoo_jax.fitting.frames import TruthError, read_truth
from voodoo_jax.storage.atomic import check_writable, made_folder, replacing
from voodoo_jax.storage.scratch import VARIABLE, in_memory, nameless_file
from voodoo_jax.storage.troubles import NotReadable, NotWritten, check_text, not_written, small_file, small_text
from voodoo_jax.storage.urls import expanded, opened

DEMO = str(files("voodoo_jax") / "data" / "demo.mcap")
needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")


@pytest.fixture
def pipe(tmp_path) -> Path:
    """A named pipe that nobody writes into: who reads it waits for ever."""
    os.mkfifo(tmp_path / "pipe.toml")
    return tmp_path / "pipe.toml"


@needs_pipes
def test_pipes_and_devices_are_not_waited_for(pipe):
    for place in (str(pipe), "/dev/zero"):
        with pytest.raises(NotReadable, match="pipe or a device"):
            small_file(place)
        with pytest.raises(NotReadable, match="pipe or a device"), opened(place):
            pass
        with pytest.raises(OSError, match="pipe or a device"):
            read_tracks_npz(place)
        with pytest.raises(TruthError, match="pipe or a device"):
            read_truth(place)
        assert load_progress(place, "") is None


@needs_pipes
@pytest.mark.parametrize(
    "words",
    [
        ["replay", DEMO, "--config", "PIPE"],
        ["replay", DEMO, "--body", "PIPE"],
        ["config", "--config", "PIPE"],
        ["info", DEMO, "--read.camera", "PIPE"],
        ["info", "PIPE"],
        ["export", "PIPE", "--as", "csv"],
        ["view", "PIPE", "--once"],
        ["convert", "PIPE", "--out", "o.mcap"],
        ["body", "PIPE", "--out", "b.toml"],
        ["fit", "PIPE", "--out", "b.toml"],
    ],
    ids=lambda words: " ".join(words[:1] + words[-2:-1]),
)
def test_every_command_refuses_a_pipe(words, pipe, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([str(pipe) if word == "PIPE" else word for word in words]) in (1, 2)
    printed = capsys.readouterr().err
    assert "pipe" in printed and "unexpected" not in printed and "Traceback" not in printed


def test_a_link_that_leads_back_up_is_not_followed(tmp_path):
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "a.mcap").write_bytes(b"")
    (tmp_path / "below" / "up").symlink_to(tmp_path)
    (tmp_path / "self").symlink_to(tmp_path)
    assert expanded(tmp_path) == [str(tmp_path / "below" / "a.mcap")]


def test_a_folder_that_must_not_be_looked_into_stands_for_itself(tmp_path, monkeypatch):
    (tmp_path / "a.mcap").write_bytes(b"")
    (tmp_path / "locked").mkdir()
    real = os.listdir

    def listed(folder):
        if Path(folder).name == "locked":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), folder)
        return real(folder)

    monkeypatch.setattr(os, "listdir", listed)
    assert expanded(tmp_path) == [str(tmp_path / "a.mcap"), str(tmp_path / "locked")]


def test_folders_in_the_way(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "x.npz").mkdir()
    for place, why in (("file", "a file"), ("file/below", "no folder")):
        with pytest.raises(NotWritten, match=f"{place}' cannot be written: .*{why}"):
            made_folder(tmp_path / place)
    for place, why in (("x.npz", "folder of this name"), ("gone/y", "does not exist"), ("z" * 300, "too long")):
        with pytest.raises(NotWritten, match=why):
            check_writable(tmp_path / place)
    with pytest.raises(NotWritten, match="folder of this name"), replacing(tmp_path / "x.npz") as partial:
        partial.write_text("half")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "x.npz"]
    assert (tmp_path / "file").read_text() == "mine"


def test_errors_of_others_are_left_alone(tmp_path):
    """What is read while a file is written fails as itself, not as the file that is written."""
    with pytest.raises(FileNotFoundError) as caught, replacing(tmp_path / "a"):
        (tmp_path / "log.mcap").read_bytes()
    assert not isinstance(caught.value, NotWritten) and not list(tmp_path.iterdir())
    again = not_written(OSError(errno.ENOSPC, "full"), "a")
    assert not_written(again, "b") is again and again.errno == errno.ENOSPC


def test_texts_of_all_systems(tmp_path):
    (tmp_path / "a").write_bytes(b"\xef\xbb\xbfa = 1\r\nb = 2\r\n")
    assert small_text(tmp_path / "a") == "a = 1\nb = 2\n"
    check_text("/ä/b", "--out")
    with pytest.raises(ValueError, match="--out '.*udcff': a name in it is not UTF-8"):
        check_text(os.fsdecode(b"/b\xff"), "--out")


def test_points_wait_on_a_disk_and_not_in_memory(tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path / "made" / "here"))
    with nameless_file() as file:
        file.write(b"x")
        assert (tmp_path / "made" / "here").is_dir() and not list((tmp_path / "made" / "here").iterdir())
    if os.path.ismount("/dev/shm") and in_memory("/dev/shm"):
        assert in_memory("/dev/shm/none/below") and not in_memory("/proc")
        monkeypatch.setenv(VARIABLE, "/dev/shm")
        with pytest.raises(OSError, match="no folder on a disk"):
            nameless_file()
    monkeypatch.setenv(VARIABLE, "/proc/none")
    with pytest.raises(OSError):
        nameless_file()


@pytest.mark.parametrize(
    "change",
    [
        {"time_ns": lambda a: a[::-1]},
        {"time_ns": lambda a: a.astype(str)},
        {"rotation": lambda a: a * 0},
        {"rotation": lambda a: a + np.float32(np.inf)},
        {"joints": lambda a: a.astype(str)},
        {"limb_weight": lambda a: a[:, :1]},
        {"body_toml": lambda a: np.array("no body")},
        {"notes": lambda a: np.array("x")},
        {"seconds": lambda a: np.array("x")},
        {"people": lambda a: np.array(10**9)},
    ],
    ids=lambda change: next(iter(change)),
)
def test_tracks_files_are_checked_array_by_array(change, a_tracks_file, tmp_path):
    with np.load(a_tracks_file) as file:
        arrays = dict(file)
    ((name, changed),) = change.items()
    del arrays["digest"]  # which tells accidents
    arrays[name] = changed(arrays.get(name, np.zeros(0)))
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(TracksFileError, match=f"a.npz.*{name.removesuffix('_toml')}"):
        read_tracks_npz(tmp_path / "a.npz")


@pytest.fixture(scope="module")
def a_tracks_file(tmp_path_factory) -> Path:
    """Tracks of two frames of a body that stands still."""
    from tests.support.helpers import two_limbs
    from voodoo_jax.exporters.npz import write_tracks_npz
    from voodoo_jax.records.tracks import Evidence, Tracks

    body, path = two_limbs(), tmp_path_factory.mktemp("tracks") / "a.npz"
    limbs, numbers = body.limb_count, lambda *shape: np.ones((2, *shape), np.float32)
    rotation = np.tile(np.array([1, 0, 0, 0], np.float32), (2, limbs, 1))
    tracks = Tracks(
        source="a.mcap", fixed_frame="base", body=body, time_ns=np.array([0, 33_000_000]), rotation=rotation,
        translation=numbers(limbs, 3), joints=numbers(len(body.topology.centres), 3), status=np.zeros(2, np.int8),
        evidence=Evidence.blank(2, limbs), joint_confidence=numbers(len(body.topology.centres)),
    )  # fmt: skip
    write_tracks_npz(tracks, path)
    assert len(read_tracks_npz(path).time_ns) == 2
    return path
