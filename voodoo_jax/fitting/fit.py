"""Fits a body's sizes, joints and bands to recordings tracked by the ICP tracker, and judges the result."""

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float64, Int

from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.checkpoint import Progress, resumed
from voodoo_jax.fitting.frames import Truth, chosen_frames, feature_names, fit_frames, read_truth
from voodoo_jax.fitting.gauss_newton import FEW_MORE, BaseSearch, Part, Search, covariance, run_search, spread
from voodoo_jax.fitting.judge import Judged, Verdict, is_size, judged_by, verdict_on, weakly_determined
from voodoo_jax.fitting.parameters import Parameters, parameters, usual_lengths, with_lengths
from voodoo_jax.fitting.result import Fit
from voodoo_jax.fitting.seen import Seen
from voodoo_jax.fitting.sizes import sizes_after
from voodoo_jax.fitting.tuned_options import tuned_settings
from voodoo_jax.model.body import Body, scaled, segment_lengths
from voodoo_jax.solve.scan import options_from

SHARED = ("bands.", "solve.", "features.")  # parameters shared by all persons
# Factor on the stiffness of the bands where points judge sizes: tracks with lengths 8 % too long and with the usual
# ones then differ beyond noise in 16 of 18 recordings, with the bands of tracking in 15 (experiments/fit).
JUDGED = 4.0
MOVED = 0.2  # standard deviations of the result: a round with smaller changes is the last


TruthLike = Truth | str | os.PathLike[str] | None


class Found(NamedTuple):
    """Result of a search, not yet judged."""

    search: BaseSearch
    progress: Progress
    covariance: Float64[np.ndarray, "all all"]
    spread: Float64[np.ndarray, " all"]
    stays: Bool[np.ndarray, " all"]

    @property
    def starts(self) -> tuple[Body, ...]:
        """Bodies of all persons before the fit."""
        return tuple(part.body for part in self._first_parts())

    @property
    def fitted(self) -> tuple[Body, ...]:
        """Fitted bodies of all persons."""
        return tuple(self.search.body(self.progress.x, part) for part in self._first_parts())

    def tuned(self, settings: Settings) -> Settings:
        """The settings with the fitted options and weights."""
        first = self._first_parts()[0]
        changes = self.search.changes(self.progress.x, first)
        return tuned_settings(settings, first.body.topology, changes, self.search.features)

    def _first_parts(self) -> list[Any]:
        """The first recording of every person."""
        return [next(p for p in self.search.parts if p.person == k) for k in range(len(self.search.rows))]


# 7 parameters: those of `fit`, and truths for the report
def fit_tracked(
    seen: Sequence[Seen],
    settings: Settings,
    options: FitSettings,
    truths: Sequence[TruthLike] = (),
    state: str | os.PathLike[str] | None = None,
    say: Callable[[str, Progress | None], None] | None = None,
    judge: Sequence[TruthLike] = (),
) -> Fit:
    """`fit` from recordings that are already tracked; `judge` truths used only by the report."""
    found = searched(seen, settings, options, truths, state, say)
    search, x, tuned = found.search, found.progress.x, found.tuned(settings)
    if say is not None:
        say("judging", found.progress)
    known = [read_truth(t) if isinstance(t, (str, os.PathLike)) else t for t in truths or judge] or [None] * len(seen)
    if not x.any():  # the same body
        judged = [
            judged_by(s.tracks, s.tracks, part.person, truth) for s, part, truth in zip(seen, search.parts, known)
        ]
    else:
        stiff = 1.0 if truths or _bands_free(search) else JUDGED
        stiffer = [
            replace(some, solve=replace(some.solve, ratio=some.solve.ratio * stiff)) for some in (settings, tuned)
        ]
        pairs = [
            [track_again(one, body, some).tracks for body, some in zip((p.body, search.body(x, p)), stiffer)]
            for one, p in zip(seen, search.parts)
        ]
        judged = [judged_by(was, now, p.person, t) for (was, now), p, t in zip(pairs, search.parts, known)]
    sizes, usual = is_size(entry_names(search)) & (x != 0), search.sd / options.looseness
    verdict = verdict_on(judged, x / usual, sizes, bool(truths), not x.any())
    return fit_of(found, settings, options, judged, verdict)


