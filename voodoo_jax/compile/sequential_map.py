"""Maps over many frames, where and how that is fast and safe."""

from collections.abc import Callable
from typing import Any

import jax


def one_by_one(function: Callable[[Any], Any], leading: Any, batch: int) -> Any:
    """`function` of every entry of `leading` (a tree of arrays, leading axis): one after the other on a CPU, elsewhere
    in batches of `batch`.

    In a batch all loops take as many steps as the longest. And LAPACK's functions hand the matrices of a batch to the
    threads that run the program, and wait: two such calls at the same time on two threads wait for ever (jaxlib 0.10.2:
    LuDecomposition, ParallelBatchMap).
    """
    if jax.default_backend() == "cpu":
        return jax.lax.map(function, leading)
    return jax.lax.map(function, leading, batch_size=batch)
