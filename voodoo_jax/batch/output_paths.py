"""Where the results of each log go."""

import os
from collections import Counter
from collections.abc import Sequence

from voodoo_jax.batch.log_job import output_paths
from voodoo_jax.storage.urls import joined


def folders_within(logs: Sequence[str]) -> dict[str, str]:
    """For each log the folder for its results, relative to that of all: "", the same one.

    Logs of one name have folders of their own, named as those that they lie in, from where their paths part. Raises
    ValueError if two logs would still write the same files.
    """
    named: dict[str, list[str]] = {}
    for log in logs:
        named.setdefault(output_paths(log, "")[0].name, []).append(log)
    found = {}
    for same in named.values():
        parts = [[part.strip(":") for part in log.replace("\\", "/").split("/")[:-1] if part] for log in same]
        shared = len(os.path.commonprefix(parts))
        found |= {log: "/".join(some[shared:]) if len(same) > 1 else "" for log, some in zip(same, parts)}
    written = Counter(joined(folder, output_paths(log, "")[0].name) for log, folder in found.items())
    if twice := sorted(place for place, count in written.items() if count > 1):
        raise ValueError(f"several logs would write {', '.join(twice)}: replay them into different folders")
    return found
