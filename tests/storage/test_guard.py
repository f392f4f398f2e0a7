"""Whatever a parser of foreign files does costs a sentence."""

import os
import sys

import pytest

from voodoo_jax.storage.guard import Refused, Room, guarded
from voodoo_jax.storage.troubles import NotReadable, opened_file, small_file

ROOM = Room(memory=200 << 20, seconds=1, size=10 << 20)
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that can be copied")


def ran(name: str, *arguments: str, readable: tuple[str, ...] = ()) -> tuple[list[str], bytes]:
    found = bytearray()
    imports = ["tests.support.hostile"]
    return guarded(f"tests.support.hostile:{name}", arguments, readable, ROOM, found.extend, imports), bytes(found)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("crashes", r"its reader crashed \(SIGSEGV\)"),
        ("takes_memory", "more memory than is allowed .--limits.memory"),
        ("spins", "after 1 s of processor time it gave no result .--limits.seconds"),
        ("floods", "more than 10485760 bytes .--limits.log_bytes"),
        ("lies", "cannot be understood"),
        ("none", "no attribute 'none'"),
    ],
)
def test_what_a_parser_does_is_a_sentence(name, said):
    with pytest.raises(Refused, match=said):
        ran(name)
    assert ran("writes") == (["a note", "\x1b[31m"], b"x" * 1_000_000)  # and the next one is done


def test_one_that_waits_is_given_up(monkeypatch):
    monkeypatch.setattr("voodoo_jax.storage.guard.PATIENCE", -9.5)
    with pytest.raises(Refused, match="was stopped"):
        ran("waits")


def test_a_disk_that_is_full_is_told_to_who_asked():
    def full(data: bytes) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        guarded("tests.support.hostile:floods", (), (), ROOM, full, ["tests.support.hostile"])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Landlock and seccomp are Linux's")
def test_it_reads_what_was_named_and_reaches_nothing_else(tmp_path):
    (tmp_path / "mine").mkdir()
    secret, mine = tmp_path / "secret", tmp_path / "mine" / "file"
    secret.write_text("secret")
    mine.write_text("mine")
    notes, _ = ran("looks_round", str(secret), str(mine), readable=(str(mine.parent),))
    assert notes == ["reads what it may", "writes where it may"]
    assert secret.read_text() == "secret" and sorted(os.listdir(tmp_path)) == ["mine", "secret"]


def test_files_are_regular_and_inside(tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "good").write_bytes(b"good")
    (tmp_path / "secret").write_bytes(b"secret")
    (folder / "out").symlink_to("../secret")
    (folder / "within").symlink_to("good")
    (tmp_path / "link").symlink_to(folder)
    for path in (folder / "good", folder / "within", tmp_path / "link" / "good"):
        with opened_file(path, folder) as stream:
            assert stream.read() == b"good"
    for path in (
        folder / "out",
        folder / ".." / "secret",
        tmp_path / "secret",
        "/dev/zero",
        folder / "sub" / ".." / ".." / "secret",
    ):
        with pytest.raises(NotReadable, match="outside"):
            opened_file(path, folder)
    with pytest.raises(NotReadable, match="4 bytes, more than the 3"):
        small_file(folder / "good", folder, 3)
