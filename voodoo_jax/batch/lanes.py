"""The tracker's program for many recordings at once, each in a lane of its own; lanes are distributed over all
devices."""

from collections.abc import Callable, Generator, Sequence
from functools import cache, partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from voodoo_jax.batch.request_batcher import Ask, in_turns
from voodoo_jax.compile.executable import count_waiting, seconds_of_waiting
from voodoo_jax.compile.xla_options import quickly
from voodoo_jax.kernels.correspondences import Points
from voodoo_jax.kernels.landmarks import Features
from voodoo_jax.model.body import Body
from voodoo_jax.solve.scan import (
    NOBODY,
    State,
    Step,
    TrackOptions,
    Visit,
    Visits,
    covariances_of,
    track_frame,
    track_visits,
)

T = TypeVar("T")
LANES = 32  # on each device that is no processor, unless told otherwise


def usual_lanes() -> int:
    """How many recordings to track at once, the same number on each device."""
    return len(jax.devices()) * (1 if jax.default_backend() == "cpu" else LANES)


def in_lanes(tasks: Sequence[Callable[[Visit], T]], lanes: int) -> Generator[tuple[int, T]]:
    """Yields number and result of each finished task, with `lanes` of them at once; each task gets a function that
    replaces `track_visits`. Raises what a task raises."""

    def answer(asked: list[tuple]) -> list[Any]:
        before = seconds_of_waiting()
        found = visit_lanes(asked, lanes)
        return [(each, seconds_of_waiting() - before) for each in found]

    def visit(ask: Ask, *args: Any) -> tuple[State, Step]:
        found, compiling = ask(*args)
        count_waiting(compiling)
        return found

    return in_turns([lambda ask, task=task: task(partial(visit, ask)) for task in tasks], lanes, answer)


def visit_lanes(asked: list[tuple], lanes: int) -> list[tuple[State, Step]]:
    """What `track_visits(*each)` returns for each `asked`, on the host: at once those (up to `lanes`) of equal shapes.

    Fewer are run as if there were `lanes` of them: one program for any number, and what one gets does not depend on the
    others.
    """
    alike: dict[Any, list[int]] = {}
    for number, each in enumerate(asked):
        leaves, form = jax.tree.flatten(each)
        alike.setdefault((form, tuple((x.shape, str(x.dtype)) for x in leaves)), []).append(number)
    out: dict[int, tuple[State, Step]] = {}
    for numbers in alike.values():
        mine = [asked[number] for number in numbers]
        idle = (*mine[0][:5], _nobody(mine[0][5]), *mine[0][6:])
        stacked = jax.tree.map(
            lambda *x: np.stack([np.asarray(each) for each in x]), *mine, *[idle] * (lanes - len(mine))
        )
        found = jax.tree.map(np.asarray, program_of(jax.default_backend() != "cpu")(*stacked))
        out |= {number: jax.tree.map(lambda x, k=k: x[k], found) for k, number in enumerate(numbers)}
    return [out[number] for number in range(len(asked))]


def _nobody(visits: Visits) -> Visits:
    return visits._replace(track=np.full_like(visits.track, NOBODY))


@cache
def program_of(lockstep: bool) -> Any:
    """Lanes of each device in step, or one after the other: on a processor, where a lane in step waits for the slowest
    and gains nothing."""
    mesh = Mesh(np.array(jax.devices()), ("lane",))
    here = in_lockstep if lockstep else one_by_one
    spec = PartitionSpec("lane")
    # around all of it, so that each device's loops end by themselves (docs/numerics.md#sharding)
    return quickly(jax.shard_map(here, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False))


def one_by_one(*asked: Any) -> tuple[State, Step]:
    """As track_visits, all arguments and results with a leading lane axis."""
    return jax.lax.map(lambda mine: track_visits.function(*mine), asked)


# 7 parameters: those of the program that it stands for
def in_lockstep(
    body: Body,
    options: TrackOptions,
    states: State,
    points: Points,
    seconds: jax.Array,
    visits: Visits,
    features: Features | None = None,
) -> tuple[State, Step]:
    """As track_visits, all arguments and results with a leading lane axis: one visit of every lane at a time."""

    def one(body, options, states, measured, visit):
        frame, track = visit
        busy = track != NOBODY
        points, seconds, features = jax.tree.map(lambda x: x[frame], measured)
        # without measurements a frame is done in two steps: who has nothing to do keeps nobody waiting
        # (docs/numerics.md#slowest)
        points = eqx.tree_at(lambda p: p.weight, points, jnp.where(busy, points.weight, 0.0))
        if features is not None:
            features = eqx.tree_at(lambda f: f.weight, features, jnp.where(busy, features.weight, 0.0))
        state = jax.tree.map(lambda x: x[track], states)
        after, *out = track_frame(body, options, state, points, seconds, features)
        after = jax.tree.map(partial(jnp.where, busy), after, state)
        return jax.tree.map(lambda x, new: x.at[track].set(new), states, after), out

    def turn(states, visit):
        tracked = lambda: jax.vmap(one)(body, options, states, (points, seconds, features), visit)  # noqa: E731
        nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(tracked)[1])
        return jax.lax.cond(jnp.any(visit[1] != NOBODY), tracked, lambda: (states, nothing))

    by_turn = visits.frame.T, visits.track.T
    states, (steps, normals) = jax.lax.scan(turn, states, by_turn)
    steps, normals = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), (steps, normals))
    # the same branch for all lanes, or it were none
    wanted = jax.vmap(covariances_of, (0, 0, 0, None))(body, options, normals, jnp.any(visits.sure))
    found = jnp.where(visits.sure[:, None, None, None, None], wanted, 0.0)
    return states, steps._replace(covariance=found)
