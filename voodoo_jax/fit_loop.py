"""The search: damped Gauss-Newton over the parameters of all persons, step by step; it can be stopped and resumed.

Every step solves all frames anew from where the last step left them and takes one tangent per parameter through the
implicit solution. optimistix' Levenberg-Marquardt would solve them twice a step and from their first poses; it serves
where the loss is the user's own function (fit_body).
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float64

from voodoo_jax.body import Body
from voodoo_jax.fit_objective import JOINT_SD, PER_LIMB, POINT_SD, FitFrames, Normals, Objective, normals
from voodoo_jax.fit_parameters import HEIGHT, Parameters, changed, height_of
from voodoo_jax.icp import IcpOptions
from voodoo_jax.io.atomic import replacing
from voodoo_jax.pose import Poses

GAIN = 1e-3  # a step that gains less of the loss is the last
FEWEST = 6  # frames of a log that must be at rest
# a large program on XLA's pool of CPU threads may wait for ever for other threads of that pool (seen with two)
ALONE = {"xla_cpu_multi_thread_eigen": False}


class Part(NamedTuple):
    """One recording in a fit."""

    name: str
    body: Body  # before the fit
    frames: FitFrames  # those that are fitted to have weight, those held out have none
    person: int


@dataclass(frozen=True)
class Progress:
    """Where a search stands; all that is needed to go on."""

    x: Float64[np.ndarray, " all"]
    step: int = 0
    damping: float = 1e-3
    losses: tuple[float, ...] = ()
    done: bool = False


@dataclass(frozen=True)
class Sums:
    """All recordings at one place: half the squared deviations per frame, and the sums of a Gauss-Newton step."""

    loss: float
    slope: Float64[np.ndarray, " all"]
    curve: Float64[np.ndarray, "all all"]  # of the data alone
    at_rest: tuple[np.ndarray, ...]  # [frame] of each recording
    costs: tuple[np.ndarray, ...]  # [frame] of each recording; 0 where not at rest
    poses: tuple[Poses, ...]


class FitError(ValueError):
    """A fit that cannot be made; says why, and what to try."""


def _sums_of(
    body: Body, options: IcpOptions, frames: FitFrames, starts: Poses, x, maps, objective: Objective
) -> Normals:
    free = Parameters((), np.zeros(0), maps, True)  # the names are not needed here
    return normals(body, options, frames, starts, x, free.changes, objective)


compiled_sums: Callable[..., Normals] = eqx.filter_jit(_sums_of, compiler_options=ALONE)  # pyright: ignore[reportCallIssue]


@eqx.filter_jit
def _height_off(body: Body, x, maps) -> tuple[Array, Array]:
    """Logarithm of the changed body's height over the body's, and its derivative."""
    free = Parameters((), np.zeros(0), maps, True)
    return jax.value_and_grad(lambda x: jnp.log(height_of(changed(body, free.changes(x))) / height_of(body)))(x)


@dataclass(frozen=True)
class Search:
    """What is fitted to what. `rows[person]` says which entries of the vector are a person's parameters."""

    free: Parameters  # of one person
    parts: tuple[Part, ...]
    options: IcpOptions
    objective: Objective
    rows: tuple[np.ndarray, ...]
    sd: Float64[np.ndarray, " all"]
    noise: float = POINT_SD  # standard deviation of a point, metres

    def unit(self, part: Part) -> float:
        """Root mean square distance, metres, where a frame's squared deviations add up to one."""
        if self.objective == "truth" and part.frames.known is not None:
            return JOINT_SD / float(np.sqrt(np.asarray(part.frames.known).sum(1).mean()))
        return POINT_SD / float(np.sqrt(PER_LIMB * part.body.limb_count))

    def height(self, x: Float64[np.ndarray, " all"], part: Part) -> tuple[float, Float64[np.ndarray, " free"]]:
        """How far a recording's body is from the height that was measured, in standard deviations, and its slope."""
        maps = tuple(jnp.asarray(m, jnp.float32) for m in self.free.maps)
        off, slope = _height_off(part.body, jnp.asarray(x[self.rows[part.person]], jnp.float32), maps)
        return float(off) / HEIGHT, np.asarray(slope, np.float64) / HEIGHT

    def sums(self, x: Float64[np.ndarray, " all"], starts: tuple[Poses, ...] = ()) -> Sums:
        """The loss at x and what a step needs, with the priors in loss and slope; FitError if nothing is at rest."""
        slope, curve = x / self.sd**2, np.zeros((len(x), len(x)))
        loss = 0.5 * float(np.sum((x / self.sd) ** 2))
        rest, costs, poses = [], [], []
        maps = tuple(jnp.asarray(m, jnp.float32) for m in self.free.maps)
        for part, start in zip(self.parts, starts or tuple(p.frames.poses for p in self.parts)):
            rows = self.rows[part.person]
            at = jnp.asarray(x[rows], jnp.float32)
            found = compiled_sums(part.body, self.options, part.frames, start, at, maps, self.objective)
            good, wanted = np.asarray(found.converged), float(np.asarray(part.frames.weight).sum())
            if good.sum() < FEWEST:
                raise FitError(
                    f"{part.name}: only {good.sum()} of {wanted:.0f} frames come to rest; more steps may help "
                    "(--fit.steps), or the log is not tracked well: look at it with voodoo-jax replay --picture"
                )
            # frames that do not come to rest weigh nothing; the others stand in for them, so that losses compare
            share = wanted / good.sum() * (POINT_SD / self.noise) ** 2
            loss += share * float(np.asarray(found.cost, np.float64).sum())
            slope[rows] += share * np.asarray(found.slope, np.float64).sum(0)
            curve[np.ix_(rows, rows)] += share * np.asarray(found.curve, np.float64).sum(0)
            if self.objective == "held":
                off, by_x = self.height(x, part)
                loss += 0.5 * off**2
                slope[rows] += off * by_x
                curve[np.ix_(rows, rows)] += np.outer(by_x, by_x)
            rest.append(good)
            costs.append(np.asarray(found.cost, np.float64))
            poses.append(found.poses)
        return Sums(loss, slope, curve, tuple(rest), tuple(costs), tuple(poses))

    def gain(self, x: np.ndarray, other: np.ndarray, here: Sums, there: Sums) -> float:
        """By how much the loss is smaller at `other`, in frames that are at rest at both."""
        out = 0.5 * float(np.sum((x / self.sd) ** 2) - np.sum((other / self.sd) ** 2))
        for k, part in enumerate(self.parts):
            both = here.at_rest[k] & there.at_rest[k]
            share = float(np.asarray(part.frames.weight).sum()) / max(both.sum(), 1) * (POINT_SD / self.noise) ** 2
            out += share * float((here.costs[k] - there.costs[k])[both].sum())
            if self.objective == "held":
                out += 0.5 * (self.height(x, part)[0] ** 2 - self.height(other, part)[0] ** 2)
        return out

    def body(self, x: Float64[np.ndarray, " all"], part: Part) -> Body:
        """A recording's body at x."""
        return changed(part.body, self.free.changes(jnp.asarray(x[self.rows[part.person]], jnp.float32)))


