"""Options of the compiler: on a processor programs are compiled in about half of the time and run no slower, on a GPU
they give the same bits in every run. Maps over many frames, where and how that is fast and safe."""

from collections.abc import Callable
from functools import cache
from typing import Any

import equinox as eqx
import jax

Options = dict[str, str | bool]
# XLA's names. Its older way to write fused loops is done sooner; with vectors as wide as the processor has them (XLA
# would take half of that) they run no slower than the newer ones.
OPTIONS: dict[str, Options] = {
    "cpu": {
        "xla_backend_optimization_level": "1",
        "xla_cpu_use_fusion_emitters": False,
        "xla_cpu_prefer_vector_width": "512",
    },
    # sums in an order of their own, or kernels chosen by a stopwatch, give other last digits from run to run
    "gpu": {"xla_gpu_deterministic_ops": True, "xla_gpu_enable_triton_gemm": False},
}


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


@cache
def quick() -> Options:
    """`compiler_options` for jax.jit: those of what programs run on that this version of XLA knows."""
    smallest = jax.jit(lambda: 0).lower()
    wanted = OPTIONS.get(jax.default_backend(), {})
    return {name: value for name, value in wanted.items() if _compiles(smallest, {name: value})}


def _compiles(lowered: Any, options: Options) -> bool:
    try:
        lowered.compile(options)
    except Exception:  # each version of jax has its own
        return False
    return True


def quickly(function: Callable[..., Any]) -> Callable[..., Any]:
    """eqx.filter_jit with these options."""
    return eqx.filter_jit(function, compiler_options=quick())  # pyright: ignore[reportCallIssue]
