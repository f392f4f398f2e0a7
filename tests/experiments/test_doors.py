"""Damaged and hostile files at the doors other than MCAP, some hundred at each by chance (all with --long)."""

import os
import subprocess
import sys
from pathlib import Path

from experiments.fuzz.atheris_target import begin_at, try_door
from experiments.fuzz.doors import DOORS, changed
from experiments.fuzz.sound_files import sound_files

SEED, COUNT = 60, 250  # of the short run


def test_some_hundred(request):
    """No crash, hang, memory, foreign bytes, request, lost result or escape; not all is refused, and not all read."""
    count, quick = (2000, []) if request.config.getoption("--long") else (COUNT, ["--quick"])
    # in a process of its own, where shapes and types are not checked, which takes four times as long
    words = [sys.executable, "-m", "experiments.fuzz.doors", "--seed", str(SEED), "--count", str(count), *quick]
    env = os.environ | {"OPENBLAS_NUM_THREADS": "1", "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(words, env=env, capture_output=True, text=True, cwd=Path(__file__).parents[2])
    assert done.returncode == 0 and "FAILED" not in done.stdout, done.stdout + done.stderr
    rows = {
        row[0]: row[1:] for row in (line.strip("| ").split(" | ") for line in done.stdout.splitlines()[2:]) if row[0]
    }
    assert set(rows) == set(DOORS) and all(int(row[0]) == count for row in rows.values())
    assert all(0.1 < int(row[1]) / count < 0.97 for door, row in rows.items() if door != "pages")


def test_the_same_seed_makes_the_same(tmp_path):
    import random

    (one,) = [sound for sound in sound_files("convert", tmp_path / "sound") if sound.name == "bag"]
    made = [changed(one, random.Random(k), tmp_path / name).read_bytes() for k, name in ((1, "a"), (1, "b"), (2, "c"))]
    assert made[0] == made[1] != made[2]


def test_the_targets_of_the_fuzzer(tmp_path, monkeypatch):
    """Each takes what its corpus begins with, without the fuzzer, which need not be installed."""
    for module in ("voodoo_jax.io.convert.sources", "voodoo_jax.model.foreign.sources"):
        monkeypatch.setattr(f"{module}.guarded", None)  # put back at the end
    for door in ("convert", "results"):
        begin_at(door, tmp_path / door)
        seeds = sorted((tmp_path / door).iterdir())
        assert len(seeds) >= 2 and try_door(door, seeds[0].read_bytes()) == "" != try_door(door, b"\0x")
