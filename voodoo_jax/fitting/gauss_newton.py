"""The search: damped Gauss-Newton over the parameters of all persons; it can be stopped and resumed after every step.

Every step solves all frames again from the poses of the last step and takes one tangent per parameter through the
implicit solution. optimistix' Levenberg-Marquardt would solve them twice per step and from their first poses; its
minimisers are used for losses that are not least squares (fitting.tuning). Both find the same minimum
(tests/fitting/test_fit.py).
"""

from abc import ABC, abstractmethod
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

GAIN, LEAST = 1e-4, 0.02  # a step that gains less than this share of the loss, plus this, is the last
SURE = 2.0  # a size is the usual one if it differs by less than this many spreads between parts of the recordings
FEW_MORE = 4  # further steps while some sizes are held
SPLITS = 4  # parts of a recording, left out in turn for the spread of the sizes
KNOWN = 0.1  # least share of the data in the information on a size, of data and prior
FEWEST = 6  # least number of frames of a log at rest


class Part(NamedTuple):
    """One recording in a fit."""

    name: str
    body: Body  # before the fit
    frames: FitFrames  # weight 0: padding
    person: int


@dataclass(frozen=True)
class Place:
    """All recordings solved at one parameter vector."""

    loss: float  # half the squared deviations, priors included
    at_rest: tuple[np.ndarray, ...]  # [frame] of each recording
    costs: tuple[np.ndarray, ...]  # [frame] of each recording, half the squared deviations; 0 where not at rest
    poses: tuple[Poses, ...]
    found: tuple[Any, ...]  # inputs of the search's `step`


class Step(NamedTuple):
    """The sums of a Gauss-Newton step."""

    slope: Float64[np.ndarray, " all"]  # priors included
    curve: Float64[np.ndarray, "all all"]  # of the data alone


@runtime_checkable
class Searched(Protocol):
    """A problem for run_search: the parameters' priors, and the loss and its derivatives."""

    @property
    def sd(self) -> Float64[np.ndarray, " all"]: ...
    @property
    def held(self) -> Bool[np.ndarray, " all"]: ...
    def place(self, x: Float64[np.ndarray, " all"], starts: tuple[Poses, ...] = ()) -> Place: ...
    def step(self, x: Float64[np.ndarray, " all"], here: Place, without: int = -1) -> Step: ...
    def gain(self, x: np.ndarray, other: np.ndarray, here: Place, there: Place) -> float: ...


class FitError(ValueError):
    """The fit is not possible; says why, and what to try."""


# two programs, compiled at the same time: most parameter vectors need no derivatives
@cache
def compiled_placed() -> Callable[..., Placed]:
    return quickly(placed)


@cache
def compiled_normals() -> Callable[..., Normals]:
    return quickly(normals)


@eqx.filter_jit
def _compute_height_error(body: Body, x, maps) -> tuple[Array, Array]:
    """Logarithm of the changed body's height over the measured height, and its derivative."""
    measured = height_ratio(body) * body.scale
    return jax.value_and_grad(lambda x: jnp.log(height_of(changed(body, changes_at(maps, x))) / measured))(x)


def height_misfit(
    body: Body, free: Parameters, x: Float64[np.ndarray, " free"]
) -> tuple[float, Float64[np.ndarray, " free"]]:
    """Deviation of a body changed by x from the measured height, in standard deviations, and its derivative; 0 if the
    body's scale is not a height, such as an arm's reach."""
    if body.scale_name != "stature":
        return 0.0, np.zeros(len(x))
    maps = tuple(jnp.asarray(m, jnp.float32) for m in free.maps)
    off, slope = _compute_height_error(body, jnp.asarray(x, jnp.float32), maps)
    return float(off) / HEIGHT, np.asarray(slope, np.float64) / HEIGHT


