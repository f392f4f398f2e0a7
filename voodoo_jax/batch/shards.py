"""Parts of a list of logs, one for each machine or array job."""

from collections.abc import Sequence

from voodoo_jax.storage.urls import byte_size

MOST = 100_000  # parts: schedulers start fewer array jobs at once


def parse_shard(text: str) -> tuple[int, int]:
    """ "2/8" as (2, 8); "" as (1, 1). Raises ValueError."""
    number, _, count = (text or "1/1").partition("/")
    try:
        i, n = int(number), int(count)
    except ValueError:
        i, n = 0, 0
    if not 1 <= i <= n <= MOST:
        raise ValueError(
            f"--shard {text}: must look like 2/8, the second of eight parts, from 1/8 on, with at most {MOST} parts"
        )
    return i, n


def shard_of(logs: Sequence[str], number: int, count: int) -> list[str]:
    """The logs of part `number` (1 .. `count`), in the order given.

    Parts are of about equal bytes: the largest log first, each to the part that has least so far. The same logs give
    the same parts in whatever order they are named.
    """
    if count == 1:
        return list(logs)
    count = min(count, max(number, len(logs)))  # more parts than logs have none
    if number > len(logs):
        return []
    sizes = {log: byte_size(log) for log in logs}
    parts: list[list[str]] = [[] for _ in range(count)]
    bytes_in = [0] * count
    for log in largest_first(logs, sizes):
        least = min(range(count), key=lambda k: (bytes_in[k], len(parts[k]), k))
        parts[least].append(log)
        bytes_in[least] += sizes[log]
    mine = set(parts[number - 1])
    return [log for log in logs if log in mine]


def largest_first(logs: Sequence[str], sizes: dict[str, int]) -> list[str]:
    """Logs by size, then by name: a long one at the end would keep the other cores waiting."""
    return sorted(logs, key=lambda log: (-sizes[log], log.replace("\\", "/").rsplit("/", 1)[-1], log))
