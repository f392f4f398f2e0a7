"""Output paths of each log."""

import os
from collections import Counter
from collections.abc import Iterable, Mapping

from voodoo_jax.batch.log_job import output_paths
from voodoo_jax.storage.urls import NPZ, joined


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
