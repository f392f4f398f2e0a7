"""A body's sizes, joints and bands from recordings: `fit`."""

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from voodoo_jax.body import Body, joint_centres, scaled
from voodoo_jax.compile_cache import users_cache
from voodoo_jax.fit_frames import Truth, chosen_frames, feature_names, fit_frames, held_out, read_truth, with_weight
from voodoo_jax.fit_loop import (
    FitError,
    Part,
    Place,
    Search,
    deviations,
    run_search,
)  # fmt: skip
from voodoo_jax.fit_objective import UserLoss
from voodoo_jax.fit_parameters import parameters
from voodoo_jax.fit_progress import Progress, load_progress, save_progress
from voodoo_jax.fit_settings import FitSettings
from voodoo_jax.fit_tuned import tuned_settings
from voodoo_jax.fit_user import minimised
from voodoo_jax.person_frame import PersonFrame
from voodoo_jax.recording import Recording
from voodoo_jax.scene import Scene
from voodoo_jax.settings import Settings
from voodoo_jax.tracking import options_from
from voodoo_jax.tracks import Tracks

SHARED = ("bands.", "solve.", "features.")  # what several persons have in common
MOVED = 0.2  # deviations of what was found: a round that changes nothing by more is the last


@dataclass(frozen=True)
class Judged:
    """One recording before and after the fit, frame by frame. NaN: not at rest, or no truth."""

    name: str
    person: int
    held: Bool[np.ndarray, " frame"]  # frames that nothing was fitted to
    before: Float64[np.ndarray, " frame"]  # distance of the judging points, metres (root mean square, robust)
    after: Float64[np.ndarray, " frame"]
    joints_before: Float64[np.ndarray, " frame"]  # mean distance of joint centres from the truth, metres
    joints_after: Float64[np.ndarray, " frame"]


@dataclass(frozen=True)
class Fit:
    """What a fit found. `x`, `sd`, `prior_sd` as in Parameters: logarithms of factors, or shares of the scale."""

    body: Body  # of the first person
    bodies: tuple[Body, ...]  # of every person
    starts: tuple[Body, ...]  # the same before the fit
    names: tuple[str, ...]
    x: Float64[np.ndarray, " all"]
    sd: Float64[np.ndarray, " all"]  # NaN where the loss is the user's own
    prior_sd: Float64[np.ndarray, " all"]
    losses: tuple[float, ...]
    finished: bool  # stopped by itself
    judged: tuple[Judged, ...]
    settings: FitSettings
    tuned: Settings  # the settings with what was found of the solve's options and of the features' weights

    @property
    def report(self) -> str:
        """The report as Markdown."""
        from voodoo_jax.io.fit_report import report_text

        return report_text(self)

    def undetermined(self) -> list[str]:
        """Parameters of which the data say next to nothing: their deviation is nearly that of the prior."""
        return [n for n, s, p in zip(self.names, self.sd, self.prior_sd) if s > 0.9 * p]


class Seen(NamedTuple):
    """One recording, tracked."""

    tracks: Tracks
    people: list[PersonFrame]
    scene: Scene | None = None  # to track it again with the body found; None: one round only


TruthLike = Truth | str | os.PathLike[str] | None
Log = str | os.PathLike[str] | Recording


@users_cache()
def fit(
    body: Body,
    logs: Sequence[Log],
    settings: Settings | None = None,
    options: FitSettings | None = None,
    truths: Sequence[TruthLike] = (),
    loss: UserLoss | None = None,
    state: str | os.PathLike[str] | None = None,
    say: Callable[[str, Progress | None], None] | None = None,
) -> Fit:
    """Tunes a body to recordings, or to their truth where one is given.

    **Arguments:** `logs` paths or recordings; `truths` one for each log: then joint centres are what is fitted to;
    `loss` a function (body, options, frames) to make small instead, with the priors added (see fit_user); `state` a
    file that the search is saved in after every step, and resumed from; `say` hears what is being done, step by step.

    Raises FitError, LogError, TruthError, ValueError (unknown parameters).
    """
    settings, options = settings or Settings(), options or FitSettings()
    if not logs:
        raise FitError("name at least one log to fit to")
    if truths and len(truths) != len(logs):
        raise FitError(f"{len(logs)} logs, but {len(truths)} truths: give one for each log, in the same order")
    tell = say or (lambda what, progress: None)
    seen = tracked(body, logs, settings, lambda what: tell(what, None))
    return fit_tracked(seen, settings, options, truths, loss, state, say)


