"""The search: damped Gauss-Newton over the parameters of all persons, step by step; it can be stopped and resumed.

Every step solves all frames anew from where the last step left them and takes one tangent per parameter through the
implicit solution. optimistix' Levenberg-Marquardt would solve them twice a step and from their first poses; its
minimisers tune what is no least squares (fitting.tuning). Both end at the same place (tests/fitting/test_fit.py).
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float64

from voodoo_jax.compile.xla_options import quickly
from voodoo_jax.fitting.checkpoint import Progress
from voodoo_jax.fitting.objective import POINT_SD, FitFrames, Normals, Objective, Placed, normals, placed
from voodoo_jax.fitting.parameters import HEIGHT, Changes, Parameters, changed, changes_at, height_of, height_ratio
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import Body
from voodoo_jax.solve.pulls import IcpOptions

GAIN, LEAST = 1e-4, 0.02  # a step that gains less of the loss, or less at all, is the last
SURE = 2.0  # a size that moved by less than so many of its spreads between parts of the recordings stays
FEW_MORE = 4  # steps beside what stays
PARTS = 4  # parts of a recording that the spread of the sizes is looked at over
KNOWN = 0.1  # information of the data over that of data and prior: with less a size is not determined
FEWEST = 6  # frames of a log that must be at rest


class Part(NamedTuple):
    """One recording in a fit."""

    name: str
    body: Body  # before the fit
    frames: FitFrames  # those that are fitted to have weight, padding has none
    person: int


@dataclass(frozen=True)
class Place:
    """All recordings solved at one place."""

    loss: float  # half the squared deviations, priors included
    at_rest: tuple[np.ndarray, ...]  # [frame] of each recording
    costs: tuple[np.ndarray, ...]  # [frame] of each recording, half the squared deviations; 0 where not at rest
    poses: tuple[Poses, ...]
    found: tuple[Any, ...]  # what the search's own steps need


class Step(NamedTuple):
    """The sums of a Gauss-Newton step."""

    slope: Float64[np.ndarray, " all"]  # priors included
    curve: Float64[np.ndarray, "all all"]  # of the data alone


@runtime_checkable
class Searched(Protocol):
    """What is searched over: the parameters' priors, and what a place costs."""

    @property
    def sd(self) -> Float64[np.ndarray, " all"]: ...
    @property
    def held(self) -> Bool[np.ndarray, " all"]: ...
    def place(self, x: Float64[np.ndarray, " all"], starts: tuple[Poses, ...] = ()) -> Place: ...
    def step(self, x: Float64[np.ndarray, " all"], here: Place, without: int = -1) -> Step: ...
    def gain(self, x: np.ndarray, other: np.ndarray, here: Place, there: Place) -> float: ...


class FitError(ValueError):
    """A fit that cannot be made; says why, and what to try."""


# two programs: most places are only looked at, and they are compiled at the same time
@cache
def compiled_placed() -> Callable[..., Placed]:
    return quickly(placed)


@cache
def compiled_normals() -> Callable[..., Normals]:
    return quickly(normals)


@eqx.filter_jit
def _height_off(body: Body, x, maps) -> tuple[Array, Array]:
    """Logarithm of the changed body's height over what was measured, and its derivative."""
    measured = height_ratio(body) * body.scale
    return jax.value_and_grad(lambda x: jnp.log(height_of(changed(body, changes_at(maps, x))) / measured))(x)


def height_misfit(
    body: Body, free: Parameters, x: Float64[np.ndarray, " free"]
) -> tuple[float, Float64[np.ndarray, " free"]]:
    """How far a body changed by x is from the height that was measured, in standard deviations, and its slope; nothing
    where what was measured is no height: an arm's reach."""
    if body.scale_name != "stature":
        return 0.0, np.zeros(len(x))
    maps = tuple(jnp.asarray(m, jnp.float32) for m in free.maps)
    off, slope = _height_off(body, jnp.asarray(x, jnp.float32), maps)
    return float(off) / HEIGHT, np.asarray(slope, np.float64) / HEIGHT


