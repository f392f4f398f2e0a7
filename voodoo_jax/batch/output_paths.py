"""Where the results of each log go."""

import os
from collections import Counter
from collections.abc import Collection, Sequence

from voodoo_jax.batch.log_job import output_paths
from voodoo_jax.storage.urls import NPZ, joined


def _stem(log: str) -> str:
    return output_paths(log, "")[0].name.removesuffix(NPZ)


def _second(log: str) -> str | None:
    """The name of the log whose second, third, ... person would have the names of this log; None: of none."""
    stem, dot, number = _stem(log).rpartition(".")
    return stem if dot and number.isdigit() else None


def folders_within(logs: Sequence[str], direct: Collection[str] = ()) -> dict[str, str]:
    """For each log the folder for its results, relative to that of all: "", the same one.

    Logs of one name have folders of their own, named as those that they lie in, from where their paths part; so has
    `a.2` beside `a`, whose second person has the files `a.2`. `direct` are those that were given themselves, or lie
    directly in a given folder: where one of several of one name is, it has no folder of its own. Raises ValueError if
    two logs would still write the same files.
    """
    named: dict[str, list[str]] = {}
    for log in logs:
        named.setdefault(output_paths(log, "")[0].name, []).append(log)
    found = {}
    stems = {_stem(log) for log in logs}
    for same in named.values():
        parts = [[part.strip(":") for part in log.replace("\\", "/").split("/")[:-1] if part] for log in same]
        shared = len(os.path.commonprefix(parts))
        near = [log for log in same if log in direct] if len(same) > 1 else same
        own = {log: "/".join(some[shared:]) for log, some in zip(same, parts)}
        found |= own | ({near[0]: ""} if len(near) == 1 else {})
    # where a log has the name that the second person of another one has, it has a folder of its own
    found |= {log: joined(f, _stem(log)) if f else _stem(log) for log, f in found.items() if _second(log) in stems}
    written = Counter(joined(folder, output_paths(log, "")[0].name) for log, folder in found.items())
    if twice := sorted(place for place, count in written.items() if count > 1):
        raise ValueError(f"several logs would write {', '.join(twice)}: replay them into different folders")
    return found
