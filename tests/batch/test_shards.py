"""Parts of a list of logs."""

import random
from pathlib import Path

import pytest

from voodoo_jax.batch.output_paths import parse_shard, shard_of


@pytest.fixture
def sized_logs(tmp_path) -> list[str]:
    random_sizes = random.Random(3)
    paths = [tmp_path / f"{n:02d}.mcap" for n in range(23)]
    for path in paths:
        path.write_bytes(bytes(random_sizes.choice([10, 10, 200, 1000, 5000])))
    return [str(path) for path in paths]


@pytest.mark.parametrize("count", [1, 2, 5, 23, 40])
def test_parts_are_all_logs_and_no_log_twice(sized_logs, count):
    parts = [shard_of(sized_logs, number, count) for number in range(1, count + 1)]
    assert sorted(log for part in parts for log in part) == sorted(sized_logs)
    mixed = random.Random(1).sample(sized_logs, len(sized_logs))
    assert [set(shard_of(mixed, n, count)) for n in range(1, count + 1)] == [set(part) for part in parts]


def test_parts_are_of_about_one_size(sized_logs):
    sizes = [sum(Path(log).stat().st_size for log in shard_of(sized_logs, number, 3)) for number in (1, 2, 3)]
    assert max(sizes) - min(sizes) <= 5000


def test_logs_that_are_not_there_belong_to_a_part_too():
    gone = ["/nowhere/a.mcap", "/nowhere/b.mcap"]
    assert sorted(shard_of(gone, 1, 2) + shard_of(gone, 2, 2)) == gone


def test_words():
    assert parse_shard("") == (1, 1) and parse_shard("2/8") == (2, 8)
    for word in ("0/2", "3/2", "2", "/", "a/b", "-1/2"):
        with pytest.raises(ValueError, match="like 2/8"):
            parse_shard(word)