@dataclass(frozen=True)
class Search:
    """What is fitted to what. `rows[person]` says which entries of the vector are a person's parameters."""

    free: Parameters  # of one person
    parts: tuple[Part, ...]
    options: IcpOptions
    objective: Objective
    rows: tuple[np.ndarray, ...]
    sd: Float64[np.ndarray, " all"]
    centre: Float64[np.ndarray, " all"]  # of the priors
    held: Bool[np.ndarray, " all"]  # what stays where it is: the recordings do not tell
    noise: float = POINT_SD  # standard deviation of a point, metres
    features: tuple[str, ...] = ()  # names of the measured features

    def height(self, x: Float64[np.ndarray, " all"], part: Part) -> tuple[float, Float64[np.ndarray, " free"]]:
        """That of a recording's body at x, see height_misfit."""
        return height_misfit(part.body, self.free, x[self.rows[part.person]])

    def _prior(self, x: Float64[np.ndarray, " all"]) -> float:
        return 0.5 * float(np.sum(((x - self.centre) / self.sd) ** 2))

    def _share(self, part: Part, good: np.ndarray) -> float:
        """What the deviations of a recording's frames count."""
        # frames that do not come to rest weigh nothing; the others stand in for them, so that losses compare
        return float(np.asarray(part.frames.weight).sum()) / max(int(good.sum()), 1) * (POINT_SD / self.noise) ** 2

    def _inputs(self, x: Float64[np.ndarray, " all"], part: Part) -> tuple:
        maps = tuple(jnp.asarray(m, jnp.float32) for m in self.free.maps)
        return jnp.asarray(x[self.rows[part.person]], jnp.float32), maps, self.objective

    def place(self, x: Float64[np.ndarray, " all"], starts: tuple[Poses, ...] = ()) -> Place:
        """All frames solved at x, and the loss; FitError if nothing is at rest."""
        loss = self._prior(x)
        all_found = []
        for part, start in zip(self.parts, starts or tuple(p.frames.poses for p in self.parts)):
            found = compiled_placed()(part.body, self.options, part.frames, start, *self._inputs(x, part))
            good, wanted = np.asarray(found.converged), float(np.asarray(part.frames.weight).sum())
            if good.sum() < FEWEST:
                raise FitError(
                    f"{part.name}: only {good.sum()} of {wanted:.0f} frames come to rest; more steps may help "
                    "(--fit.steps), or the log is not tracked well: look at it with voodoo-jax replay --picture"
                )
            loss += self._share(part, good) * float(np.asarray(found.cost, np.float64).sum())
            if self.objective == "held":
                loss += 0.5 * self.height(x, part)[0] ** 2
            all_found.append(found)
        rest, costs = zip(*((np.asarray(f.converged), np.asarray(f.cost, np.float64)) for f in all_found))
        return Place(loss, rest, costs, tuple(f.rest.poses for f in all_found), tuple(all_found))

    def step(self, x: Float64[np.ndarray, " all"], here: Place, without: int = -1) -> Step:
        """What a step from x needs; `without` one of PARTS parts of every recording."""
        slope, curve = (x - self.centre) / self.sd**2, np.zeros((len(x), len(x)))
        for part, found, good in zip(self.parts, here.found, here.at_rest):
            there = good & (np.arange(len(good)) * PARTS // len(good) != without)
            rows, share = self.rows[part.person], self._share(part, there)
            sums = compiled_normals()(part.body, self.options, part.frames, found, *self._inputs(x, part))
            slope[rows] += share * np.asarray(sums.slope, np.float64)[there].sum(0)
            curve[np.ix_(rows, rows)] += share * np.asarray(sums.curve, np.float64)[there].sum(0)
            if self.objective == "held":
                off, by_x = self.height(x, part)
                slope[rows] += off * by_x
                curve[np.ix_(rows, rows)] += np.outer(by_x, by_x)
        return Step(slope, curve)

    def compiled(self) -> None:
        """Compiles both programs for the first recording at the same time; else each is compiled when it is needed.

        Only compiles: two such programs that ran at the same time have waited for each other for ever.
        """
        part = self.parts[0]
        frames, inputs = part.frames, self._inputs(np.zeros(len(self.sd)), part)
        asked = part.body, self.options, frames, frames.poses, *inputs
        at = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), eqx.filter_eval_shape(placed, *asked))
        with ThreadPoolExecutor(2) as pool:
            both = (compiled_placed(), frames.poses), (compiled_normals(), at)
            lowered = [f.lower(part.body, self.options, frames, start, *inputs) for f, start in both]  # pyright: ignore
            for job in [pool.submit(program.compile) for program in lowered]:
                job.result()

    def gain(self, x: np.ndarray, other: np.ndarray, here: Place, there: Place) -> float:
        """By how much the loss is smaller at `other`, in frames that are at rest at both."""
        out = self._prior(x) - self._prior(other)
        for k, part in enumerate(self.parts):
            both = here.at_rest[k] & there.at_rest[k]
            out += self._share(part, both) * float((here.costs[k] - there.costs[k])[both].sum())
            if self.objective == "held":
                out += 0.5 * (self.height(x, part)[0] ** 2 - self.height(other, part)[0] ** 2)
        return out

    def changes(self, x: Float64[np.ndarray, " all"], part: Part) -> Changes:
        """What x says of a recording's person."""
        return self.free.changes(jnp.asarray(x[self.rows[part.person]], jnp.float32))

    def body(self, x: Float64[np.ndarray, " all"], part: Part) -> Body:
        """A recording's body at x."""
        return changed(part.body, self.changes(x, part))