@dataclass(frozen=True)
class BaseSearch(ABC):
    """Parameters and recordings of a fit, for run_search; `rows[person]` entries of the vector for each person."""

    free: Parameters  # of one person
    parts: tuple[Any, ...]  # recordings, each with its `body` before the fit, `frames` and number of its `person`
    objective: Objective
    rows: tuple[np.ndarray, ...]
    sd: Float64[np.ndarray, " all"]
    centre: Float64[np.ndarray, " all"]  # of the priors
    held: Bool[np.ndarray, " all"]  # entries that keep their values
    noise: float = POINT_SD  # standard deviation of a point, metres
    features: tuple[str, ...] = ()  # names of the measured features

    @abstractmethod
    def sums(self, x: Float64[np.ndarray, " all"], part: Any, found: Any) -> Any:
        """Gauss-Newton sums `slope` and `curve` of each frame of a recording at x, where `place` has found `found`."""

    @abstractmethod
    def weight(self, part: Any, there: Bool[np.ndarray, " frame"]) -> float:
        """Weight of the squared deviations of a recording's frames `there`, which also stand for its other frames."""

    def step(self, x: Float64[np.ndarray, " all"], here: Place, without: int = -1) -> Step:
        """Sums of a step from x; `without` the part of every recording to leave out."""
        slope, curve = (x - self.centre) / self.sd**2, np.zeros((len(x), len(x)))
        for part, found, good in zip(self.parts, here.found, here.at_rest):
            there = good & (np.arange(len(good)) * SPLITS // len(good) != without)
            rows, share, sums = self.rows[part.person], self.weight(part, there), self.sums(x, part, found)
            slope[rows] += share * np.asarray(sums.slope, np.float64)[there].sum(0)
            curve[np.ix_(rows, rows)] += share * np.asarray(sums.curve, np.float64)[there].sum(0)
            if self.objective == "held":
                off, by_x = self.height(x, part)
                slope[rows] += off * by_x
                curve[np.ix_(rows, rows)] += np.outer(by_x, by_x)
        return Step(slope, curve)

    def prior(self, x: Float64[np.ndarray, " all"]) -> float:
        """Loss of the priors at x."""
        return 0.5 * float(np.sum(((x - self.centre) / self.sd) ** 2))

    def height(self, x: Float64[np.ndarray, " all"], part: Any) -> tuple[float, Float64[np.ndarray, " free"]]:
        """height_misfit of the body of a recording at x."""
        return height_misfit(part.body, self.free, x[self.rows[part.person]])

    def inputs(self, x: Float64[np.ndarray, " all"], part: Any) -> tuple[Array, tuple[Array, ...]]:
        """The parameters of a recording's person at x, and the maps, as inputs of programs."""
        maps = tuple(jnp.asarray(m, jnp.float32) for m in self.free.maps)
        return jnp.asarray(x[self.rows[part.person]], jnp.float32), maps

    def changes(self, x: Float64[np.ndarray, " all"], part: Any) -> Changes:
        """The changes of the person in a recording at x."""
        return self.free.changes(jnp.asarray(x[self.rows[part.person]], jnp.float32))

    def body(self, x: Float64[np.ndarray, " all"], part: Any) -> Body:
        """The body of a recording at x."""
        return changed(part.body, self.changes(x, part))


@dataclass(frozen=True, kw_only=True)
class Search(BaseSearch):
    """Parameters and recordings (each a Part) of a fit with the ICP tracker."""

    options: IcpOptions

    def weight(self, part: Part, there: Bool[np.ndarray, " frame"]) -> float:
        # frames that do not come to rest are replaced by a higher weight of the others, so that losses compare
        return float(np.asarray(part.frames.weight).sum()) / max(int(there.sum()), 1) * (POINT_SD / self.noise) ** 2

    def place(self, x: Float64[np.ndarray, " all"], starts: tuple[Poses, ...] = ()) -> Place:
        """Solves all frames at x; FitError if too few of them come to rest."""
        loss = self.prior(x)
        all_found = []
        for part, start in zip(self.parts, starts or tuple(p.frames.poses for p in self.parts)):
            inputs = *self.inputs(x, part), self.objective
            found = compiled_placed()(part.body, self.options, part.frames, start, *inputs)
            good, wanted = np.asarray(found.converged), float(np.asarray(part.frames.weight).sum())
            if good.sum() < FEWEST:
                raise FitError(
                    f"{part.name}: only {good.sum()} of {wanted:.0f} frames come to rest; more steps may help "
                    "(--fit.steps), or the log is not tracked well: look at it with voodoo-jax replay --picture"
                )
            loss += self.weight(part, good) * float(np.asarray(found.cost, np.float64).sum())
            if self.objective == "held":
                loss += 0.5 * self.height(x, part)[0] ** 2
            all_found.append(found)
        rest, costs = zip(*((np.asarray(f.converged), np.asarray(f.cost, np.float64)) for f in all_found))
        return Place(loss, rest, costs, tuple(f.rest.poses for f in all_found), tuple(all_found))

    def sums(self, x: Float64[np.ndarray, " all"], part: Part, found: Placed) -> Normals:
        """Gauss-Newton sums of the frames at rest."""
        return compiled_normals()(part.body, self.options, part.frames, found, *self.inputs(x, part), self.objective)

    def compiled(self) -> None:
        """Compiles both programs for the first recording at the same time, instead of each at its first use.

        Does not run them: two such programs running at the same time have deadlocked.
        """
        part = self.parts[0]
        frames, inputs = part.frames, (*self.inputs(np.zeros(len(self.sd)), part), self.objective)
        asked = part.body, self.options, frames, frames.poses, *inputs
        at = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), eqx.filter_eval_shape(placed, *asked))
        with ThreadPoolExecutor(2) as pool:
            both = (compiled_placed(), frames.poses), (compiled_normals(), at)
            lowered = [f.lower(part.body, self.options, frames, start, *inputs) for f, start in both]  # pyright: ignore
            for job in [pool.submit(program.compile) for program in lowered]:
                job.result()

    def gain(self, x: np.ndarray, other: np.ndarray, here: Place, there: Place) -> float:
        """Decrease of the loss from x to `other`, over frames that are at rest in both."""
        out = self.prior(x) - self.prior(other)
        for k, part in enumerate(self.parts):
            both = here.at_rest[k] & there.at_rest[k]
            out += self.weight(part, both) * float((here.costs[k] - there.costs[k])[both].sum())
            if self.objective == "held":
                out += 0.5 * (self.height(x, part)[0] ** 2 - self.height(other, part)[0] ** 2)
        return out


