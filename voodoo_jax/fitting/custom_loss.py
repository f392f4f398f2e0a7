"""Fits to a loss of the user's own: a function of body, options and frames, made small by BFGS, priors added."""

from collections.abc import Callable
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from voodoo_jax.compile.sequential_map import one_by_one
from voodoo_jax.compile.xla_options import quick, quickly
from voodoo_jax.fitting.checkpoint import Progress
from voodoo_jax.fitting.gauss_newton import FitError, Search
from voodoo_jax.fitting.objective import NEWTON, SETTLED, FitFrames, UserLoss
from voodoo_jax.fitting.parameters import changed, changed_options
from voodoo_jax.model.body import Body
from voodoo_jax.solve.frame import IcpOptions, Problem
from voodoo_jax.solve.implicit import Solution, solution


def solve_frames(body: Body, options: IcpOptions, frames: FitFrames) -> Solution:
    """Poses of all frames (leading axis) with exact derivatives; what a loss of one's own is built on.

    Give frames that are not `converged` weight zero: their derivatives are wrong (docs/numerics.md#convergence).
    """

    def one(frame: FitFrames) -> Solution:
        problem = Problem.build(body, frame.points, frame.poses, options, frame.features)
        return solution(frame.poses, problem, newton=NEWTON, tolerance=SETTLED)

    return one_by_one(one, frames, batch=8)


def minimised(
    search: Search, loss: UserLoss, progress: Progress, most: int, say: Callable[[Progress], None] | None = None
) -> Progress:
    """BFGS from where `progress` stands, sum of the loss over all recordings and half the squared priors.

    Raises FitError where the loss is not a finite number at the start.
    """
    sd = jnp.asarray(search.sd, jnp.float32)
    centre = jnp.asarray(search.centre / search.sd, jnp.float32)

    def function(z: Float[Array, " all"], _) -> tuple[Float[Array, ""], None]:
        # in units of the priors' deviations: BFGS begins with steps alike in all directions
        total = 0.5 * jnp.sum((z - centre) ** 2)
        for part in search.parts:
            by = search.free.changes((z * sd)[search.rows[part.person]])
            total = total + loss(changed(part.body, by), changed_options(search.options, by), part.frames)
        return total, None

    z = jnp.asarray(progress.x / search.sd, jnp.float32)
    solver = optx.BFGS(rtol=1e-3, atol=1e-3)
    value, aux = jax.eval_shape(function, z, None)
    state = solver.init(function, z, None, {}, value, aux, frozenset())
    step = quickly(lambda z, state: solver.step(function, z, None, {}, state, frozenset()))
    ended = eqx.filter_jit(lambda z, state: solver.terminate(function, z, None, {}, state, frozenset()))
    if not progress.losses:
        first = float(jax.jit(function, compiler_options=quick())(z, None)[0])
        if not np.isfinite(first):
            raise FitError(f"the loss is {first} for the body as it is; it must be a finite number")
        progress = replace(progress, losses=(first,))
    best, best_z = progress.losses[-1], z
    while not progress.done and progress.step < most:
        z, state, _ = step(z, state)
        value = float(state.f_info.f)
        if np.isfinite(value) and value < best:
            best, best_z = value, z
        x = np.asarray(best_z, np.float64) * search.sd
        done = bool(ended(z, state)[0])
        progress = replace(progress, x=x, step=progress.step + 1, done=done, losses=(*progress.losses, best))
        if say is not None:
            say(progress)
    return progress
