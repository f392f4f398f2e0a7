"""Output paths of each log; parts of a list of logs, one for each machine or array job."""

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from voodoo_jax.batch.log_job import output_paths
from voodoo_jax.storage.urls import NPZ, byte_size, joined

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


def _stem(log: str) -> str:
    return output_paths(log, "")[0].name.removesuffix(NPZ)


def _second(log: str) -> str | None:
    """The log whose second, third, ... person would have the names of this log; None: no such log."""
    stem, dot, number = _stem(log).rpartition(".")
    return stem if dot and number.isdigit() else None


def logs_of(given: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Logs, and the folder of each one's results relative to the output folder: its path below the given place; "" for
    a log that was given itself.

    **Arguments:** `given` pairs of a place that was given and a log that it stands for, as in urls.expanded; a log that
    is given as such and in a folder is one log, and so are a bag and a file of it.
    """
    found: dict[str, str] = {}
    for place, log in given:
        top = place.rstrip("/") if log == place or os.path.isdir(place) else place.split("*")[0].rpartition("/")[0]
        below = log.removeprefix(top + "/") if log.startswith(top + "/") else ""
        folder = below.rpartition("/")[0]
        found[log] = max(found.get(log, ""), folder, key=len)
    return {log: folder for log, folder in found.items() if os.path.dirname(log) not in found}


def folders_within(logs: Mapping[str, str]) -> dict[str, str]:
    """The folder of each log's results, relative to the output folder.

    **Arguments:** `logs` the folders that paths say, see logs_of. Logs that would write the same files have folders
    named as those that they lie in, from where their paths part; `a.2` has one of its own beside `a`, whose second
    person has the files `a.2`. Raises ValueError if two logs would still write the same files.
    """
    place = lambda log, folder: joined(folder, output_paths(log, "")[0].name)  # noqa: E731
    same: dict[str, list[str]] = {}
    for log, folder in logs.items():
        same.setdefault(place(log, folder), []).append(log)
    found = dict(logs)
    for several in same.values():
        if len(several) > 1:
            parts = [[part.strip(":") for part in log.replace("\\", "/").split("/")[:-1] if part] for log in several]
            shared = len(os.path.commonprefix(parts))
            found |= {log: "/".join(some[shared:]) for log, some in zip(several, parts)}
    # where a log has the name that the second person of another one has, it has a folder of its own
    stems = {_stem(log) for log in logs}
    found |= {log: joined(f, _stem(log)) if f else _stem(log) for log, f in found.items() if _second(log) in stems}
    written = Counter(place(log, folder) for log, folder in found.items())
    if twice := sorted(place for place, count in written.items() if count > 1):
        raise ValueError(f"several logs would write {', '.join(twice)}: give them different --out folders")
    return found
