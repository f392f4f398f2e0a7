"""Fits of a body's sizes with the flexible tracker, to images with depth.

As in fitting.fit, half of a frame's points determine the pose and the other half judge the sizes. Here the pose is the
tracked one after refinement, in which points pull and springs and limits hold. Particles are held fixed, since
resampling has no useful derivative (docs/flexible.md). Derivatives are taken forward, one tangent per parameter.
"""

import hashlib
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Float64

from voodoo_jax.compile.xla_options import quickly
from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.opening import open_checked
from voodoo_jax.detect.pipeline import build_of
from voodoo_jax.fitting.checkpoint import Progress, resumed
from voodoo_jax.fitting.fit import Found, entry_names, fit_of
from voodoo_jax.fitting.frames import Truth, chosen_frames, news, read_truth, truth_at
from voodoo_jax.fitting.gauss_newton import (
    FEW_MORE,
    BaseSearch,
    FitError,
    Place,
    covariance,
    run_search,
    spread,
)
from voodoo_jax.fitting.judge import SIZES, is_size, judged_by, verdict_on, weakly_determined
from voodoo_jax.fitting.objective import FEW, JOINT_SD, PER_LIMB, POINT_SD, ROBUST, Objective, as_distances
from voodoo_jax.fitting.parameters import Parameters, changed, parameters, usual_lengths
from voodoo_jax.fitting.result import Fit
from voodoo_jax.geometry.robust import geman_mcclure_root
from voodoo_jax.model.body import Body, scaled
from voodoo_jax.records.recording import Recording
from voodoo_jax.trackers.base import LogInfo, source_of, source_of_log, tracker_of
from voodoo_jax.trackers.flexible.cylinders import PARTS, surface_distance
from voodoo_jax.trackers.flexible.filters import clothed, refined
from voodoo_jax.trackers.flexible.flexible_body import CENTRES, LIMB_NAMES, POINTS, FlexibleBody, flexible_body
from voodoo_jax.trackers.flexible.poses import centres_of
from voodoo_jax.trackers.flexible.tracker import Followed, Observed, chosen_points, followed, looks, numbers, observe
from voodoo_jax.trackers.flexible.vectors import least, vectors

ROUNDS = 16  # rounds of refinement: twice those of tracking, since sizes change during the fit; by hand
PART_LIMBS = (*LIMB_NAMES, "head", "chest", "pelvis")  # limb of a person's body for each part of the flexible body


class FlexibleFrames(eqx.Module):
    """Frames to fit to; leading axis: frame."""

    x: Float[Array, "frame 16 3"]  # as tracked, metres
    points: Float[Array, "frame point 3"]
    solve: Float[Array, "frame point"]  # weight of each point for the pose
    held: Float[Array, "frame point"]  # weight of each point as a judge; one of both weights is 0
    bare: Float[Array, "frame point"]  # probability that each is skin, 0..1
    news: Float[Array, "frame part"]  # new information of the frame about each part, 0..1; see frames.news
    truth: Float[Array, "frame centre 3"] | None  # joint centres, metres
    known: Bool[Array, "frame centre"] | None
    shift: Float[Array, "frame centre 3"]  # offset from the point of its name to each joint centre, metres
    floor: Float[Array, "frame 4"]  # normal upwards and offset, metres
    weight: Float[Array, " frame"]  # 0: padding


class Sums(NamedTuple):
    """For each frame half the squared deviations, and the sums of a Gauss-Newton step."""

    cost: Float[Array, " frame"]
    slope: Float[Array, "frame free"]
    curve: Float[Array, "frame free free"]


