"""Compiling in a hurry: options under which programs are compiled in about half of the time, and run no slower."""

from collections.abc import Callable
from functools import cache
from typing import Any

import equinox as eqx
import jax

Options = dict[str, str | bool]
# XLA's names. Its older way to write fused loops is done sooner; with vectors as wide as the processor has them (XLA
# would take half of that) they run no slower than the newer ones.
OPTIONS: Options = {
    "xla_backend_optimization_level": "1",
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_prefer_vector_width": "512",
}


@cache
def quick() -> Options:
    """`compiler_options` for jax.jit: those that this version of XLA knows; none where it does not compile for the
    processor."""
    if jax.default_backend() != "cpu":
        return {}
    smallest = jax.jit(lambda: 0).lower()
    return {name: value for name, value in OPTIONS.items() if _compiles(smallest, {name: value})}


def _compiles(lowered: Any, options: Options) -> bool:
    try:
        lowered.compile(options)
    except Exception:  # each version of jax has its own
        return False
    return True


def quickly(function: Callable[..., Any]) -> Callable[..., Any]:
    """eqx.filter_jit with these options."""
    return eqx.filter_jit(function, compiler_options=quick())  # pyright: ignore[reportCallIssue]