def fit_of(found: Found, settings: Settings, options: FitSettings, judged: Sequence[Judged], verdict: Verdict) -> Fit:
    """The Fit from the result of a search and its judgement."""
    search, x = found.search, found.progress.x
    starts, fitted = found.starts, found.fitted
    bodies = fitted if verdict.better else starts
    sizes = tuple(
        sizes_after(start, search.free, x[rows], found.covariance[np.ix_(rows, rows)])
        for start, rows in zip(starts, search.rows)
    )
    return Fit(
        bodies[0], bodies, fitted, starts, verdict, entry_names(search), x, np.sqrt(np.diag(found.covariance)),
        found.spread, search.sd, found.stays, sizes, found.progress.losses, found.progress.done, tuple(judged), options,
        found.tuned(settings),
    )  # fmt: skip


# 6 parameters: those of `fit`
def searched(
    seen: Sequence[Seen],
    settings: Settings,
    options: FitSettings,
    truths: Sequence[TruthLike] = (),
    state: str | os.PathLike[str] | None = None,
    say: Callable[[str, Progress | None], None] | None = None,
) -> Found:
    """Runs the search alone; arguments of `fit`."""
    tell = say or (lambda what, progress: None)
    free = free_of(seen, settings, options)
    seen = [in_usual_lengths(one, free, settings) for one in seen]
    chosen = [chosen_frames(s.tracks, _count_points(s), options.frames) for s in seen]
    search = _stiffen_bands(search_of(seen, settings, options, truths, chosen), options)
    size = len(search.sd)
    progress, step_done = resumed(state, _fingerprint(search, options), search.centre, tell)
    cov, apart, stays = np.full((size, size), np.nan), np.full(size, np.nan), np.zeros(size, bool)
    search.compiled()
    for number in range(1, options.rounds + 1):
        began = progress.x
        progress, place = run_search(search, progress, number * options.iterations, step_done)
        cov, apart = covariance(search, progress.x, place), spread(search, progress.x, place)
        moved = float(np.max(np.abs(progress.x - began) / np.sqrt(np.diag(cov)), initial=0.0))
        if number == options.rounds or moved < MOVED:
            break
        tell("tracking again", progress)
        again = [track_again(one, search.body(progress.x, part), settings) for one, part in zip(seen, search.parts)]
        parts = search_of(again, settings, options, truths, chosen).parts
        parts = tuple(old._replace(frames=new.frames) for old, new in zip(search.parts, parts))
        search, progress = replace(search, parts=parts), replace(progress, done=False)
    # weakly determined sizes are the usual ones, and the others are fitted again
    moved = progress.x - search.centre
    stays = weakly_determined(entry_names(search), moved, np.sqrt(np.diag(cov)), search.sd, apart)
    if stays.any():
        progress = replace(progress, x=np.where(stays, search.centre, progress.x), done=bool(stays.all()))
        progress, _ = run_search(replace(search, held=stays), progress, progress.step + FEW_MORE, step_done)
    return Found(search, progress, cov, apart, stays)


def _stiffen_bands(search: Search, options: FitSettings) -> Search:
    """The search with stiffer bands, unless they are free."""
    ratio = search.options.ratio * (1.0 if _bands_free(search) else options.stiffness)
    return replace(search, options=eqx.tree_at(lambda o: o.ratio, search.options, ratio))


def _bands_free(search: BaseSearch) -> bool:
    return any(n.startswith(("bands.", "solve.")) for n in search.free.names)


def _count_points(seen: Seen) -> Int[np.ndarray, " frame"]:
    """Number of points on the person in each frame."""
    return np.array([len(frame.points) for frame in seen.people], int)


def track_again(seen: Seen, body: Body, settings: Settings) -> Seen:
    """Tracks a recording with a body of known size."""
    start = replace(settings.start, scale=float(body.scale))
    track = replace(settings.track, skip=(*settings.track.skip, "fit_forearms"))
    return _tracked_with(seen, body, replace(settings, start=start, track=track))


def _tracked_with(seen: Seen, body: Body, settings: Settings) -> Seen:
    from voodoo_jax.trackers.base import LogInfo, Task
    from voodoo_jax.trackers.of_points import track_person

    source = LogInfo(seen.tracks.source, seen.tracks.fixed_frame)
    return seen._replace(tracks=track_person(Task(body, source, settings), seen.scene, seen.people))


def in_usual_lengths(seen: Seen, free: Parameters, settings: Settings) -> Seen:
    """The recording tracked with a person's usual lengths, from which lengths that are free are sought: poses and
    stature found with wrong ones agree with these."""
    given = seen.given or seen.tracks.body
    centre = usual_lengths(given, free)
    if not centre.any():
        return seen
    return _tracked_with(seen, with_lengths(given, free, centre), settings)._replace(given=given)


