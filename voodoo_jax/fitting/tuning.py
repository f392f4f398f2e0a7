"""Tunes any parameters by the gradient of any loss through whole recordings: `vj.tune`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.experimental import io_callback
from jaxtyping import Array, Float

from voodoo_jax.compile.xla_options import quickly
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.losses import loss as losses
from voodoo_jax.fitting.parameters import changed, named_changes, parameters
from voodoo_jax.fitting.problem import Problem, solved
from voodoo_jax.fitting.tuned_options import tuned_settings
from voodoo_jax.model.body import Body
from voodoo_jax.solve.through_time import Tracked

Loss = Callable[[Tracked, Problem], Float[Array, ""]]
# a tenth of the start's loss counts like a prior deviation of a parameter: BFGS's first step follows the slope, and
# would hardly move on a loss in metres; the logarithm of a loss that falls to a hundredth is not convex
SCALE = 10.0
MOST = 3.0  # prior deviations: limit of every parameter, since a large first step can lose all points
NOTHING = 1e6  # loss of a recording without a frame at rest: above all others
ENOUGH = 0.01  # of a parameter's prior deviation, and a tenth of that of the loss: smaller steps end the search


@dataclass(frozen=True)
class Tuned:
    """The result of tuning."""

    parameters: dict[str, float]  # by name, as `solved` takes them
    problems: tuple[Problem, ...]
    curve: tuple[float, ...]  # the loss without prior at every evaluation, the start first
    finished: bool  # stopped by itself

    @property
    def before(self) -> float:
        """The loss at the start."""
        return self.curve[0]

    @property
    def after(self) -> float:
        """The least loss, at `parameters`."""
        return min(self.curve)

    def body(self, which: int = 0) -> Body:
        """The tuned body of a problem."""
        one = self.problems[which]
        return changed(one.body, self._changes(one))

    def settings(self, before: Settings) -> Settings:
        """Settings with the tuned options of solve and tracking and the tuned weights of features."""
        one = self.problems[0]
        return tuned_settings(before, one.body.topology, self._changes(one), one.features)

    def _changes(self, one: Problem) -> Any:
        return named_changes(one.body, self.parameters, one.features, one.frames.points.origins.shape[-2])


# 7 parameters: the problem, its loss, and the search
def tune(
    problems: Problem | Sequence[Problem],
    free: Sequence[str],
    *,
    loss: Loss = losses.joints,
    start: Mapping[str, float] | None = None,
    steps: int = 20,
    pull: float = 0.03,
    say: Callable[[float, dict[str, float]], None] | None = None,
) -> Tuned:
    """Minimises the mean loss of some recordings by its gradient (BFGS, optimistix.minimise); each recording is solved
    from the first frame to the last.

    **Arguments:** `problems` from `vj.problem`; those of equal shapes (see its `frames`, `points` and `room`) share one
    program; `free` words and patterns of parameters as for `fit` (lengths, bands.*.weight, track.damping), left and
    right together; `loss` positive, of a solved recording and its problem with the parameters (`having`); `start`
    initial parameters, else 0; `steps` most steps; `pull` strength of the parameters' priors
    (fitting.parameters.PRIORS): one prior deviation adds half of this share of the start's loss; `say` is called with
    loss and parameters of every evaluation.

    Raises ValueError for a pattern without a match.
    """
    some = (problems,) if isinstance(problems, Problem) else tuple(problems)
    first = some[0]
    known = parameters(first.body, tuple(free), first.features, sensors=first.frames.points.origins.shape[-2])
    names, sd = known.names, known.sd.astype(np.float32)
    begun = jnp.array([(start or {}).get(name, 0.0) for name in names], jnp.float32)
    seen: list[tuple[float, dict[str, float]]] = []
    groups = [jax.tree.map(lambda *leaves: jnp.stack(leaves), *group) for group in _group_by_shape(some)]

    def heard(z: Any, value: Any) -> np.float32:
        found = dict(zip(names, (np.asarray(begun) + sd * MOST * np.tanh(np.asarray(z) / MOST)).tolist()))
        seen.append((float(value), found))
        if say is not None:
            say(*seen[-1])
        return np.float32(seen[0][0])

    number = max(_CALLBACKS, default=0) + 1
    _CALLBACKS[number] = heard
    try:
        found = _compile_search(names, loss, steps)(
            jnp.zeros_like(begun), (groups, begun, sd, np.float32(pull), np.int32(number))
        )
        jax.effects_barrier()
    finally:
        del _CALLBACKS[number]
    best = min(seen, key=lambda one: one[0] if np.isfinite(one[0]) else np.inf)
    done = found.result == optx.RESULTS.successful
    return Tuned(best[1], some, tuple(value for value, _ in seen), bool(done))


# callbacks of running searches: called with each evaluation, they return the loss of the first one
_CALLBACKS: dict[int, Callable[[Any, Any], np.float32]] = {}


@cache
def _compile_search(names: tuple[str, ...], loss: Loss, steps: int) -> Callable[..., optx.Solution]:
    """The search, compiled once for all problems of equal number and shapes."""

    def function(z: Float[Array, " free"], args: Any) -> Float[Array, ""]:
        groups, begun, sd, pull, number = args
        x = begun + sd * MOST * jnp.tanh(z / MOST)
        values = dict(zip(names, x))

        def one(problem: Problem) -> Float[Array, ""]:
            there = problem.having(values)
            found, real = solved({}, there), there.frames.weight > 0
            # losses leave out frames that are not at rest, so divide by the share of frames at rest
            rest = jnp.sum(found.converged & real) / jnp.maximum(jnp.sum(real), 1)
            return jnp.where(rest > 0, loss(found, there) / jnp.maximum(rest, 1e-3), NOTHING)

        each = jnp.concatenate([jax.lax.map(one, group) for group in groups])
        value = jnp.mean(each)
        progress = jax.lax.stop_gradient((number, z, value))
        first = io_callback(
            lambda number, *progress: _CALLBACKS[int(number)](*progress),
            jnp.zeros((), value.dtype),
            *progress,
            ordered=True,
        )
        return SCALE * (value / jnp.maximum(first, 1e-12) + 0.5 * pull * jnp.sum((x / sd) ** 2))

    def search(z: Float[Array, " free"], args: Any) -> optx.Solution:
        solver = optx.BFGS(rtol=0.0, atol=ENOUGH)
        return optx.minimise(function, solver, z, args, max_steps=steps, throw=False)

    return quickly(search)


def _group_by_shape(problems: tuple[Problem, ...]) -> list[list[Problem]]:
    """Problems grouped by shape."""
    found: dict[Any, list[Problem]] = {}
    for one in problems:
        shapes = tuple((leaf.shape, leaf.dtype.name) for leaf in jax.tree.leaves(eqx.filter(one, eqx.is_array)))
        found.setdefault((jax.tree.structure(one), shapes), []).append(one)
    return list(found.values())
