"""Damaged and hostile files at the doors other than MCAP, some hundred at each by chance (all with --long)."""

from dataclasses import replace

import pytest

from experiments.fuzz.atheris_target import begin_at, try_door
from experiments.fuzz.doors import ALLOWED, DOORS, changed, rows, tried
from experiments.fuzz.sound_files import sound_files

SEED, COUNT = 60, 250  # of the short run


@pytest.mark.parametrize("door", DOORS)
def test_some_hundred(door, request):
    """No crash, hang, memory, foreign bytes, request, lost result or escape; not all is refused, and not all read."""
    count = 2000 if request.config.getoption("--long") else COUNT
    allowed = ALLOWED if count > COUNT else replace(ALLOWED, memory=200 << 20, seconds=2.0)  # reached in less time
    found = list(tried(door, count, SEED, allowed=allowed))
    assert {one.name: one.harm for one in found if one.harm} == {} and len(found) == count
    assert 0.1 < sum(bool(one.refused) for one in found) / count < 0.97 or door == "pages"
    ((_, told, *_, escapes),) = rows(found)
    assert (told, escapes) == (str(count), "0")


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
