"""Value and gradient by all sizes and band weights through the steps of several frames at once."""

import time
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from experiments.bench.peers.library import body_of, links_of, options, start_of
from experiments.bench.work import STEPS, Work
from voodoo_jax.kernels.correspondences import Points
from voodoo_jax.solve.frame import icp_step
from voodoo_jax.solve.pulls import Problem


@dataclass(frozen=True)
class Cost:
    """What derivatives cost."""

    best_ms: float  # a frame, value and gradient
    median_ms: float
    value_ms: float  # a frame, the value alone, best
    memory_mb: float  # that the program needs beside its inputs and outputs
    compile_s: float


def program(work: Work, points: int, frames: int):
    """Value and gradient as a function of (sizes, band weights), and the value alone."""
    body, links, icp, start = body_of(work), links_of(work), options("per_limb", points), start_of(work)
    clouds = jnp.asarray(work.frames(points)[:frames])
    rest = jnp.ones(points), jnp.zeros(points, jnp.int32), jnp.zeros((1, 3))

    def loss(parts, clouds, icp):
        sizes, weights = parts

        def one(cloud):
            own = eqx.tree_at(lambda b: b.sizes, body, sizes)
            problem = Problem(own, links._replace(weights=weights), Points(cloud.T, *rest), None, start, icp)
            step = jax.checkpoint(lambda poses: icp_step(poses, problem)[0])
            return jax.lax.scan(lambda poses, _: (step(poses), None), start, length=STEPS)[0].translation

        return jnp.sum(jax.vmap(one)(clouds) ** 2)

    parts = body.sizes, links.weights
    return jax.jit(jax.value_and_grad(loss)), jax.jit(loss), (parts, clouds, icp)


def measure(work: Work, points: int, frames: int = 16, turns: int = 15) -> Cost:
    """Times of `frames` frames at once, divided by them."""
    both, value, given = program(work, points, frames)
    begin = time.perf_counter()
    both = both.lower(*given).compile()
    compile_s = time.perf_counter() - begin
    found = jax.block_until_ready(both(*given))
    if not all(np.isfinite(g).all() for g in jax.tree.leaves(found)):
        raise RuntimeError("the gradient is not finite")
    times = {name: [] for name in ("both", "value")}
    for _ in range(turns):
        for name, run in (("both", both), ("value", value)):
            begin = time.perf_counter()
            jax.block_until_ready(run(*given))
            times[name].append(1e3 * (time.perf_counter() - begin) / frames)
    memory = both.memory_analysis()
    return Cost(
        min(times["both"]), float(np.median(times["both"])), min(times["value"]),
        memory.temp_size_in_bytes / 1e6 if memory else float("nan"), compile_s,
    )  # fmt: skip
