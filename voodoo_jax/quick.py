"""Compiling in a hurry: options under which programs are compiled in about half of the time, and run no slower."""

from collections.abc import Callable
from functools import cache
from typing import Any

import equinox as eqx
import jax

# XLA's names; the older way to write fused loops for the processor is as fast a program and sooner there
OPTIONS: dict[str, str | bool] = {"xla_backend_optimization_level": "1", "xla_cpu_use_fusion_emitters": False}


@cache
def quick() -> dict[str, str | bool]:
    """`compiler_options` for jax.jit: those that this version of XLA knows; none where it does not compile for the
    processor."""
    if jax.default_backend() != "cpu":
        return {}
    smallest = jax.jit(lambda: 0).lower()
    return {name: value for name, value in OPTIONS.items() if _compiles(smallest, {name: value})}


def _compiles(lowered: Any, options: dict[str, str | bool]) -> bool:
    try:
        lowered.compile(options)
    except Exception:  # each version of jax has its own
        return False
    return True


def quickly(function: Callable[..., Any]) -> Callable[..., Any]:
    """eqx.filter_jit with these options."""
    return eqx.filter_jit(function, compiler_options=quick())  # pyright: ignore[reportCallIssue]
