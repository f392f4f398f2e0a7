"""Damaged and hostile files at the doors other than MCAP, some hundred at each by chance (all with --long)."""

import pytest

from experiments.fuzz.doors import DOORS, changed, rows, tried
from experiments.fuzz.sound_files import sound_files

SEED, COUNT = 60, 250  # of the short run


@pytest.mark.parametrize("door", DOORS)
def test_some_hundred(door, request):
    """No crash, hang, memory, foreign bytes, request, lost result or escape; not all is refused, and not all read."""
    count = 2000 if request.config.getoption("--long") else COUNT
    found = list(tried(door, count, SEED))
    assert {one.name: one.harm for one in found if one.harm} == {} and len(found) == count
    assert 0.1 < sum(bool(one.refused) for one in found) / count < 0.97 or door == "pages"
    ((_, told, *_, escapes),) = rows(found)
    assert (told, escapes) == (str(count), "0")


def test_the_same_seed_makes_the_same(tmp_path):
    import random

    (one,) = [sound for sound in sound_files("convert", tmp_path / "sound") if sound.name == "bag"]
    made = [changed(one, random.Random(k), tmp_path / name).read_bytes() for k, name in ((1, "a"), (1, "b"), (2, "c"))]
    assert made[0] == made[1] != made[2]
