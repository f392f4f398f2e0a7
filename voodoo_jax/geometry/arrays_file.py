"""Arrays over bytes of files and messages, where every number that says where they lie is checked first; and in `.npz`
files, which are data: sizes are checked before there is memory for them, nothing is unpickled."""

import hashlib
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Container, Mapping, Sequence
from io import BytesIO
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import DTypeLike

from voodoo_jax.config.limited import too_large

NUMBERS = "biufcSUV"  # kinds of types that are no pointers
DIGEST = "digest"  # of all other arrays in a file
UNREADABLE = (
    zipfile.BadZipFile, zlib.error, ValueError, EOFError, AttributeError, TypeError, KeyError, NotImplementedError,
    RuntimeError, MemoryError, OverflowError, SyntaxError, struct.error, tokenize.TokenError,
)  # fmt: skip


def array_at(
    data: Any, kind: DTypeLike, shape: Sequence[int] | None = None, at: int = 0, strides: Sequence[int] | None = None
) -> np.ndarray:
    """An array that lies in bytes, or in what gives them (bytes, bytearray, memoryview, mmap, an array of bytes).

    **Arguments:** `shape` None: of one dimension, as many as there are; `at` bytes before the first element; `strides`
    bytes from one to the next along each dimension, none negative; None: without gaps, in the order of C.

    Raises ValueError where it does not lie in the bytes, or has no type of numbers or texts.
    """
    view, dtype = memoryview(data).cast("B") if not isinstance(data, np.ndarray) else data, np.dtype(kind)
    size = view.nbytes
    if dtype.hasobject or dtype.kind not in NUMBERS or not dtype.itemsize:
        raise ValueError(f"{dtype} is no type of what lies in bytes")
    shape = [(size - at) // dtype.itemsize] if shape is None else [int(count) for count in shape]
    if strides is None:
        strides = [dtype.itemsize * int(np.prod([1, *shape[k + 1 :]], dtype=object)) for k in range(len(shape))]
    if at < 0 or min(shape, default=0) < 0 or min(strides, default=0) < 0 or len(strides) != len(shape):
        raise ValueError(f"an array of {shape} at byte {at} by {list(strides)} bytes cannot be")
    if 0 in shape:
        return np.zeros(shape, dtype)
    last = at + sum((count - 1) * int(step) for count, step in zip(shape, strides)) + dtype.itemsize
    if last > size:
        count = " x ".join(map(str, shape))
        raise ValueError(f"{size} bytes are too few for {count} of {dtype.itemsize} bytes, which need {last}")
    return np.ndarray(tuple(shape), dtype, view, at, tuple(int(step) for step in strides))


class NotArrays(ValueError):
    """A file that holds no arrays, or other ones than were written."""


def arrays_in(stream: Any, wanted: Container[str] | None = None) -> dict[str, np.ndarray]:
    """The arrays of an open `.npz` file by name, all or those that are wanted; a digest is checked where all are.

    Raises NotArrays for a file of another kind, a damaged one, and one that asks for too much memory.
    """
    found: dict[str, np.ndarray] = {}
    try:
        with zipfile.ZipFile(stream) as archive:
            size = 0
            for info in archive.infolist():
                name = info.filename.removesuffix(".npy")
                if wanted is None or name in wanted:
                    size += 2 * info.file_size  # as bytes, and as an array
                    if trouble := too_large("its arrays need", size, "memory"):
                        raise ValueError(trouble)
                    found[name] = _array(archive.read(info))
    except UNREADABLE as problem:
        raise NotArrays(str(problem) or type(problem).__name__) from problem
    if wanted is None and DIGEST in found and str(found.pop(DIGEST)) != digest(found):
        raise NotArrays("its arrays do not match their checksum: it is damaged")
    return found


def digest(arrays: Mapping[str, Any]) -> str:
    """Checksum of names, types, shapes and bytes of arrays: it detects accidental changes, not deliberate ones."""
    made = hashlib.blake2b(digest_size=16)
    for name, value in sorted(arrays.items()):
        array = np.ascontiguousarray(value)
        made.update(f"{name} {array.dtype.str} {np.shape(value)} ".encode() + array.tobytes())
    return made.hexdigest()


def _array(data: bytes) -> np.ndarray:
    """An array as `.npy` files have it. Raises ValueError."""
    head = BytesIO(data)
    version = npy.read_magic(head)
    read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
    shape, by_column, kind = read(head)
    found = array_at(data, kind, shape[::-1] if by_column else shape, head.tell())
    return (found.T if by_column else found).copy()