def fit_tracked(
    seen: Sequence[Seen],
    settings: Settings,
    options: FitSettings,
    truths: Sequence[TruthLike] = (),
    loss: UserLoss | None = None,
    state: str | os.PathLike[str] | None = None,
    say: Callable[[str, Progress | None], None] | None = None,
    judge: Sequence[TruthLike] = (),
) -> Fit:
    """The same from tracks and the frames that they were found in; `judge` truths that only the report looks at."""
    tell = say or (lambda what, progress: None)
    chosen = [chosen_frames(s.tracks, s.people, options.frames) for s in seen]
    whole = now = search_of(seen, settings, options, truths or judge, chosen)
    if not truths:
        whole = now = replace(whole, objective="held")
    search = _fitted(now, options)
    size = len(search.sd)
    mark = _fingerprint(search, options)
    progress = (load_progress(state, mark) if state is not None else None) or Progress(np.zeros(size))

    def step_done(now: Progress) -> None:
        if state is not None:
            save_progress(now, state, mark)
        tell("fitting", now)

    tell("fitting", progress)
    sd = np.full(size, np.nan)
    if loss is not None:
        progress = minimised(search, loss, progress, options.iterations, step_done)
    else:
        search.compiled()
        for number in range(1, options.rounds + 1):
            began = progress.x
            progress, place = run_search(search, progress, number * options.iterations, step_done)
            sd = deviations(search, progress.x, place)
            moved = float(np.max(np.abs(progress.x - began) / sd, initial=0.0))
            if number == options.rounds or moved < MOVED or any(s.scene is None for s in seen):
                break
            tell("tracking again", progress)
            again = [_again(one, search.body(progress.x, part), settings) for one, part in zip(seen, search.parts)]
            parts = search_of(again, settings, options, truths or judge, chosen).parts
            now = replace(now, parts=tuple(old._replace(frames=new.frames) for old, new in zip(now.parts, parts)))
            search, progress = _fitted(now, options), replace(progress, done=False)
    tell("judging", progress)
    before, after = whole.place(np.zeros(size)), now.place(progress.x)
    first = [next(p for p in search.parts if p.person == k) for k in range(len(search.rows))]
    bodies = tuple(search.body(progress.x, p) for p in first)
    judged = tuple(_judged(search, part, k, progress.x, before, after) for k, part in enumerate(whole.parts))
    tuned = tuned_settings(settings, bodies[0].topology, search.changes(progress.x, first[0]), search.features)
    return Fit(
        bodies[0], bodies, tuple(p.body for p in first), _all_names(search, len(first)), progress.x, sd, search.sd,
        progress.losses, progress.done, judged, options, tuned,
    )  # fmt: skip


def _fitted(search: Search, options: FitSettings) -> Search:
    """The search without the frames that nothing is fitted to, and with stiffer bands unless they are free."""
    parts = (p._replace(frames=with_weight(p.frames, ~held_out(len(p.frames.weight)))) for p in search.parts)
    soft = any(n.startswith(("bands.", "solve.")) for n in search.free.names)
    ratio = search.options.ratio * (1.0 if soft else options.stiffness)
    return replace(search, parts=tuple(parts), options=eqx.tree_at(lambda o: o.ratio, search.options, ratio))


def _again(seen: Seen, body: Body, settings: Settings) -> Seen:
    """A recording tracked with a body of known size."""
    from voodoo_jax.tracker import track_person

    assert seen.scene is not None
    settings = replace(
        settings,
        start=replace(settings.start, scale=float(body.scale)),
        track=replace(settings.track, forearms=False),
    )
    found = track_person(body, seen.scene, seen.people, settings, seen.tracks.source, seen.tracks.fixed_frame)
    return seen._replace(tracks=found)


