"""Results of an earlier run that lie elsewhere in the folder, because logs had other names or folders."""

import os
import shutil
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

from voodoo_jax.batch.log_job import Job, check_names, output_places, remove_others
from voodoo_jax.batch.resume import BROKEN, fingerprint_of, finished_arrays, run_key
from voodoo_jax.geometry.arrays_file import arrays_in
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.storage.urls import NPZ, TRACKS, is_url, opened, person_place


def keys_elsewhere(folder: str, expected: Collection[str]) -> dict[str, str]:
    """Tracks of main persons in a folder and its subfolders, by the keys of their runs, except those at their
    `expected` place; empty for a URL."""
    found: dict[str, str] = {}
    for place in sorted(Path(folder).rglob(f"*{NPZ}")) if not is_url(folder) else ():
        if str(place) in expected:
            continue
        with suppress(*BROKEN), opened(str(place)) as stream:
            data = arrays_in(stream, ("person", "run_key"))
            if int(data.get("person", 1)) == 1:
                found.setdefault(str(data["run_key"]), str(place))
    return found


def brought(job: Job, elsewhere: dict[str, str]) -> bool:
    """Whether the results of a log were among those, and are now where they belong: as links, or as copies where the
    file system has none. What was there before of another log with this name is replaced, as by a new run."""
    with suppress(OSError):
        there = elsewhere.get(run_key(job.recipe, fingerprint_of(job.log)))
        if there is None:
            return False
        shown = there.removesuffix(NPZ) + TRACKS
        arrays = finished_arrays(job.log, there, shown, job.recipe)
        if arrays is None:
            return False
        npz, mcap, _ = output_places(job.log, job.out)
        check_names(npz, len(arrays))
        Path(job.out).mkdir(parents=True, exist_ok=True)
        pairs = [(person_place(there, k), person_place(npz, k)) for k in range(len(arrays), 0, -1)]
        for source, target in [(shown, mcap), *pairs]:  # the main one last: where it is, all are
            with replacing(target) as partial:
                try:
                    partial.unlink()
                    os.link(source, partial)
                except OSError:
                    shutil.copy2(source, partial)
        remove_others(npz, len(arrays))
        return True
    return False
