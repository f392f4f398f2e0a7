"""A search without gradients for noise and weights of the flexible tracker: CMA-ES (Hansen, arXiv:1604.00772).

Through the filters there is no useful gradient: drawing particles anew, nearest pixels and the choice of points are
steps (docs/flexible.md). So settings are sampled from a normal distribution over the logarithms of their numbers, which
moves to where tracking a half of the logs errs least. The other half judges.
"""

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from voodoo_jax.compile.cache_dir import users_cache
from voodoo_jax.config.options import FlexibleSettings, Settings
from voodoo_jax.config.tune_options import GROUPS, SHARES, TuneSettings, check_tune
from voodoo_jax.fitting.flexible_fit import observed_log
from voodoo_jax.fitting.frames import RUNS, Truth, read_truth, runs
from voodoo_jax.fitting.gauss_newton import FitError
from voodoo_jax.fitting.judge import Compared, Judged, compared
from voodoo_jax.model.body import Body
from voodoo_jax.records.recording import Recording
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import LogInfo
from voodoo_jax.trackers.flexible.tracker import Observed, follow

LOST = 0.5  # metres, by hand: a joint that is farther off, or not tracked, counts as this; how far it is tells nothing
JUDGING = 1_000_000  # seeds from here on judge: none of them has been searched with


class Watched(NamedTuple):
    """A log, read once, and its truth."""

    source: LogInfo
    seen: Observed
    truth: Truth


@dataclass(frozen=True)
class Tuned:
    """What a search has found."""

    before: Settings
    found: Settings
    better: bool  # on the logs held back, beyond noise
    why: str  # a plain sentence
    chosen_on: tuple[str, ...]  # names of logs
    judged_on: tuple[str, ...]
    errors: tuple[tuple[float, float], ...]  # of each generation: least and mean error of its candidates, metres
    judged: tuple[Judged, ...]  # of the logs held back

    @property
    def settings(self) -> Settings:
        """The better ones."""
        return self.found if self.better else self.before


def free_names(patterns: Sequence[str], s: FlexibleSettings) -> tuple[str, ...]:
    """The settings that may change. Raises FitError for unknown ones, and where none is left."""
    known = dict.fromkeys(name for group in GROUPS.values() for name in group)
    names: list[str] = []
    for pattern in patterns:
        if pattern not in GROUPS and pattern not in known:
            raise FitError(f"--free '{pattern}': there are {', '.join([*GROUPS, *known])}")
        names += GROUPS.get(pattern, (pattern,))
    found = tuple(n for n in dict.fromkeys(names) if prod(np.atleast_1d(getattr(s, n)).tolist()) > 0)
    if not found:
        raise FitError(f"nothing is free: {', '.join(names)} are 0, and what is 0 is switched off")
    return found


def changed(s: FlexibleSettings, names: Sequence[str], x: Float64[np.ndarray, " free"]) -> FlexibleSettings:
    """Settings whose numbers are exp(x) times as large; shares at most 1. A tuple's numbers change alike."""
    new = {}
    for name, factor in zip(names, np.exp(x).tolist()):
        old = getattr(s, name)
        most = 1.0 if name in SHARES else np.inf
        new[name] = tuple(v * factor for v in old) if isinstance(old, tuple) else min(old * factor, most)
    return replace(s, **new)


@users_cache()
def tune(
    body: Body,
    logs: Sequence[str | os.PathLike[str] | Recording],
    truths: Sequence[Truth | str | os.PathLike[str]],
    settings: Settings,
    options: TuneSettings | None = None,
    say: Callable[[str, int], None] | None = None,
) -> Tuned:
    """Searches for better numbers of settings.flexible: on every second log, judged on the others.

    **Arguments:** `truths` one for each log; `say` hears what is being done, and how many settings were tried.

    Raises FitError, LogError, TruthError, ValueError, Unsuitable; ImportError without the package cma.
    """
    from cma import CMAEvolutionStrategy  # an extra: only for this

    options, tell = options or TuneSettings(), say or (lambda what, count: None)
    check_tune(options)
    names = free_names(options.free, settings.flexible)
    if len(logs) < 2 or len(truths) != len(logs):
        raise FitError(f"{len(logs)} logs and {len(truths)} truths: two logs at least, and a truth for each")
    with ExitStack() as opened:
        watched = []
        for log, truth in zip(logs, truths):
            known = read_truth(truth) if isinstance(truth, (str, os.PathLike)) else truth
            source, seen = observed_log(body, log, settings, opened, lambda name: tell(f"reading {name}", 0))
            watched.append(Watched(source, seen, known))
        ours, others = watched[::2], watched[1::2]
        search = CMAEvolutionStrategy(
            np.zeros(len(names)), options.spread,
            {"seed": 1 + settings.flexible.seed, "verbose": -9, "maxfevals": options.evaluations},
        )  # fmt: skip
        errors: list[tuple[float, float]] = []
        while not search.stop():
            seeds = settings.flexible.seed + options.seeds * len(errors) + np.arange(options.seeds)
            candidates, losses = search.ask(), []
            for x in candidates:
                losses.append(loss_of(body, ours, _with(settings, names, x), seeds.tolist()))
                tell(f"best of this round {100 * min(losses):.2f} cm", int(search.countevals) + len(losses))
            search.tell(candidates, losses)
            errors.append((float(min(losses)), float(np.mean(losses))))
        # the mean of the distribution: the best candidate is one that was lucky with its random numbers
        found = _with(settings, names, np.asarray(search.result.xfavorite))
        tell("judging", int(search.countevals))
        seeds = [JUDGING + k for k in range(options.judging_seeds)]
        judged = tuple(_judged(body, one, settings, found, seeds) for one in others)
    better, why = verdict(compared(judged, True), sum(j.lost for j in judged))
    chosen_on, judged_on = (tuple(Path(w.source.path).stem for w in half) for half in (ours, others))
    return Tuned(settings, found, better, why, chosen_on, judged_on, tuple(errors), judged)