def frame_residuals(
    body: FlexibleBody, frame: FlexibleFrames, centres: tuple[str, ...], legs_apart: float, objective: Objective
) -> Float[Array, " residual"]:
    """Residuals of one frame (no leading axes) in standard deviations: of held-back points or true joint centres."""
    x = refined(body, frame.x, frame.points, frame.solve, ROUNDS, legs_apart, frame.floor, frame.bare)
    if objective == "truth":
        assert frame.truth is not None and frame.known is not None
        named = {centre: POINTS.index(point) for point, centre in CENTRES.items()}
        at = x[np.array([named.get(centre, 0) for centre in centres])] + frame.shift
        gap = jnp.where(frame.known[:, None], at - frame.truth, 0.0)
        return (as_distances(gap) / JOINT_SD).reshape(-1)
    off = surface_distance(body, x, vectors(frame.points))
    best = least(jax.lax.stop_gradient(jnp.abs(off) + clothed(body, frame.bare)))
    off = jnp.take_along_axis(off, best[None], 0)[0]
    count = jax.ops.segment_sum(frame.held, best, PARTS)
    share = jnp.sqrt((PER_LIMB * frame.news / (count + FEW))[best] * frame.held)
    return off * jnp.sqrt(geman_mcclure_root(off**2, ROBUST)) * share / POINT_SD


# 6 parameters: those of the compiled program
def _sums(body: Body, frames: FlexibleFrames, x, maps, legs_apart: float, objective: Objective) -> Sums:
    free = Parameters((), np.zeros(0), maps, True)  # the names are not needed here

    def one(frame: FlexibleFrames) -> Sums:
        def residuals(x):
            new = changed(body, free.changes(x))
            r = frame_residuals(flexible_body(new, new.scale), frame, body.topology.centres, legs_apart, objective)
            return r, r

        by_x, r = jax.jacfwd(residuals, has_aux=True)(x)
        r, by_x = frame.weight * r, frame.weight * by_x
        return Sums(jnp.sum(r * r) / 2, r @ by_x, by_x.T @ by_x)

    return jax.lax.map(one, frames)


@cache
def compiled_sums() -> Callable[..., Sums]:
    return quickly(_sums)


class FlexiblePart(NamedTuple):
    """One recording in a fit."""

    name: str
    body: Body  # before the fit
    frames: FlexibleFrames
    person: int


@dataclass(frozen=True, kw_only=True)
class FlexibleSearch(BaseSearch):
    """Parameters and recordings (each a FlexiblePart) of a fit with the flexible tracker."""

    legs_apart: float

    def place(self, x: Float64[np.ndarray, " all"], starts: tuple[Any, ...] = ()) -> Place:
        """The loss at x."""
        loss, found = self.prior(x), []
        for part in self.parts:
            sums = compiled_sums()(part.body, part.frames, *self.inputs(x, part), self.legs_apart, self.objective)
            found.append(jax.tree.map(lambda a: np.asarray(a, np.float64), sums))
            loss += self._share() * float(found[-1].cost.sum())
            if self.objective == "held":
                loss += 0.5 * self.height(x, part)[0] ** 2
        if not np.isfinite(loss):
            raise FitError("the search left the range of possible bodies; free fewer parameters (--free)")
        good = tuple(np.ones(len(sums.cost), bool) for sums in found)
        return Place(loss, good, tuple(sums.cost for sums in found), (), tuple(found))

    def weight(self, part: FlexiblePart, there: Bool[np.ndarray, " frame"]) -> float:
        return self._share() * len(there) / there.sum()

    def sums(self, x: Float64[np.ndarray, " all"], part: FlexiblePart, found: Sums) -> Sums:
        return found

    def gain(self, x: np.ndarray, other: np.ndarray, here: Place, there: Place) -> float:
        """Decrease of the loss from x to `other`."""
        return here.loss - there.loss

    def _share(self) -> float:
        return (POINT_SD / self.noise) ** 2 if self.objective == "held" else 1.0


class Watched(NamedTuple):
    """One recording, tracked."""

    name: str
    fixed_frame: str
    observed: Observed
    followed: Followed


