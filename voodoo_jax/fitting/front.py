"""A body's sizes, joints and bands from recordings: `fit`."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace

from voodoo_jax.compile.cache_dir import users_cache
from voodoo_jax.config.fit_options import FitSettings, check_fit
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.checkpoint import Progress
from voodoo_jax.fitting.fit import SHARED, TruthLike, fit_tracked
from voodoo_jax.fitting.flexible_fit import fit_flexible
from voodoo_jax.fitting.folds import fit_folds, folds_of
from voodoo_jax.fitting.gauss_newton import FitError
from voodoo_jax.fitting.result import Fit
from voodoo_jax.fitting.seen import Log, tracked
from voodoo_jax.model.body import Body


# 8 parameters: the options of the command, each by name
@users_cache()
def fit(
    body: Body,
    logs: Sequence[Log],
    settings: Settings | None = None,
    options: FitSettings | None = None,
    truths: Sequence[TruthLike] = (),
    state: str | os.PathLike[str] | None = None,
    say: Callable[[str, Progress | None], None] | None = None,
    *,
    free: Sequence[str] = (),
) -> Fit:
    """Tunes a body to recordings, or to their truth where one is given; the Fit's `body` is the better one of the body
    before and the fitted one (see fitting.judge), `better` says which.

    **Arguments:** `logs` paths or recordings; `truths` one for each log: then joint centres are what is fitted to;
    `state` a file that the search is saved in after every step, and resumed from; `say` hears what is being done, step
    by step; `free` what may change, instead of what `options` say.

    Raises FitError, LogError, TruthError, ValueError (unknown parameters).
    """
    settings, options = settings or Settings(), options or FitSettings()
    options = replace(options, free=tuple(free)) if free else options
    check_fit(options)
    if not logs:
        raise FitError("name at least one log to fit to")
    if options.folds:
        folds_of(len(logs), options.folds)  # before anything is tracked
    if truths and len(truths) != len(logs):
        raise FitError(f"{len(logs)} logs, but {len(truths)} truths: give one for each log, in the same order")
    if settings.tracker == "both":
        raise FitError("sizes are fitted with one of both trackers: set tracker to icp or flexible")
    if settings.tracker == "flexible":
        return fit_flexible(body, logs, settings, options, truths, state, say)
    if truths and not all_shared(options.free):
        # joints are where the fit puts them: what was learned of other people would move them again
        settings = replace(settings, track=replace(settings.track, skip=(*settings.track.skip, "place_joints")))
    tell = say or (lambda what, progress: None)
    seen = tracked(body, logs, settings, lambda what: tell(what, None))
    if options.folds:
        return fit_folds(seen, settings, options, truths, say)
    return fit_tracked(seen, settings, options, truths, state, say)


def all_shared(free: Sequence[str]) -> bool:
    """Whether words and patterns of what is free name nothing but what several persons have in common."""
    return all(word == "measurement weights" or f"{word}.".startswith(SHARED) for word in free)
