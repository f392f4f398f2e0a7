"""Points of long recordings wait in a temporary file: memory hardly grows with the length of a log. Host side."""

import mmap
from collections.abc import Iterable
from dataclasses import replace
from typing import IO

import numpy as np

from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.storage.scratch import nameless_file

BLOCK = 64 << 20  # bytes of points that stay in memory, and are written at once
ARRAYS = ("points", "sensor", "part", "weight")


class Spill:
    """Frames that come one by one, their points in nameless files (see storage/scratch.py) but for those
    of the last block.

    The files go when the frames do. Where they cannot be written the points stay in memory.
    """

    def __init__(self, block: int = BLOCK):
        self._block, self._size = block, 0
        self._out: list[BodyObservation] = []
        self._waiting: list[BodyObservation] = []

    def append(self, frame: BodyObservation) -> None:
        self._waiting.append(frame)
        self._size += sum(array.nbytes for array in _arrays(frame).values())
        if self._size >= self._block:
            self._out += _in_file(self._waiting)
            self._waiting, self._size = [], 0

    def frames(self) -> list[BodyObservation]:
        """All that there are."""
        return self._out + self._waiting


def spilled(frames: Iterable[BodyObservation], block: int = BLOCK) -> list[BodyObservation]:
    """The frames, see Spill."""
    kept = Spill(block)
    for frame in frames:
        kept.append(frame)
    return kept.frames()


def _arrays(frame: BodyObservation) -> dict[str, np.ndarray]:
    return {name: array for name in ARRAYS if (array := getattr(frame, name)) is not None}


def _in_file(frames: list[BodyObservation]) -> list[BodyObservation]:
    try:
        with nameless_file() as file:
            for frame in frames:
                for array in _arrays(frame).values():
                    file.write(np.ascontiguousarray(array).data)
            file.flush()
            return _mapped(frames, file)
    except OSError:  # no room: they stay where they are
        return frames


def _mapped(frames: list[BodyObservation], file: IO[bytes]) -> list[BodyObservation]:
    """The frames with their arrays in the file: read when they are asked for, dropped by the system as it likes."""
    held, at, out = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), 0, []
    for frame in frames:
        found = {}
        for name, array in _arrays(frame).items():
            found[name] = np.frombuffer(held, array.dtype, array.size, at).reshape(array.shape)
            at += array.nbytes
        out.append(replace(frame, **found))
    return out
