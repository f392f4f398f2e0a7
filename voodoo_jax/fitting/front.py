"""Fits a body's sizes, joints and bands to recordings: `fit`."""

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
    """Fits a body to recordings, or to their true joint centres. The Fit's `body` is the better one of the body before
    and the fitted body (see fitting.judge); `better` says which.

    **Arguments:** `logs` paths or recordings; `truths` one for each log, to fit to joint centres; `state` a file in
    which the search is saved after every step, and from which it resumes; `say` is called with the task and the state
    of the search after every step; `free` names of the free parameters, instead of those in `options`.

    Raises FitError, LogError, TruthError, ValueError (unknown parameters).
    """
    settings, options = settings or Settings(), options or FitSettings()
    options = replace(options, free=tuple(free)) if free else options
    check_fit(options)
    if not logs:
        raise FitError("name at least one log to fit to")
    if options.folds:
        folds_of(len(logs), options.folds)  # check before tracking
    if truths and len(truths) != len(logs):
        raise FitError(f"{len(logs)} logs, but {len(truths)} truths: give one for each log, in the same order")
    if settings.tracker == "both":
        raise FitError("sizes are fitted with a single tracker: set tracker to icp or flexible")
    if settings.tracker == "flexible":
        return fit_flexible(body, logs, settings, options, truths, state, say)
    if truths and not all_shared(options.free):
        # the fit places the joints: a stage learned from other people would move them again
        settings = replace(settings, track=replace(settings.track, skip=(*settings.track.skip, "place_joints")))
    tell = say or (lambda what, progress: None)
    seen = tracked(body, logs, settings, lambda what: tell(what, None))
    if options.folds:
        return fit_folds(seen, settings, options, truths, say)
    return fit_tracked(seen, settings, options, truths, state, say)


def all_shared(free: Sequence[str]) -> bool:
    """Whether all words and patterns of free parameters name parameters shared by all persons."""
    return all(word == "measurement weights" or f"{word}.".startswith(SHARED) for word in free)
