"""Points of long recordings wait in a temporary file: memory hardly grows with the length of a log. Host side."""

import mmap
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from typing import IO

import numpy as np

from voodoo_jax.records.observation import PersonFrame

BLOCK = 64 << 20  # bytes of points that stay in memory, and are written at once
ARRAYS = ("points", "sensor", "part", "weight")


def spilled(frames: Iterable[PersonFrame], block: int = BLOCK) -> list[PersonFrame]:
    """The frames, their points in nameless files (where the system keeps temporary ones) but for the last block.

    The file goes when the frames do. Where it cannot be written the points stay in memory.
    """
    out: list[PersonFrame] = []
    waiting: list[PersonFrame] = []
    size = 0
    for frame in frames:
        waiting.append(frame)
        size += sum(array.nbytes for array in _arrays(frame).values())
        if size >= block:
            out += _in_file(waiting)
            waiting, size = [], 0
    return out + waiting


def _arrays(frame: PersonFrame) -> dict[str, np.ndarray]:
    return {name: array for name in ARRAYS if (array := getattr(frame, name)) is not None}


def _in_file(frames: list[PersonFrame]) -> list[PersonFrame]:
    try:
        with tempfile.TemporaryFile() as file:
            for frame in frames:
                for array in _arrays(frame).values():
                    file.write(np.ascontiguousarray(array).data)
            file.flush()
            return _mapped(frames, file)
    except OSError:  # no room: they stay where they are
        return frames


def _mapped(frames: list[PersonFrame], file: IO[bytes]) -> list[PersonFrame]:
    """The frames with their arrays in the file: read when they are asked for, dropped by the system as it likes."""
    held, at, out = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), 0, []
    for frame in frames:
        found = {}
        for name, array in _arrays(frame).items():
            found[name] = np.frombuffer(held, array.dtype, array.size, at).reshape(array.shape)
            at += array.nbytes
        out.append(replace(frame, **found))
    return out