def _measured(seen: Sequence[Seen]) -> dict[str, float]:
    """How much longer a person's segments are between placed joints than in the body, factors; means of recordings."""
    found = dict[str, list[float]]()
    for one in seen:
        own = segment_lengths(one.tracks.body)
        for name, length in (one.tracks.segments or {}).items():
            found.setdefault(name, []).append(length / own[name])
    return {name: float(np.mean(ratios)) for name, ratios in found.items()}


def features_of(seen: Sequence[Seen], settings: Settings) -> tuple[str, ...]:
    """Names of the features that are measured in some recordings."""
    topology = seen[0].tracks.body.topology
    return tuple(sorted({n for s in seen for n in feature_names(s.people, topology, settings.features)}))


def free_of(seen: Sequence[Seen], settings: Settings, options: FitSettings) -> Parameters:
    """The free parameters of a fit."""
    return parameters(seen[0].tracks.body, options.free, features_of(seen, settings), options.mirrored)


def search_of(
    seen: Sequence[Seen],
    settings: Settings,
    options: FitSettings,
    truths: Sequence[TruthLike] = (),
    chosen: Sequence[Int[np.ndarray, " chosen"]] = (),
) -> Search:
    """Sets up the search from recordings `in_usual_lengths`: free parameters, priors, and the `chosen` frames of each
    recording, or well tracked ones."""
    chosen = chosen or [chosen_frames(s.tracks, _count_points(s), options.frames) for s in seen]
    names, free = features_of(seen, settings), free_of(seen, settings, options)
    persons = [0 if options.persons == "one" else k for k in range(len(seen))]
    scales = [np.median([float(s.tracks.body.scale) for s, p in zip(seen, persons) if p == k]) for k in set(persons)]
    parts = []
    known = [read_truth(t) if isinstance(t, (str, os.PathLike)) else t for t in truths] or [None] * len(seen)
    for k, ((tracks, people, *_), at, person, truth) in enumerate(zip(seen, chosen, persons, known)):
        frames = fit_frames(
            tracks, people, at, settings.features, names, options.frames, options.points, truth, k, options.markers
        )
        # all recordings of a person have the same proportions: those given, but for parts that the tracker sized
        one = seen[persons.index(person)]
        own = with_lengths(one.tracks.body, free, -usual_lengths(one.given or one.tracks.body, free))
        own = scaled(own, float(scales[person]))
        parts.append(Part(Path(tracks.source).name, own, frames, person))
    icp = options_from(
        replace(settings.solve, max_steps=options.steps, epsilon=0.0, steady=0.0), settings.track, settings.features
    ).icp
    shared = np.array([n.startswith(SHARED) for n in free.names], bool)
    rows, size = [], int(shared.sum())
    for _ in set(persons):
        row = np.cumsum(shared) - 1
        row[~shared] = size + np.arange((~shared).sum())
        rows.append(row)
        size += int((~shared).sum())
    sd, centre = np.zeros(size), np.zeros(size)
    for person, row in enumerate(rows):
        sd[row] = free.sd * options.looseness
        # by the body before tracking: the prior leaves parts as the tracker sized them, such as forearms
        mine = [one for one, p in zip(seen, persons) if p == person]
        centre[row] = usual_lengths(mine[0].given or mine[0].tracks.body, free, _measured(mine))
    objective = "truth" if truths else "held"
    held = np.zeros(size, bool)
    return Search(free, tuple(parts), objective, tuple(rows), sd, centre, held, options.noise, names, options=icp)


def entry_names(search: BaseSearch) -> tuple[str, ...]:
    """Names of all entries of the vector; with several persons, those of one person end in the person's number."""
    out, persons = [""] * len(search.sd), len(search.rows)
    for person, rows in enumerate(search.rows):
        for name, row in zip(search.free.names, rows):
            out[row] = name if persons == 1 or name.startswith(SHARED) else f"{name} ({person + 1})"
    return tuple(out)


def _fingerprint(search: Search, options: FitSettings) -> str:
    """Hash of the inputs that a saved search must agree in to be resumed."""
    arrays = [np.asarray(v).tobytes() for p in search.parts for v in jax.tree.leaves((p.body, p.frames.points.xyz))]
    stop = repr(replace(options, iterations=0))
    return hashlib.sha256(
        b"".join([*arrays, stop.encode(), "\n".join([*(p.name for p in search.parts), *search.free.names]).encode()])
    ).hexdigest()
