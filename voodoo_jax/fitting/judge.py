"""Whether a fitted body is better than the one before: by tracks of whole recordings, in runs of time held back.

Host side. Where points judge sizes the bands are stiffer than in tracking: soft ones give way to a wrong length. Three
things must hold: no frames are lost; what was held back lies nearer to the new body, or known joints do, beyond noise;
and sizes moved by more than they do because a person is not made of cylinders.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64
from scipy import stats

from voodoo_jax.fitting.frames import EVERY, HALF_FRAME_NS, RUNS, Truth, runs
from voodoo_jax.fitting.gauss_newton import SURE, undetermined
from voodoo_jax.fitting.parameters import SYSTEMATIC
from voodoo_jax.records.tracks import Tracks

ERROR = 0.05  # how often a body that is no better may pass for better because of noise
UNLIKELY = 0.05  # how often sizes that are right may move so far because a person is not made of cylinders
FEWEST = 4  # runs of time that a judgement needs


@dataclass(frozen=True)
class Judged:
    """One recording tracked with the body before and after the fit: means of every run of time. NaN: nothing known."""

    name: str
    person: int
    held: Bool[np.ndarray, " run"]  # runs that nothing was fitted to
    before: Float64[np.ndarray, " run"]  # distance of the points from the body, root mean square, metres
    after: Float64[np.ndarray, " run"]
    joints_before: Float64[np.ndarray, " run"]  # mean distance of joint centres from the truth, metres
    joints_after: Float64[np.ndarray, " run"]
    lost: int  # frames that are tracked before and not after, less those that are tracked after alone


@dataclass(frozen=True)
class Verdict:
    """Whether the fitted body is better, and why."""

    better: bool
    why: str  # a plain sentence


class Compared(NamedTuple):
    """What changed in time held back."""

    change: float  # mean logarithm of the error after over that before
    least: float  # by which it has to differ from 0 to be more than noise
    before_cm: float
    after_cm: float
    runs: int  # of time


def is_size(names: tuple[str, ...]) -> Bool[np.ndarray, " all"]:
    """Which parameters are sizes of the body: the others are inventions of the method, with nothing true about them."""
    return np.array([n.startswith(("shape", "scale", "lengths", "radii", "anchors")) for n in names], bool)


def weakly_determined(
    names: tuple[str, ...],
    x: Float64[np.ndarray, " all"],
    sd: Float64[np.ndarray, " all"],
    prior: Float64[np.ndarray, " all"],
    apart: Float64[np.ndarray, " all"],
) -> Bool[np.ndarray, " all"]:
    """Which sizes the recordings do not tell: they stay as they were.

    Bands and settings never do. They have no true value that the start might be near to: what is found is held by the
    priors and judged by tracking with it.

    **Arguments:** `x` what was found, `sd` its deviations, `prior` those of the priors, `apart` by how much it differs
    between parts of the recordings.
    """
    return is_size(names) & (undetermined(sd, prior) | (np.abs(x) < SURE * apart))


def judged_by(before: Tracks, after: Tracks, person: int, truth: Truth | None = None) -> Judged:
    """A recording before and after; a frame counts only if it is tracked both times."""
    count = len(before.time_ns)
    both, run = before.tracked & after.tracked, runs(count)

    def means(values: np.ndarray) -> np.ndarray:
        there = both & np.isfinite(values)
        seen = np.bincount(run[there], minlength=RUNS)
        with np.errstate(invalid="ignore"):
            return np.bincount(run[there], values[there].astype(np.float64), RUNS) / np.where(seen > 0, seen, np.nan)

    joints = [_off(tracks, truth) for tracks in (before, after)]
    held = np.arange(RUNS) % EVERY > 0
    points = [np.sqrt(means(tracks.evidence.residual**2)) for tracks in (before, after)]
    lost = int(before.tracked.sum()) - int(after.tracked.sum())
    name = before.source.replace("\\", "/").rpartition("/")[2]
    return Judged(name, person, held, points[0], points[1], means(joints[0]), means(joints[1]), lost)


def _off(tracks: Tracks, truth: Truth | None) -> Float64[np.ndarray, " frame"]:
    """Mean distance of a frame's joints from the truth, metres; NaN where there is none."""
    out = np.full(len(tracks.time_ns), np.nan)
    if truth is None:
        return out
    shared = [
        (k, tracks.body.topology.centres.index(n))
        for k, n in enumerate(truth.names)
        if n in tracks.body.topology.centres
    ]
    if not shared or not len(truth.time_ns):
        return out
    theirs, ours = (list(column) for column in zip(*shared))
    near = np.abs(tracks.time_ns[:, None] - truth.time_ns).argmin(1)
    gap = np.linalg.norm(tracks.joints[:, ours] - truth.joints[near][:, theirs], axis=-1)
    gap[np.abs(tracks.time_ns - truth.time_ns[near]) >= HALF_FRAME_NS] = np.nan
    seen = np.isfinite(gap)
    return np.where(seen.any(1), np.where(seen, gap, 0).sum(1) / np.maximum(seen.sum(1), 1), np.nan)


def compared(judged: Sequence[Judged], known: bool) -> Compared:
    """Runs of time held back, before and after; `known` joints are compared, else points."""
    pairs = [(j.joints_before, j.joints_after) if known else (j.before, j.after) for j in judged]
    # logarithms: recordings of different noise count alike
    change = np.concatenate([np.log(a[j.held] / b[j.held]) for j, (b, a) in zip(judged, pairs)])
    change = change[np.isfinite(change)]
    mean = lambda side: float(np.nanmean(np.concatenate([p[side][j.held] for j, p in zip(judged, pairs)])))  # noqa: E731
    count = len(change)
    if count < FEWEST:
        return Compared(0.0, np.inf, 100 * mean(0), 100 * mean(1), count)
    least = float(stats.t.ppf(1 - ERROR, count - 1)) * float(change.std(ddof=1)) / np.sqrt(count)
    return Compared(float(change.mean()), least, 100 * mean(0), 100 * mean(1), count)


def verdict_on(
    judged: list[Judged], moved: Float64[np.ndarray, " all"], sizes: Bool[np.ndarray, " all"], known: bool, same: bool
) -> Verdict:
    """The verdict on a fit.

    **Arguments:** `moved` what was found, in deviations of the priors; `sizes` which of that are sizes that moved;
    `known` the truth of joints is given, and judges; `same` nothing moved.
    """
    kept = "The body stays as it was"
    if same:
        return Verdict(False, f"{kept}: the logs do not tell these sizes.")
    lost = sum(j.lost for j in judged)
    if lost > 0:
        return Verdict(False, f"{kept}: with the fitted body {lost} more frames are lost.")
    c = compared(judged, known)
    what = "joints are off" if known else "points lie off the body"
    size = f"in time held back {what} by {c.before_cm:.3f} cm before and {c.after_cm:.3f} cm after"
    if c.runs < FEWEST:
        return Verdict(False, f"{kept}: too little of the logs is tracked to judge by.")
    if c.change > c.least:
        return Verdict(False, f"{kept}: the fitted one is worse ({size}).")
    if c.change >= -c.least:
        return Verdict(False, f"{kept}: the fitted one is no better beyond noise ({size}).")
    far = float(np.sum((moved[sizes] / SYSTEMATIC) ** 2))
    if not known and sizes.any() and far < stats.chi2.ppf(1 - UNLIKELY, int(sizes.sum())):
        return Verdict(
            False, f"{kept}: sizes moved by no more than they do because people are not made of cylinders ({size})."
        )
    return Verdict(True, f"The fitted body is better: {size}.")