def run_search(
    search: Searched, progress: Progress, most: int, say: Callable[[Progress], None] | None = None
) -> tuple[Progress, Place]:
    """Steps until the loss falls no more, or `most` were taken; `say` hears of each one, and may raise to stop."""
    place = search.place(progress.x)
    if not progress.losses:
        progress = replace(progress, losses=(place.loss,))
    while not progress.done and progress.step < most:
        # both sides of a comparison begin with the same poses: a solve that goes on from its own end differs a little
        starts = place.poses
        here = search.place(progress.x, starts)
        sums = search.step(progress.x, here)
        full = sums.curve + np.diag(1 / search.sd**2)
        full = (full + progress.damping * np.diag(np.diag(full)))[np.ix_(~search.held, ~search.held)]
        step = np.zeros(len(progress.x))
        step[~search.held] = -np.linalg.solve(full, sums.slope[~search.held])
        # at most one and a half usual deviations at once: matches change on the way
        step *= min(1.0, 1.5 / max(float(np.max(np.abs(step) / search.sd)), 1e-9))
        share, gain, there = along(search, progress.x, step, here, starts)
        if gain > 0:
            small = bool(gain < GAIN * here.loss + LEAST)
            progress = replace(
                progress, x=progress.x + share * step, damping=max(progress.damping / 5, 1e-3), done=small
            )
            place = there
        else:
            progress = replace(progress, damping=max(progress.damping, 1e-2) * 10, done=progress.damping > 1)
        # what was gained in frames that are at rest both times: losses of other frames do not compare
        loss = progress.losses[-1] - max(gain, 0.0)
        progress = replace(progress, step=progress.step + 1, losses=(*progress.losses, loss))
        if say is not None:
            say(progress)
    return progress, place


def along(
    search: Searched, x: np.ndarray, step: np.ndarray, here: Place, starts: tuple[Poses, ...]
) -> tuple[float, float, Place]:
    """Share of the step that gains most, what it gains, and what was found there.

    Derivatives know of no point that changes its limb, and these changes are half of the way: twice or four times the
    step often gains more, and where it gains nothing a part of it may.
    """

    def at(share: float) -> tuple[float, float, Place]:
        try:
            there = search.place(x + share * step, starts)
        except FitError:  # a body that too few frames come to rest with gains nothing
            return share, -np.inf, here
        return share, search.gain(x, x + share * step, here, there), there

    best = at(1.0)
    for share in (2.0, 4.0) if best[1] > 0 else (0.5, 0.2):
        other = at(share)
        if other[1] <= best[1] and best[1] > 0:
            break
        best = max(best, other, key=lambda one: one[1])
    return best


def covariance(search: Searched, x: Float64[np.ndarray, " all"], place: Place) -> Float64[np.ndarray, "all all"]:
    """Covariance of the parameters after the fit, from the Gauss-Newton matrix and the priors; of what is held as if it
    were free."""
    return np.linalg.inv(search.step(x, place).curve + np.diag(1 / search.sd**2))


def spread(search: Searched, x: Float64[np.ndarray, " all"], place: Place) -> Float64[np.ndarray, " all"]:
    """How much every parameter hangs on the part of the recordings that it is found from: standard deviation by
    leaving out each part in turn (jackknife), by one step from x."""
    found = []
    for part in range(PARTS):
        sums = search.step(x, place, part)
        found.append(-np.linalg.solve(sums.curve + np.diag(1 / search.sd**2), sums.slope))
    return np.sqrt((PARTS - 1) * np.var(found, axis=0))


def undetermined(sd: Float64[np.ndarray, " all"], prior_sd: Float64[np.ndarray, " all"]) -> Bool[np.ndarray, " all"]:
    """What the recordings do not tell: less than KNOWN of all that is known of it afterwards comes from them."""
    return 1 - (sd / prior_sd) ** 2 < KNOWN
