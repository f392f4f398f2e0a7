"""Buffers the points of long recordings in a temporary file, to save memory. Host side."""

import mmap
import weakref
from collections.abc import Iterable
from dataclasses import replace
from typing import IO, Any, Literal, NamedTuple

import numpy as np

from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import NO_PAIRS, NO_RAYS
from voodoo_jax.storage.scratch import nameless_file

BLOCK = 8 << 20  # bytes of points that are written at once: shorter recordings stay in memory
# what is moved to the file, and what frames have of it meanwhile
WITHOUT: dict[str, Any] = {
    "points": np.zeros((0, 3), np.float32), "sensor": np.zeros(0, np.int32), "part": None, "weight": None,
    "before": None, "before_sensor": None,
}  # fmt: skip


class Kind(NamedTuple):
    """Layout of an array in the file."""

    name: str
    dtype: np.dtype
    row: tuple[int, ...]  # shape of what there is of each point
    order: Literal["C", "F"]


class Place(NamedTuple):
    """Position of a frame's arrays in the file, one after another."""

    at: int  # bytes
    counts: tuple[int, ...]  # points, or rows, of each array
    kinds: tuple[Kind, ...]  # one object for all frames that are alike


class Spill:
    """A sequence of frames. Points of many go to an unnamed file in the user's cache, which is deleted with the frames,
    or stay in memory if it cannot be written.
    """

    def __init__(self, block: int = BLOCK):
        self._block, self._size = block, 0
        self._file: IO[bytes] | None = None
        self._end = 0  # of the file, bytes
        self._full = False  # there is no room in it
        self._frames: list[BodyObservation] = []  # those in the file without their arrays
        self._places: list[Place] = []  # where these are, from the first on
        self._kinds: dict[tuple[Kind, ...], tuple[Kind, ...]] = {}

    def append(self, frame: BodyObservation) -> None:
        self._frames.append(_shared(frame, self._frames[-1] if self._frames else None))
        self._size += sum(array.nbytes for array in _arrays(frame).values())
        if self._size >= self._block and not self._full:
            self._write()

    def frames(self) -> list[BodyObservation]:
        """All frames."""
        if self._file is None or not self._end:
            return list(self._frames)
        if not self._full:
            self._write()
        held = mmap.mmap(self._file.fileno(), self._end, access=mmap.ACCESS_READ)
        count = len(self._places)
        return [*map(_mapped, self._frames[:count], self._places, [held] * count), *self._frames[count:]]

    def _write(self) -> None:
        """Moves the points that are in memory to the file, if there is room."""
        first = len(self._places)
        try:
            if self._file is None:
                self._file = nameless_file()
                weakref.finalize(self, self._file.close)
            self._file.seek(self._end)
            places, end = [], self._end
            for frame in self._frames[first:]:
                arrays, begin = _arrays(frame), end
                kinds = tuple(Kind(n, a.dtype, a.shape[1:], _order(a)) for n, a in arrays.items())
                for kind, array in zip(kinds, arrays.values()):
                    self._file.write(np.ascontiguousarray(array.T if kind.order == "F" else array).data)
                    end += array.nbytes
                places.append(Place(begin, tuple(map(len, arrays.values())), self._kinds.setdefault(kinds, kinds)))
            self._file.flush()
        except OSError:  # no room: they stay where they are
            self._full = True
            return
        self._places += places
        self._frames[first:] = [replace(f, **WITHOUT) for f in self._frames[first:]]
        self._end, self._size = end, 0


def spilled(frames: Iterable[BodyObservation], block: int = BLOCK) -> list[BodyObservation]:
    """The frames, see Spill."""
    kept = Spill(block)
    for frame in frames:
        kept.append(frame)
    return kept.frames()


def _arrays(frame: BodyObservation) -> dict[str, np.ndarray]:
    return {name: array for name in WITHOUT if (array := getattr(frame, name)) is not None}


def _shared(frame: BodyObservation, before: BodyObservation | None) -> BodyObservation:
    """The frame with shared objects for values equal in all frames, or in the previous one."""
    same: dict[str, Any] = {} if frame.rays.names or frame.rays is NO_RAYS else {"rays": NO_RAYS}
    same |= {} if frame.pairs.names or frame.pairs is NO_PAIRS else {"pairs": NO_PAIRS}
    if before is not None and frame.origins is not before.origins and _alike(frame.origins, before.origins):
        same["origins"] = before.origins
    return replace(frame, **same) if same else frame


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()


def _order(array: np.ndarray) -> Literal["C", "F"]:
    """Its memory order, on which the last bits of sums may depend."""
    return "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"


def _mapped(frame: BodyObservation, place: Place, held: mmap.mmap) -> BodyObservation:
    """A frame with its arrays in the file: read on access, and evicted by the system."""
    arrays, at = {}, place.at
    for kind, count in zip(place.kinds, place.counts):
        array = np.ndarray((count, *kind.row), kind.dtype, held, at, order=kind.order)
        arrays[kind.name], at = array, at + array.nbytes
    return replace(frame, **arrays)
