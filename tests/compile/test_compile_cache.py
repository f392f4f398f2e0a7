"""The compile cache: second processes compile nothing, half an entry never stays, killed processes leave nothing, and
nobody else's programs are run."""

import os
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import platformdirs
import pytest
import zstandard

from tests.support.small_logs import small_log
from voodoo_jax.cli.main import main
from voodoo_jax.compile import cache_dir
from voodoo_jax.compile.cache_dir import (
    CacheError,
    alone,
    cache_folder,
    keep,
    kept,
    link_all,
    refused,
    safe_folder,
)

PROGRAM = """
import sys
from voodoo_jax.compile.cache_dir import keep_compiled, use_compile_cache
import jax, jax.monitoring, jax.numpy as jnp
counted = {"hits": 0, "misses": 0}
def count(event, **_):
    for name in counted:
        counted[name] += event == f"/jax/compilation_cache/cache_{name}"
jax.monitoring.register_event_listener(count)
jnp.zeros(3) + 1  # something is compiled before
said = use_compile_cache(sys.argv[1])
counted.update(hits=0, misses=0)
jax.jit(lambda x: jnp.sin(x) @ x)(jnp.arange(5.0)).block_until_ready()
if "die" in sys.argv:
    keep_compiled()
    import os; os.kill(os.getpid(), 9)
print(counted["hits"], counted["misses"], said)
"""


def run(folder: Path, *words: str) -> subprocess.CompletedProcess:
    env = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    command = [sys.executable, "-c", PROGRAM, str(folder), *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, env=env)


def test_second_processes_compile_nothing(tmp_path):
    dead = run(tmp_path, "die")
    assert dead.returncode == -9
    (folder,) = tmp_path.iterdir()
    assert folder.name.startswith("jax-") and any(p.name.startswith("run-") for p in folder.iterdir())
    second = run(tmp_path)
    hits, misses, *said = second.stdout.split()
    assert int(hits) >= 1 and int(misses) == 0 and not said, second.stderr
    assert all(p.name.endswith("-cache") for p in folder.iterdir())  # what the dead one left is gone


def test_a_folder_that_cannot_be_used(tmp_path):
    (tmp_path / "file").write_text("mine")
    done = run(tmp_path / "file")
    assert done.returncode == 0 and "no compile cache in" in done.stdout, done.stderr


@pytest.mark.parametrize(
    "asked, variable, folder",
    [
        ("off", "/v", ""),
        ("/a", "/v", "/a"),
        ("", "/v", "/v"),
        ("", "off", ""),
        ("", "", "/x/voodoo_jax"),
    ],
)
def test_which_folder(asked, variable, folder, monkeypatch):
    monkeypatch.setenv("VOODOO_JAX_COMPILE_CACHE", variable)
    monkeypatch.setenv("XDG_CACHE_HOME", "/x")
    assert cache_folder(asked) == folder


def test_the_user_s_own_folder_where_nothing_is_said(monkeypatch):
    for name in ("VOODOO_JAX_COMPILE_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    assert cache_folder("") == str(platformdirs.user_cache_path("voodoo_jax", appauthor=False))


def test_without_a_home_that_the_system_knows(monkeypatch):
    for name in ("VOODOO_JAX_COMPILE_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    folder = Path(cache_folder(""))
    assert folder.parent == Path(tempfile.gettempdir()) and str(os.geteuid()) in folder.name


def test_a_new_folder_is_this_user_s_alone(tmp_path):
    before = os.umask(0o002)
    try:
        assert refused(str(tmp_path / "a" / "cache")) == ""
    finally:
        os.umask(before)
    for made in (tmp_path / "a" / "cache", *(tmp_path / "a" / "cache").iterdir()):
        assert made.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o1777], ids=oct)
def test_a_folder_that_others_can_write_is_refused(tmp_path, mode):
    """By its sentence; where it was named by an error, and else by a warning and no cache."""
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(mode)
    assert "other users can write in it" in refused(str(folder)) and "chmod go-w" in refused(str(folder))
    with pytest.raises(CacheError, match="other users can write in it"):
        safe_folder(str(folder))
    done = run(folder)
    assert done.returncode == 0 and "other users can write in it" in done.stdout, done.stderr
    assert not list(folder.glob("*/*"))