def run_search(
    search: Search, progress: Progress, most: int, say: Callable[[Progress], None] | None = None
) -> tuple[Progress, Sums]:
    """Steps until the loss falls no more, or `most` were taken; `say` hears of each one, and may raise to stop."""
    sums = search.sums(progress.x)
    if not progress.losses:
        progress = replace(progress, losses=(sums.loss,))
    while not progress.done and progress.step < most:
        # both sides of a comparison begin with the same poses: a solve that goes on from its own end differs a little
        starts = sums.poses
        here = search.sums(progress.x, starts)
        full = here.curve + np.diag(1 / search.sd**2)
        step = -np.linalg.solve(full + progress.damping * np.diag(np.diag(full)), here.slope)
        # at most one and a half usual deviations at once: matches change on the way
        step *= min(1.0, 1.5 / max(float(np.max(np.abs(step) / search.sd)), 1e-9))
        share, gain, there = _along(search, progress.x, step, here, starts)
        if gain > 0:
            small = bool(gain < GAIN * here.loss)
            progress = replace(
                progress, x=progress.x + share * step, damping=max(progress.damping / 5, 1e-3), done=small
            )
            sums = there
        else:
            progress = replace(progress, damping=max(progress.damping, 1e-2) * 10, done=progress.damping > 1)
        progress = replace(progress, step=progress.step + 1, losses=(*progress.losses, sums.loss))
        if say is not None:
            say(progress)
    return progress, sums


def _along(
    search: Search, x: np.ndarray, step: np.ndarray, here: Sums, starts: tuple[Poses, ...]
) -> tuple[float, float, Sums]:
    """Share of the step that gains most, what it gains, and the sums there.

    Derivatives know of no point that changes its limb, and these changes are half of the way: twice or four times the
    step often gains more, and where it gains nothing a part of it may.
    """

    def at(share: float) -> tuple[float, float, Sums]:
        there = search.sums(x + share * step, starts)
        return share, search.gain(x, x + share * step, here, there), there

    best = at(1.0)
    for share in (2.0, 4.0) if best[1] > 0 else (0.5, 0.2):
        other = at(share)
        if other[1] <= best[1] and best[1] > 0:
            break
        best = max(best, other, key=lambda one: one[1])
    return best


def save_progress(progress: Progress, path: str | os.PathLike[str], fingerprint: str) -> None:
    """Writes a state file, complete or not at all."""
    with replacing(path) as partial, open(partial, "wb") as file:
        np.savez(
            file, x=progress.x, step=progress.step, damping=progress.damping, losses=np.array(progress.losses),
            done=progress.done, fingerprint=np.array(fingerprint),
        )  # fmt: skip


def load_progress(path: str | os.PathLike[str], fingerprint: str) -> Progress | None:
    """What save_progress wrote; None if there is no file, or one of another fit."""
    try:
        with np.load(path, allow_pickle=False) as file:
            if str(file["fingerprint"]) != fingerprint:
                return None
            losses = tuple(float(v) for v in file["losses"])
            return Progress(file["x"], int(file["step"]), float(file["damping"]), losses, bool(file["done"]))
    except (OSError, ValueError, KeyError):
        return None


def deviations(search: Search, sums: Sums) -> Float64[np.ndarray, " all"]:
    """Standard deviation of every parameter after the fit, from the Gauss-Newton matrix and the priors."""
    return np.sqrt(np.diag(np.linalg.inv(sums.curve + np.diag(1 / search.sd**2))))
