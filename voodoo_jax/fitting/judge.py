"""Judges a fitted body against the one before, by tracks of whole recordings in held-back runs of time.

Host side. Where points judge sizes the bands are stiffer than in tracking, since soft bands hide a wrong length.
The fitted body is better if three conditions hold: no more frames are lost; held-back points, or known joints, are
closer to it beyond noise; and sizes moved by more than the error of a body made of cylinders.
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

SIZES = ("scale", "shape", "lengths", "radii", "anchors")  # names of sizes of the body begin with these
ERROR = 0.05  # rate at which noise makes a body that is not better pass as better
UNLIKELY = 0.05  # rate at which correct sizes move this far because people are not made of cylinders
FEWEST = 4  # least number of runs of time for a judgement


@dataclass(frozen=True)
class Judged:
    """One recording tracked with the body before and after the fit: means of every run of time. NaN: unknown."""

    name: str
    person: int
    held: Bool[np.ndarray, " run"]  # runs held back from the fit
    before: Float64[np.ndarray, " run"]  # distance of the points from the body, root mean square, metres
    after: Float64[np.ndarray, " run"]
    joints_before: Float64[np.ndarray, " run"]  # mean distance of joint centres from the truth, metres
    joints_after: Float64[np.ndarray, " run"]
    lost: int  # frames that are tracked before and not after, less those that are tracked after alone


@dataclass(frozen=True)
class Verdict:
    """Whether the fitted body is better, and why."""

    better: bool
    why: str  # a sentence for the report


class Compared(NamedTuple):
    """The change in held-back time."""

    change: float  # mean logarithm of the error after over that before
    least: float  # least difference from 0 that is more than noise
    before_cm: float
    after_cm: float
    runs: int  # of time


def is_size(names: tuple[str, ...]) -> Bool[np.ndarray, " all"]:
    """Which parameters are sizes of the body; the others belong to the method and have no true value."""
    return np.array([n.startswith(SIZES) for n in names], bool)


def weakly_determined(
    names: tuple[str, ...],
    x: Float64[np.ndarray, " all"],
    sd: Float64[np.ndarray, " all"],
    prior: Float64[np.ndarray, " all"],
    apart: Float64[np.ndarray, " all"],
) -> Bool[np.ndarray, " all"]:
    """Which sizes the recordings do not determine: they stay where the priors are centred.

    Bands and settings are never among them: they have no true value that the start could be close to. The priors limit
    them, and tracking with them judges them.

    **Arguments:** `x` the fitted values less the priors' centres; `sd` their standard deviations; `prior` those of the
    priors; `apart` standard deviations between parts of the recordings.
    """
    return is_size(names) & (undetermined(sd, prior) | (np.abs(x) < SURE * apart))


def judged_by(before: Tracks, after: Tracks, person: int, truth: Truth | None = None) -> Judged:
    """Compares tracks of a recording before and after; frames count if both have them tracked."""
    count = len(before.time_ns)
    both, run = before.tracked & after.tracked, runs(count)

    def means(values: np.ndarray) -> np.ndarray:
        there = both & np.isfinite(values)
        seen = np.bincount(run[there], minlength=RUNS)
        with np.errstate(invalid="ignore"):
            return np.bincount(run[there], values[there].astype(np.float64), RUNS) / np.where(seen > 0, seen, np.nan)

    joints = [_measure_errors(tracks, truth) for tracks in (before, after)]
    held = np.arange(RUNS) % EVERY > 0
    points = [np.sqrt(means(tracks.evidence.residual**2)) for tracks in (before, after)]
    lost = int(before.tracked.sum()) - int(after.tracked.sum())
    name = before.source.replace("\\", "/").rpartition("/")[2]
    return Judged(name, person, held, points[0], points[1], means(joints[0]), means(joints[1]), lost)


def _measure_errors(tracks: Tracks, truth: Truth | None) -> Float64[np.ndarray, " frame"]:
    """Mean distance of each frame's joints from the truth, metres; NaN without a truth."""
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
    """Compares held-back runs of time before and after; `known`: by joints, else by points."""
    pairs = [(j.joints_before, j.joints_after) if known else (j.before, j.after) for j in judged]
    # logarithms give recordings with different noise the same weight
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

    **Arguments:** `moved` the fitted values, in standard deviations of the priors; `sizes` which of them are moved
    sizes; `known` true joints judge, not points; `same` no parameter moved.
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
        return Verdict(False, f"{kept}: sizes moved no more than by the error of a body made of cylinders ({size}).")
    return Verdict(True, f"The fitted body is better: {size}.")