def verdict(found: Compared, lost: int) -> tuple[bool, str]:
    """Whether settings are better by what was measured before and after, and why, as a sentence."""
    size = f"in logs held back joints are off by {found.before_cm:.2f} cm before and {found.after_cm:.2f} cm after"
    if lost > 0:
        return False, f"The settings stay as they were: with those found {lost} more frames are lost ({size})."
    # by the mean as well: a log that is twice as bad is not made up for by two that are half as bad
    if not (found.change < -found.least and found.after_cm < found.before_cm):
        how = "worse" if found.change > found.least else "no better beyond noise"
        return False, f"The settings stay as they were: those found are {how} ({size})."
    return True, f"The settings found are better: {size}."


def loss_of(body: Body, logs: Sequence[Watched], settings: Settings, seeds: Sequence[int]) -> float:
    """Mean distance of joints from the truth, metres, over logs and seeds."""
    return float(
        np.mean(
            [np.nanmean(_distances(_tracks(body, one, settings, seed), one.truth)) for one in logs for seed in seeds]
        )
    )


def _distances(tracks: Tracks, truth: Truth) -> Float64[np.ndarray, " time"]:
    """Mean distance of the joints at the truth's stamps, metres; lost frames count too. NaN: nothing is known."""
    names = list(tracks.body.topology.centres)
    at = np.abs(tracks.time_ns[None] - truth.time_ns[:, None]).argmin(1)
    shared = [n for n in truth.names if n in names]
    theirs = truth.joints[:, [truth.names.index(n) for n in shared]]
    off = np.linalg.norm(tracks.joints[at][:, [names.index(n) for n in shared]] - theirs, axis=-1)
    off, known = np.minimum(np.where(np.isfinite(off), off, LOST), LOST), np.isfinite(theirs).all(-1)
    return np.where(known.any(-1), np.where(known, off, 0).sum(-1) / np.maximum(known.sum(-1), 1), np.nan)


def _with(settings: Settings, names: Sequence[str], x: Float64[np.ndarray, " free"]) -> Settings:
    return replace(settings, flexible=changed(settings.flexible, names, x))


def _tracks(body: Body, one: Watched, settings: Settings, seed: int) -> Tracks:
    seeded = replace(settings, flexible=replace(settings.flexible, seed=seed))
    return follow(body, one.seen, seeded, one.source.path, one.source.fixed_frame)


def _judged(body: Body, one: Watched, before: Settings, after: Settings, seeds: Sequence[int]) -> Judged:
    """A log with both settings: means over seeds, of all runs of time, for none was searched on."""
    run, tracked, means = runs(len(one.truth.time_ns)), [], []
    for settings in (before, after):
        tracks = [_tracks(body, one, settings, seed) for seed in seeds]
        off = np.mean([_distances(t, one.truth) for t in tracks], 0)
        known = np.isfinite(off)
        counts = np.bincount(run[known], minlength=RUNS)
        sums = np.bincount(run[known], off[known], RUNS)
        means.append(np.where(counts > 0, sums / np.maximum(counts, 1), np.nan))
        tracked.append(float(np.mean([t.tracked.sum() for t in tracks])))
    nothing = np.full(RUNS, np.nan)
    name = Path(one.source.path).name
    return Judged(name, 0, np.ones(RUNS, bool), nothing, nothing, means[0], means[1], round(tracked[0] - tracked[1]))
