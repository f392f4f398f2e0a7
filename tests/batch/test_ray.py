"""Many logs on Ray: the same results from a cluster of one machine; a sentence where ray is missing."""

import importlib.util
import subprocess
import sys

import pytest

from tests.support.small_logs import FLAGS, SETTINGS, arrays_of, assert_same, small_body, small_log
from voodoo_jax.batch.replay import replay
from voodoo_jax.cli.main import main

ray_is_here = importlib.util.find_spec("ray") is not None


@pytest.mark.skipif(not ray_is_here, reason='ray is not installed (80 MB): pip install -e ".[ray]"')
def test_a_local_cluster_gives_the_same_results(tmp_path):
    """In a process of its own: Ray leaves threads and handlers behind. One log is none; the others are done."""
    logs = [small_log(tmp_path / f"{name}.mcap", 8, seed) for seed, name in enumerate("ab")]
    replay(logs, tmp_path / "here", small_body(), SETTINGS, quiet=True, compile_cache="")
    (tmp_path / "no.mcap").write_text("a diary")
    words = ["replay", *map(str, logs), str(tmp_path / "no.mcap"), "--out", str(tmp_path / "ray"), *FLAGS]
    command = [sys.executable, "-P", "-W", "error", "-m", "voodoo_jax.cli", *words, "--engine", "ray"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 1 and "2 of 3 logs tracked" in done.stdout, done.stderr
    assert "no.mcap: FAILED" in done.stdout and "MCAP" in done.stdout
    assert_same(arrays_of(tmp_path / "ray"), arrays_of(tmp_path / "here"))


def test_without_ray_it_is_said_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    (tmp_path / "a.mcap").write_text("no log")
    assert main(["replay", str(tmp_path / "a.mcap"), "--out", str(tmp_path / "o"), "--engine", "ray"]) == 2
    printed = capsys.readouterr().err
    assert 'pip install "voodoo_jax[ray]"' in printed and "--engine local" in printed and "Traceback" not in printed
