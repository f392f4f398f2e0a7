"""A recording prepared for gradients, and its solution by named parameters: `vj.problem`, `vj.solved`."""

import os
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.frames import Truth, feature_names, fit_frames, placed_by, read_truth
from voodoo_jax.fitting.objective import FitFrames, changed_features
from voodoo_jax.fitting.parameters import changed, changed_points, changed_tracking, middles, named_changes
from voodoo_jax.fitting.seen import Log, Seen, tracked
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import Body
from voodoo_jax.solve.scan import TrackOptions, at_rest, options_from
from voodoo_jax.solve.through_time import Measurements, Tracked, track_through

# parameters: a number for each name, such as lengths.thigh (see solved)
Named = Mapping[str, Float[ArrayLike, ""]]


class Problem(eqx.Module):
    """A tracked recording, padded, with all inputs of its poses. All fields are arrays: problems of equal shapes can be
    stacked and mapped over."""

    body: Body  # in the size that the tracker found
    options: TrackOptions
    frames: FitFrames  # measurements for the poses, others that judge them, and the truth
    seconds: Float[Array, " frame"]  # since the previous frame; 0 for the first one
    places: Float[Array, "frame centre 3"]  # offsets of the tracker's joints from the body's own centres, metres
    features: tuple[str, ...] = eqx.field(static=True)  # features with named weights

    def measured(self) -> Measurements:
        """The measurements for the poses."""
        frames = self.frames
        return Measurements(frames.points, self.seconds, frames.weight > 0, frames.features)

    def having(self, parameters: Named | Body) -> "Problem":
        """The problem with parameters applied: `solved({}, problem.having(p))` equals `solved(p, problem)`, and a loss
        of `problem.having(p)` uses the parameters that were solved with. Raises ValueError as `solved` does."""
        if isinstance(parameters, Body):
            return replace(self, body=parameters)
        by = named_changes(self.body, parameters, self.features, self.frames.points.origins.shape[-2])
        about = middles(self.frames.points)
        seen = [changed_points(points, by, about) for points in (self.frames.points, self.frames.held)]
        frames = replace(self.frames, points=seen[0], held=seen[1], features=changed_features(self.frames, by))
        return replace(self, body=changed(self.body, by), options=changed_tracking(self.options, by), frames=frames)


# 8 parameters: the recording, its tracking, and the selection of frames
def problem(
    body: Body,
    recording: Log | Seen,
    settings: Settings | None = None,
    *,
    truth: Truth | str | os.PathLike[str] | None = None,
    first: int = 0,
    frames: int = 0,
    points: int = 256,
    room: int = 0,
) -> Problem:
    """Prepares a recording for `solved`: tracks it once like `track`, which finds the body's points, its start and its
    size. These are then fixed; everything after them is differentiable.

    **Arguments:** `recording` a path or a Recording; `truth` known joint centres (an .npz with time_ns, joints and
    joint_names), for `loss.joints`; `first` and `frames` the part to solve, in tracked frames (0: to the end);
    `points` most points of a frame for its pose, and as many others that judge; `room` frames to pad to, so that
    several recordings have the same shape.

    Raises LogError, TruthError, and ValueError if no person is tracked.
    """
    settings = settings or Settings()
    seen = recording if isinstance(recording, Seen) else tracked(body, [recording], settings)[0]
    tracks, people = seen.tracks, list(seen.people)
    there = np.flatnonzero(tracks.tracked)
    if len(there) <= first:
        raise ValueError(f"{tracks.source}: {len(there)} frames are tracked, so first={first} is too large")
    at = np.arange(there[first], there[-1] + 1)[: frames or None]
    count = max(room, len(at))
    known = read_truth(truth) if isinstance(truth, (str, os.PathLike)) else truth
    names = feature_names(people, tracks.body.topology, settings.features)
    placed = np.zeros((count, len(tracks.body.topology.centres), 3), np.float32)
    placed[: len(at)] = np.nan_to_num(placed_by(tracks, at))
    found = fit_frames(_fill_poses(tracks), people, at, settings.features, names, count, points, known)
    seconds = np.zeros(count, np.float32)
    seconds[1 : len(at)] = np.diff([people[i].time_ns for i in at]) / 1e9
    options = options_from(settings.solve, settings.track, settings.features)
    known_there = jnp.asarray(seconds), jnp.asarray(placed)
    return Problem(tracks.body, options, found, *known_there, names)


def _fill_poses(tracks):
    """Tracks with missing poses filled from the previous frame; they serve only as starts."""
    lost = ~(np.isfinite(tracks.rotation).all((1, 2)) & np.isfinite(tracks.translation).all((1, 2)))
    if not lost.any():
        return tracks
    last = np.maximum.accumulate(np.where(lost, 0, np.arange(len(lost))))
    return replace(tracks, rotation=tracks.rotation[last], translation=tracks.translation[last])


def solved(parameters: Named | Body, problem: Problem) -> Tracked:
    """Poses and joints of all frames for some parameters: a pure function of arrays, from the first frame to the last,
    with derivatives in forward and in reverse mode; it can be mapped over parameters and problems (`jax.vmap`).

    **Arguments:** `parameters` a body, or numbers by name, where 0 is no change: logarithms of factors of
    `lengths.thigh`, `radii.chest.top`, `bands.knee.weight`, `solve.ratio`, `track.damping`, `features.face.weight`,
    `sensors.0.weight` and so on, shares of the body's scale for `anchors.hip.y`, metres and radians for `sensors.0.x`
    and `sensors.0.turn_z` (about the centre of its points; its place: `problem.having(parameters).frames.points.
    origins`). A name without a side sets both sides.

    **Returns:** see Tracked: `joints` [frame, centre, 3], metres; `converged`: derivatives of other frames are wrong;
    `changing`: number of points between two limbs or two sides, where derivatives hold on one side only. Never NaN.

    Raises ValueError for a name that the body does not have.
    """
    return _compile()(parameters, problem)


@cache
def _compile():
    """The compiled function: without compiling it takes a minute."""

    def solve(parameters: Named | Body, problem: Problem) -> Tracked:
        one = problem.having(parameters)
        start = at_rest(Poses(one.frames.poses.rotation[0], one.frames.poses.translation[0]))
        found = track_through(one.body, one.options, start, one.measured())
        return replace(found, joints=found.joints + one.places)

    return jax.jit(solve)
