"""Arrays over bytes of files and messages: every number that says where they lie is checked first."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

NUMBERS = "biufcSUV"  # kinds of types that are no pointers


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