def run_search(
    search: Searched, progress: Progress, most: int, say: Callable[[Progress], None] | None = None
) -> tuple[Progress, Place]:
    """Steps until the loss stops falling, or to step `most`; `say` is called after each step, and may raise to stop."""
    place = search.place(progress.x)
    if not progress.losses:
        progress = replace(progress, losses=(place.loss,))
    while not progress.done and progress.step < most:
        # both sides of a comparison start from the same poses: a solve resumed from its own result differs slightly
        starts = place.poses
        here = search.place(progress.x, starts)
        sums = search.step(progress.x, here)
        full = sums.curve + np.diag(1 / search.sd**2)
        full = (full + progress.damping * np.diag(np.diag(full)))[np.ix_(~search.held, ~search.held)]
        step = np.zeros(len(progress.x))
        step[~search.held] = -np.linalg.solve(full, sums.slope[~search.held])
        # at most 1.5 prior deviations per step, since correspondences change on the way
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
        # the decrease over frames at rest both times: losses of other frames do not compare
        loss = progress.losses[-1] - max(gain, 0.0)
        progress = replace(progress, step=progress.step + 1, losses=(*progress.losses, loss))
        if say is not None:
            say(progress)
    return progress, place


def along(
    search: Searched, x: np.ndarray, step: np.ndarray, here: Place, starts: tuple[Poses, ...]
) -> tuple[float, float, Place]:
    """Line search: the best multiple of the step, its gain, and its Place.

    Derivatives do not include points that change their limb, which are half of the effect: two or four times the step
    often gains more, and if the whole step gains nothing, a part of it may.
    """

    def at(share: float) -> tuple[float, float, Place]:
        try:
            there = search.place(x + share * step, starts)
        except FitError:  # too few frames come to rest: no gain
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
    """Covariance of the parameters after the fit, from the Gauss-Newton matrix and the priors; held parameters count as
    free."""
    return np.linalg.inv(search.step(x, place).curve + np.diag(1 / search.sd**2))


def spread(search: Searched, x: Float64[np.ndarray, " all"], place: Place) -> Float64[np.ndarray, " all"]:
    """Standard deviation of every parameter between parts of the recordings: each part is left out in turn (jackknife),
    with one step from x."""
    found = []
    for part in range(SPLITS):
        sums = search.step(x, place, part)
        found.append(-np.linalg.solve(sums.curve + np.diag(1 / search.sd**2), sums.slope))
    return np.sqrt((SPLITS - 1) * np.var(found, axis=0))


def undetermined(sd: Float64[np.ndarray, " all"], prior_sd: Float64[np.ndarray, " all"]) -> Bool[np.ndarray, " all"]:
    """Parameters for which less than the share KNOWN of the final information comes from the recordings."""
    return 1 - (sd / prior_sd) ** 2 < KNOWN
