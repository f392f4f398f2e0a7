"""The compile cache: second processes compile nothing, half an entry never stays, killed processes leave nothing."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from voodoo_jax.compile_cache import cache_folder

PROGRAM = """
import sys
from voodoo_jax.compile_cache import keep_compiled, use_compile_cache
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
    assert cache_folder("") == str(Path.home() / ".cache" / "voodoo_jax")