def test_the_folder_of_programs_in_it_counts_too(tmp_path):
    assert refused(str(tmp_path)) == ""
    (within,) = tmp_path.iterdir()
    within.chmod(0o777)
    assert str(within) in refused(str(tmp_path))


def test_a_folder_of_somebody_else_is_refused(tmp_path, monkeypatch):
    me = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: me + 1)
    assert "it belongs to another user" in refused(str(tmp_path))


def test_a_folder_that_anybody_can_exchange_is_refused(tmp_path):
    above = tmp_path / "above"
    (above / "cache").mkdir(parents=True)
    above.chmod(0o777)
    assert "anybody can replace the contents of" in refused(str(above / "cache"))
    above.chmod(0o1777)  # as /tmp
    assert refused(str(above / "cache")) == ""


def test_the_users_folder_is_left_out_with_one_warning(tmp_path, monkeypatch):
    monkeypatch.setenv("VOODOO_JAX_COMPILE_CACHE", str(tmp_path))
    tmp_path.chmod(0o777)
    with pytest.warns(RuntimeWarning, match="other users can write in it") as said:
        assert [safe_folder("") for _ in range(3)] == [""] * 3
    assert len(said) == 1


@pytest.fixture
def shared(tmp_path, monkeypatch) -> tuple[Path, Path]:
    """The shared folder and the own one of this process, as use_compile_cache leaves them, without jax's part."""
    folders = tmp_path / "jax", tmp_path / "jax" / "run-here-1-x"
    folders[1].mkdir(parents=True, mode=0o700)
    monkeypatch.setattr(cache_dir, "_own", {"asked": folders})
    return folders


