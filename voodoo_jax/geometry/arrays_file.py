"""Arrays in `.npz` files, which are data: sizes are checked before there is memory for them; nothing is unpickled."""

import hashlib
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Container, Mapping
from io import BytesIO
from typing import Any

import numpy as np
from numpy.lib import format as npy

from voodoo_jax.config.limited import too_large
from voodoo_jax.geometry.from_bytes import array_at

DIGEST = "digest"  # of all other arrays in a file
UNREADABLE = (
    zipfile.BadZipFile, zlib.error, ValueError, EOFError, AttributeError, TypeError, KeyError, NotImplementedError,
    RuntimeError, MemoryError, OverflowError, SyntaxError, struct.error, tokenize.TokenError,
)  # fmt: skip


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
