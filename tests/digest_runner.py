"""Tracks logs with whatever voodoo_jax PYTHONPATH leads to and writes digests of all arrays: see same_bits.py.

Public names only, so that it runs with the package of any commit, however its files lie.
usage: digest_runner.py TREE OUT.json WORKERS LOG...
"""

import hashlib
import json
import sys
import tempfile
from pathlib import Path

import numpy as np

import voodoo_jax as vj

# of the time taken, where the log lay, and the package's version
NOT_COMPARED = {"seconds", "source", "run_key", "digest"}


def digest(array: np.ndarray) -> str:
    """Type, shape and sha256 of an array's bytes."""
    array = np.ascontiguousarray(array)
    return f"{array.dtype.str} {list(array.shape)} {hashlib.sha256(array.tobytes()).hexdigest()}"


def arrays_read(log: str) -> dict[str, np.ndarray]:
    """What read_log makes of a log, frames one after the other."""
    frames = vj.read_log(log).frames
    joined = lambda parts: np.concatenate([np.ravel(part) for part in parts])  # noqa: E731
    return {
        "read/time_ns": np.array([f.time_ns for f in frames], np.int64),
        "read/points": joined([f.points for f in frames]),
        "read/sensor": joined([f.sensor for f in frames]),
        "read/origins": joined([f.origins for f in frames]),
        "read/named": joined([f.pairs.points for f in frames]),
    }


def main(tree: str, out: str, workers: str, *logs: str) -> None:
    package = Path(str(vj.__file__)).resolve()
    assert package.is_relative_to(Path(tree).resolve()), f"not the package of {tree}: {package}"
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for outcome in vj.replay_logs(logs, folder, workers=int(workers), quiet=True, compile_cache=""):
            name = Path(outcome.path).stem
            with np.load(Path(folder) / f"{name}.tracks.npz", allow_pickle=False) as tracks:
                arrays = {key: tracks[key] for key in tracks.files if key not in NOT_COMPARED}
            arrays |= arrays_read(outcome.path)
            found |= {f"{name}: {key}": digest(array) for key, array in sorted(arrays.items())}
    Path(out).write_text(json.dumps(found))


if __name__ == "__main__":  # workers may import this file
    main(*sys.argv[1:])
