"""Cross-validation over recordings for parameters shared by all people.

Bands, measurement weights and options of the solve are the same for everybody. Time held back in the fitted recordings
says little about other people, so whole recordings are left out: each fold is tracked with the parameters fitted to the
others.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np

from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.fit import SHARED, Found, Seen, TruthLike, fit_of, free_of, searched, track_again
from voodoo_jax.fitting.frames import read_truth
from voodoo_jax.fitting.gauss_newton import FitError
from voodoo_jax.fitting.judge import Judged, judged_by, verdict_on
from voodoo_jax.fitting.result import Fit
from voodoo_jax.model.body import Body

# Factor on the width of the priors, compared with fits without folds. Measured (experiments/fit/folds.py, arms whose
# weights are wrong by factors of 4): joints of left-out recordings 1.73, 1.58, 1.50 cm off with priors 1, 2, 4 times as
# wide; with correct weights 1.50.
WIDER = 4.0


def folds_of(count: int, folds: int) -> list[range]:
    """Splits recordings, in the order given, into runs of nearly equal length, so that consecutive recordings of a
    person are mostly in one fold. Raises FitError with fewer recordings than folds."""
    if not 2 <= folds <= count:
        raise FitError(f"{folds} folds of {count} recordings: say --folds from 2 to the number of recordings")
    ends = np.linspace(0, count, folds + 1).round().astype(int).tolist()
    return [range(a, b) for a, b in zip(ends, ends[1:])]


def check_common(names: Sequence[str]) -> None:
    """Raises FitError if a free parameter belongs to a single person."""
    if alone := [n for n in names if not n.startswith(SHARED)]:
        raise FitError(
            f"folds judge parameters shared by all people, and {alone[0]} belongs to one person: "
            "say --free bands or --free 'measurement weights', or leave --folds out"
        )


def with_bands(body: Body, was: Body, now: Body) -> Body:
    """A body, of any size, with its bands changed as those of another body from `was` to `now`."""
    grown = float(now.scale) / float(was.scale)
    weights = np.asarray(body.weights) * np.asarray(now.weights) / np.asarray(was.weights)
    there = np.asarray(was.axes) > 0
    axes = np.asarray(body.axes) * np.where(there, np.asarray(now.axes) / np.where(there, was.axes, 1.0) / grown, 1.0)
    return eqx.tree_at(lambda b: (b.weights, b.axes), body, (weights.astype(np.float32), axes.astype(np.float32)))


def fit_folds(
    seen: Sequence[Seen],
    settings: Settings,
    options: FitSettings,
    truths: Sequence[TruthLike] = (),
    say: Callable[..., None] | None = None,
) -> Fit:
    """Fits to all recordings, and judges by `options.folds` fits, each to all recordings but one fold.

    During the fit the person of each recording has a separate body; the Fit's `body` is the given one with the fitted
    bands. Raises FitError, also if sizes are free, since these belong to one person.
    """
    own = replace(options, folds=0, persons="each", looseness=options.looseness * WIDER)
    start = seen[0].given or seen[0].tracks.body
    check_common(free_of(seen, settings, options).names)
    judged: list[Judged] = []
    for fold in folds_of(len(seen), options.folds):
        rest = [k for k in range(len(seen)) if k not in fold]
        theirs = [truths[k] for k in rest] if truths else ()
        found = searched([seen[k] for k in rest], settings, own, theirs, say=say)
        judged += [left_out(seen[k], found, settings, truths[k] if truths else None) for k in fold]
    whole = searched(seen, settings, own, truths, say=say)
    moved, none = whole.progress.x / whole.search.sd, np.zeros(len(whole.search.sd), bool)
    verdict = verdict_on(judged, moved, none, bool(truths), bool(whole.stays.all()))
    fitted = with_bands(start, whole.starts[0], whole.fitted[0])
    body = fitted if verdict.better else start
    made = fit_of(whole, settings, options, judged, verdict)
    return replace(made, body=body, bodies=(body,), fitted=(fitted,), starts=(start,), sizes=())


def left_out(one: Seen, found: Found, settings: Settings, truth: TruthLike) -> Judged:
    """Judges a fit by a recording that it did not use, tracked with the body before and after; all frames count."""
    known = read_truth(truth) if isinstance(truth, (str, os.PathLike)) else truth
    before = track_again(one, one.tracks.body, settings).tracks
    tuned = with_bands(one.tracks.body, found.starts[0], found.fitted[0])
    after = track_again(one, tuned, found.tuned(settings)).tracks
    judged = judged_by(before, after, 0, known)
    return replace(judged, held=np.ones_like(judged.held))