def tracked(
    body: Body, logs: Sequence[Log], settings: Settings, tell: Callable[[str], None] = lambda what: None
) -> list[Seen]:
    """Every log tracked with the body, and the person's frames."""
    from voodoo_jax.io.mcap_log import open_log
    from voodoo_jax.tracker import find_person, track_person

    seen = []
    for log in logs:
        if isinstance(log, Recording):
            source, frames = log, iter(log)
        else:
            source = open_log(log, settings.read)
            frames = source.frames()
        tell(f"tracking {Path(source.path).name}")
        scene, people = find_person(frames, source.up, body, settings)
        found = track_person(body, scene, people, settings, source.path, source.fixed_frame)
        seen.append(Seen(found, people, scene))
    return seen


def search_of(
    seen: Sequence[Seen],
    settings: Settings,
    options: FitSettings,
    truths: Sequence[TruthLike] = (),
    chosen: Sequence[Int[np.ndarray, " chosen"]] = (),
) -> Search:
    """What is free, and the frames that are looked at: `chosen` ones of each recording, or well tracked ones."""
    chosen = chosen or [chosen_frames(s.tracks, s.people, options.frames) for s in seen]
    body = seen[0].tracks.body
    names = tuple(sorted({n for s in seen for n in feature_names(s.people, body.topology, settings.features)}))
    free = parameters(body, options.free, names, options.mirrored)
    persons = [0 if options.persons == "one" else k for k in range(len(seen))]
    scales = [np.median([float(s.tracks.body.scale) for s, p in zip(seen, persons) if p == k]) for k in set(persons)]
    parts = []
    known = [read_truth(t) if isinstance(t, (str, os.PathLike)) else t for t in truths] or [None] * len(seen)
    for k, ((tracks, people, _), at, person, truth) in enumerate(zip(seen, chosen, persons, known)):
        frames = fit_frames(
            tracks, people, at, settings.features, names, options.frames, options.points, truth, k, options.markers
        )
        # the proportions, too, are the person's, not the log's
        own = scaled(seen[persons.index(person)].tracks.body, float(scales[person]))
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
    sd = np.zeros(size)
    for row in rows:
        sd[row] = free.sd * options.looseness
    objective = "truth" if truths else "held"
    return Search(free, tuple(parts), icp, objective, tuple(rows), sd, options.noise, names)


def _all_names(search: Search, persons: int) -> tuple[str, ...]:
    """A name for every entry of the vector; with several persons their own end in the person's number."""
    out = [""] * len(search.sd)
    for person, rows in enumerate(search.rows):
        for name, row in zip(search.free.names, rows):
            out[row] = name if persons == 1 or name.startswith(SHARED) else f"{name} ({person + 1})"
    return tuple(out)


def _fingerprint(search: Search, options: FitSettings) -> str:
    """What a saved search must agree in to be gone on with."""
    arrays = [np.asarray(v).tobytes() for p in search.parts for v in jax.tree.leaves((p.body, p.frames.points.xyz))]
    stop = repr(replace(options, iterations=0))
    return hashlib.sha256(
        b"".join([*arrays, stop.encode(), "\n".join([*(p.name for p in search.parts), *search.free.names]).encode()])
    ).hexdigest()


def _judged(search: Search, part: Part, k: int, x: np.ndarray, before: Place, after: Place) -> Judged:
    """One recording before and after; a frame counts only if it is at rest both times."""
    there = before.at_rest[k] & after.at_rest[k]
    off = lambda place: np.where(there, np.sqrt(2 * place.costs[k]) * search.unit(part), np.nan)  # noqa: E731
    joints = [np.full(len(there), np.nan)] * 2
    if part.frames.truth is not None and part.frames.known is not None:
        truth, known = part.frames.truth, np.asarray(part.frames.known)
        joints = []
        for own, place in ((part.body, before), (search.body(x, part), after)):
            found = eqx.filter_jit(eqx.filter_vmap(joint_centres, in_axes=(None, 0)))(own, place.poses[k])
            gap: Float[np.ndarray, "frame centre"] = np.asarray(jnp.sqrt(jnp.sum((found - truth) ** 2, -1)))
            mean = np.where(known, gap, 0).sum(1) / np.maximum(known.sum(1), 1)
            joints.append(np.where(there & known.any(1), mean, np.nan))
    held = held_out(len(there)) & (np.asarray(part.frames.weight) > 0)
    return Judged(part.name, part.person, held, off(before), off(after), *joints)