# 7 parameters: those of `fit`
def fit_flexible(
    body: Body,
    logs: Sequence[Any],
    settings: Settings,
    options: FitSettings,
    truths: Sequence[Any] = (),
    state: str | os.PathLike[str] | None = None,
    say: Callable[[str, Progress | None], None] | None = None,
) -> Fit:
    """`fit` with the flexible tracker; the same arguments and errors."""
    tell = say or (lambda what, progress: None)
    if options.folds:
        raise FitError("folds fit parameters of the ICP tracker: set tracker to icp, or leave folds out")
    free = parameters(body, options.free, (), options.mirrored)
    if others := [name for name in free.names if not name.startswith(SIZES)]:
        raise FitError(f"the flexible tracker has no {others[0]}: fit it with the ICP tracker (tracker icp)")
    known = [read_truth(t) if isinstance(t, (str, os.PathLike)) else t for t in truths] or [None] * len(logs)
    with ExitStack() as opened:
        seen = [watched(body, log, settings, opened, tell) for log in logs]
        search = search_of(body, seen, settings, options, free, known)
        progress, place = _run_saved_search(search, options, state, tell)
        cov, apart = covariance(search, progress.x, place), spread(search, progress.x, place)
        names = entry_names(search)
        moved = progress.x - search.centre
        stays = weakly_determined(names, moved, np.sqrt(np.diag(cov)), search.sd, apart)
        if stays.any():  # weakly determined sizes are the usual ones, and the others are fitted again
            progress = replace(progress, x=np.where(stays, search.centre, progress.x), done=bool(stays.all()))
            progress, _ = run_search(replace(search, held=stays), progress, progress.step + FEW_MORE)
        tell("judging", progress)
        judged = []
        for one, part, truth in zip(seen, search.parts, known):
            new = search.body(progress.x, part) if progress.x.any() else part.body
            before, after = (_track_again(one, body, settings) for body in (part.body, new))
            judged.append(judged_by(before, after, part.person, truth))
    sizes = is_size(names) & (progress.x != 0)
    usual = search.sd / options.looseness
    verdict = verdict_on(judged, progress.x / usual, sizes, bool(truths), not progress.x.any())
    return fit_of(Found(search, progress, cov, apart, stays), settings, options, judged, verdict)


def watched(
    body: Body, log: Any, settings: Settings, opened: ExitStack, tell: Callable[[str, Progress | None], None]
) -> Watched:
    """Tracks a log; its features stay on disk until `opened` is closed."""
    source, observed = observed_log(body, log, settings, opened, lambda name: tell(f"tracking {name}", None))
    found = followed(body, observed, settings, source.path, source.fixed_frame, source.notes())
    if found.found is None:
        raise FitError(
            f"{Path(source.path).name}: no person was found; look at the log with voodoo-jax replay --picture"
        )
    return Watched(source.path, source.fixed_frame, observed, found)


def observed_log(
    body: Body, log: Any, settings: Settings, opened: ExitStack, tell: Callable[[str], None]
) -> tuple[LogInfo, Observed]:
    """Reads a log as input of the filters; its features stay on disk until `opened` is closed; `tell` gets its name."""
    if isinstance(log, Recording):
        source, frames = source_of(log), iter(log)
    else:
        read = tracker_of(settings).reads(settings.read)
        reader = open_checked(log, read, build_of(body, settings.start.scale), settings.detect)
        source, frames = source_of_log(reader), reader.frames()
    tell(Path(source.path).name)
    observed = observe(frames, source.up, body, settings, source.path)
    opened.callback(observed.close)
    return source, observed


def _track_again(one: Watched, body: Body, settings: Settings):
    """Tracks a recording with a body of known size."""
    known = replace(settings, start=replace(settings.start, scale=float(body.scale)))
    return followed(body, one.observed, known, one.name, one.fixed_frame).tracks