def test_a_lock_that_is_a_link_harms_nobody(shared, tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("mine")
    (shared[0] / "lock-x").symlink_to(precious)
    with alone("x"):
        assert precious.read_text() == "mine"
    assert precious.read_text() == "mine"


def test_a_lock_of_before_is_not_emptied(shared):
    (shared[0] / "lock-x").write_text("kept")
    with alone("x"):
        assert (shared[0] / "lock-x").read_text() == "kept"


@pytest.mark.parametrize("how", ["link", "writable", "foreign", "pipe"])
def test_entries_of_others_are_not_read(shared, tmp_path, monkeypatch, how):
    """Whole entries by their checksum, that others have made or could have changed."""
    keep("x", b"program")
    assert kept("x") == b"program"
    entry, own = (folder / "program-x-cache" for folder in shared)
    if how == "link":
        entry.rename(tmp_path / "elsewhere")
        entry.symlink_to(tmp_path / "elsewhere")
    elif how == "writable":
        entry.chmod(0o666)
    elif how == "foreign":
        me = os.geteuid()
        monkeypatch.setattr(os, "geteuid", lambda: me + 1)
    else:
        entry.unlink()
        os.mkfifo(entry)
    assert kept("x") is None
    link_all(*shared)  # nor handed to jax
    assert not own.exists()


def test_a_start_links_no_executables_and_they_are_found_all_the_same(shared):
    """Thousands of versions' executables lie in a developer's folder."""
    keep("x", b"program")
    (shared[0] / "jit-cache").write_bytes(zlib.compress(b"of jax"))
    (shared[0] / "jit-cache").chmod(0o600)
    link_all(*shared)
    assert {path.name for path in shared[1].iterdir()} == {"jit-cache"}
    assert kept("x") == b"program"


def test_what_was_not_used_for_long_goes(shared):
    for name in ("used", "unused"):
        keep(name, b"program")
        os.utime(shared[0] / f"program-{name}-cache", (0, 0))
    assert kept("used") == b"program"
    cache_dir.sweep(shared[0])
    assert {path.name for path in shared[0].glob("*-cache")} == {"program-used-cache"}


def test_entries_are_this_user_s_alone_whatever_the_umask(shared):
    before = os.umask(0)
    try:
        keep("x", b"program")
        (shared[1] / "jit-cache").write_bytes(zlib.compress(b"of jax"))
        link_all(shared[1], shared[0])
    finally:
        os.umask(before)
    modes = {path.name: path.stat().st_mode & 0o777 for path in shared[0].iterdir() if path.is_file()}
    assert modes == {"program-x-cache": 0o600, "jit-cache": 0o600}


def test_half_an_entry_is_not_handed_on(tmp_path):
    """What jax has left on a full disk it would never write again."""
    own, handed = tmp_path / "run-here-1-x", tmp_path / "shared"
    own.mkdir()
    handed.mkdir()
    for name, pack in (("zstd", zstandard.compress), ("zlib", zlib.compress)):
        data = pack(bytes(range(256)) * 99)
        (own / f"{name}-cache").write_bytes(data)
        (own / f"half-{name}-cache").write_bytes(data[: len(data) // 2])
    (own / "none-cache").write_bytes(b"")
    cache_dir.link_all(own, handed)
    assert {path.name for path in handed.iterdir()} == {"zstd-cache", "zlib-cache"}
    assert {path.name for path in own.iterdir()} == {"zstd-cache", "zlib-cache"}


def test_the_command_refuses_a_named_folder(tmp_path, monkeypatch, capsys):
    """One of the environment it leaves out: an old line in a profile is no reason to lose a night's results."""
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o777)
    line = ["replay", str(tmp_path / "none.mcap"), "--out", str(tmp_path / "out")]
    assert main([*line, "--compile-cache", str(tmp_path / "cache")]) == 2
    assert "other users can write in it" in capsys.readouterr().err and not (tmp_path / "out").exists()
    monkeypatch.setenv("VOODOO_JAX_COMPILE_CACHE", str(tmp_path / "cache"))
    assert main(line) == 1
    assert "other users can write in it" in (said := capsys.readouterr().err) and "without a compile cache" in said


FROM_PYTHON = """
import sys
from pathlib import Path
import jax.monitoring
import voodoo_jax as vj
from tests.support.small_logs import SETTINGS, small_body
from voodoo_jax.compile.executable import Program

counted, made = {"traced": 0, "compiled": 0}, Program.traced
def traced(*args):
    counted["traced"] += 1
    return made(*args)
def loaded(event, **_):
    counted["compiled"] -= event == "/jax/compilation_cache/cache_hits"
def compiled(event, *_, **__):
    counted["compiled"] += event == "/jax/core/compile/backend_compile_duration"

if __name__ == "__main__":  # workers import this file
    Program.traced = traced
    jax.monitoring.register_event_listener(loaded)
    jax.monitoring.register_event_duration_secs_listener(compiled)
    log, out = sys.argv[1:]
    tracks = vj.track(small_body(), vj.read_log(log), SETTINGS)
    here = dict(counted)
    assert vj.replay_logs([log], out, small_body(), SETTINGS, quiet=True)[0].ok and tracks.tracked.any()
    print(*here.values(), *counted.values())
"""


def test_functions_called_from_python_load_what_processes_before_have_compiled(tmp_path):
    log, cache = small_log(tmp_path / "swing.mcap", 6), tmp_path / "cache"
    path = os.pathsep.join([str(Path(__file__).parents[1]), *filter(None, sys.path)])
    env = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    env |= {"VOODOO_JAX_COMPILE_CACHE": str(cache), "PYTHONPATH": path}

    def counts(out: str) -> list[int]:
        """In a new process: programs traced, and whatever was compiled, by track, and by it and replay."""
        command = [sys.executable, "-c", FROM_PYTHON, str(log), str(tmp_path / out)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=env)
        assert done.returncode == 0, done.stderr
        return [int(word) for word in done.stdout.split()]

    traced, compiled, *_ = counts("first")
    assert traced > 0 and compiled >= traced
    assert counts("second") == [0, 0, 0, 0]
    assert not list(cache.glob("*/run-*"))  # handed on, and nothing left