# 6 parameters: those of `fit`
def search_of(
    body: Body, seen: Sequence[Watched], settings: Settings, options: FitSettings, free: Parameters,
    truths: Sequence[Truth | None],
) -> FlexibleSearch:  # fmt: skip
    """Sets up the search: free parameters, priors, and well tracked frames."""
    persons = [0 if options.persons == "one" else k for k in range(len(seen))]
    scale = {
        k: np.median([float(s.followed.tracks.body.scale) for s, p in zip(seen, persons) if p == k]) for k in persons
    }
    parts = tuple(
        FlexiblePart(Path(one.name).name, own, frames_of(one, own, settings, options, truth), person)
        for one, person, truth in zip(seen, persons, truths)
        for own in [scaled(body, float(scale[person]))]
    )
    count, size = len(scale), len(free.names)
    rows = tuple(np.arange(size) + k * size for k in range(count))
    sd = np.tile(free.sd * options.looseness, count)
    centre = np.tile(usual_lengths(body, free), count)
    s = settings.flexible
    objective: Objective = "truth" if any(t is not None for t in truths) else "held"
    return FlexibleSearch(
        free, parts, objective, rows, sd, centre, np.zeros(len(sd), bool), options.noise,
        legs_apart=s.legs_apart - s.legs_cross,
    )  # fmt: skip


def frames_of(
    one: Watched, body: Body, settings: Settings, options: FitSettings, truth: Truth | None
) -> FlexibleFrames:
    """Well tracked frames of a recording, padded to `options.frames`, their points in two halves."""
    tracks, found, first, skin, observed = one.followed
    s = replace(settings.flexible, points=2 * options.points)
    assert found is not None
    row, counts = observed.row, np.zeros(len(tracks.time_ns), int)
    counts[row] = [len(p.points) for p in observed.people]
    at = chosen_frames(tracks, counts, options.frames)
    numbers_of = {int(r): k for k, r in enumerate(row)}
    places = [numbers_of[int(r)] for r in at]
    x = np.asarray(found.x, np.float32)[[k - first for k in places]]
    points, share, bare = (
        np.stack(each) for each in zip(*(chosen_points(observed, k, s, looks(observed, k, s, skin)) for k in places))
    )
    cameras = np.stack([observed.features.place(k) for k in places])
    half = np.arange(s.points) % 2 == 0
    shift = centres_of(body, x.astype(float), float(body.scale), cameras)
    named = {centre: POINTS.index(point) for point, centre in CENTRES.items()}
    shift -= x[:, [named.get(c, 0) for c in body.topology.centres]]
    of_limb = news(tracks, cameras, at, len(at))
    order = [body.topology.limbs.index(n) if n in body.topology.limbs else -1 for n in PART_LIMBS]
    of_part = np.where(np.array(order) < 0, 1.0, of_limb[:, order])
    joints = None if truth is None else truth_at(truth, tracks.time_ns[at].tolist(), body.topology, len(at))
    floor = np.broadcast_to(np.asarray(numbers(s, observed.scene.floor).floor), (len(at), 4))

    def padded(a: np.ndarray) -> Array:
        whole = np.concatenate([a, np.repeat(a[-1:], options.frames - len(a), 0)])
        return jnp.asarray(whole if whole.dtype == bool else whole.astype(np.float32))

    return FlexibleFrames(
        padded(x), padded(points), padded(share * half), padded(share * ~half),
        padded(bare), padded(of_part), None if joints is None else padded(np.nan_to_num(joints)),
        None if joints is None else padded(np.asarray(np.isfinite(joints).all(-1))), padded(np.nan_to_num(shift)),
        padded(floor),
        jnp.asarray(np.arange(options.frames) < len(at), jnp.float32),
    )  # fmt: skip


def _run_saved_search(
    search: FlexibleSearch, options: FitSettings, state: str | os.PathLike[str] | None,
    tell: Callable[[str, Progress | None], None],
) -> tuple[Progress, Place]:  # fmt: skip
    """Runs the search, saved in `state` after each step and resumed from it."""
    rest = [repr(replace(options, iterations=0)).encode(), "\n".join(search.free.names).encode()]
    arrays = [np.asarray(v).tobytes() for p in search.parts for v in jax.tree.leaves((p.body, p.frames))]
    mark = hashlib.sha256(b"".join([*arrays, *rest])).hexdigest()
    progress, step_done = resumed(state, mark, np.zeros(len(search.sd)), tell)
    return run_search(search, progress, options.iterations, step_done)
