"""Recordings of named 3D points, such as optical markers: tables of them, the person's sizes, the start, and how well
poses explain the points. Host side."""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from voodoo_jax.geometry.rigid import Poses, apply
from voodoo_jax.io.key_points import SELDOM
from voodoo_jax.kernels.landmarks import named_points
from voodoo_jax.markers.first_pose import TO_START as TO_START
from voodoo_jax.markers.label_swaps import Exchange, sides
from voodoo_jax.markers.size_fit import Markers, fit_markers, personal
from voodoo_jax.model.body import Body, scaled
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.stretches import spread
from voodoo_jax.solve.names import FeatureNames

ENOUGH = 4  # named points in a frame to track by
CLOSE = 0.1  # metres: nearer to its place a named point is explained
FRAMES = 24  # of the recording that sizes are fitted to


class MarkerTable(NamedTuple):
    """All named points of a recording, those known to the body first."""

    markers: Markers  # of names that stand for one point of the body
    unknown: Markers  # the other names, all with row 0

    def enough(self, least: int) -> Bool[np.ndarray, " frame"]:
        """Frames with at least this many known points."""
        return self.markers.seen.sum(1) >= least


def without_gaps(frames: list[BodyObservation]) -> list[BodyObservation]:
    """The frames without named points at exactly zero or NaN: marker systems write lost points in this way."""
    out = []
    for frame in frames:
        p = frame.pairs
        keep = np.isfinite(p.points).all(1) & (p.points != 0).any(1)
        if not keep.all():
            frame = replace(frame, pairs=p.only(keep))
        out.append(frame)
    return out


def marker_table(frames: list[BodyObservation], names: FeatureNames) -> MarkerTable:
    """Named points of all frames as arrays."""
    all_names = list(dict.fromkeys(n for f in frames for n in f.pairs.names))
    column = {n: k for k, n in enumerate(all_names)}
    points = np.zeros((len(frames), len(all_names), 3), np.float32)
    seen = np.zeros(points.shape[:2], bool)
    for i, frame in enumerate(frames):
        k = [column[n] for n in frame.pairs.names]
        points[i, k], seen[i, k] = frame.pairs.points, True
    rows = [names.look_up(n) for n in all_names]
    known = np.array([k for k, row in enumerate(rows) if row is not None and len(row) == 1], int)
    other = np.array([k for k, row in enumerate(rows) if row is None], int)
    first = np.array([row[0] if row else 0 for row in rows], np.int64)
    part = lambda k: Markers(tuple(all_names[i] for i in k), first[k], points[:, k], seen[:, k])  # noqa: E731
    return MarkerTable(part(known), part(other))


class Sized(NamedTuple):
    """The body with sizes and marker places from the markers."""

    body: Body
    exchanges: list[Exchange]  # left and right markers that are exchanged throughout
    mirrored: bool  # these are all


def sized_by_markers(body: Body, markers: Markers, scale: float) -> Sized:
    """The body with sizes from the markers; `scale` (metres) if it is known, else 0."""
    body = scaled(body, scale) if scale > 0 else body
    often = markers.seen.mean(0) > SELDOM * markers.seen.any(1).mean()
    if not often.all() and often.sum() >= TO_START:  # what is hardly ever there tells nothing of sizes
        k = np.flatnonzero(often)
        places = tuple(markers.places[i] for i in k) if markers.places else ()
        names = tuple(markers.names[i] for i in k)
        points, seen = markers.points[:, k], markers.seen[:, k]
        markers = Markers(names, markers.rows[k], points, seen, places, markers.newington)
    count = markers.seen.sum(1)
    good = np.flatnonzero(count >= max(TO_START, 0.7 * count.max(initial=0)))
    if not len(good):
        return Sized(body, [], False)
    some = good[spread(len(good), FRAMES)]
    chosen = markers._replace(points=markers.points[some], seen=markers.seen[some])
    t = body.topology
    names = (*t.sites, *t.centres)
    chosen, fit, exchanges, mirrored = sides(
        body, chosen, list(markers.places) or [names[row] for row in markers.rows], scale > 0
    )
    every = np.ones(len(markers.seen), bool)
    return Sized(personal(body, chosen, fit), [e._replace(frames=every) for e in exchanges], mirrored)


def marker_start(body: Body, markers: Markers, at: int) -> Poses:
    """Pose of a body of known sizes in one frame."""
    chosen = markers._replace(points=markers.points[at : at + 1], seen=markers.seen[at : at + 1])
    fit = fit_markers(body, chosen, sizes=False)
    return Poses(jnp.asarray(fit.rotation[0], jnp.float32), jnp.asarray(fit.translation[0], jnp.float32))


def places(body: Body, rows: Int[np.ndarray, " name"], poses: Poses) -> Float[np.ndarray, "frame name 3"]:
    """Positions of named points of the body in each frame of the poses, metres."""
    limbs, points = (np.asarray(x) for x in named_points(body))
    limb = limbs[rows]
    at = Poses(np.asarray(poses.rotation)[:, limb], np.asarray(poses.translation)[:, limb])
    return np.asarray(apply(at, points[rows]))


class Explained(NamedTuple):
    """How well poses explain the named points, per frame."""

    share: Float32[np.ndarray, " frame"]  # of the seen points that are near their place, 0..1; 0: none seen
    residual: Float32[np.ndarray, " frame"]  # root mean square distance of these, metres
    limbs: Float32[np.ndarray, "frame limb"]  # number of these on each limb


def explained(body: Body, markers: Markers, poses: Poses) -> Explained:
    """How well poses explain the named points of the same frames."""
    off = np.linalg.norm(places(body, markers.rows, poses) - markers.points, axis=-1)
    near = markers.seen & (off < CLOSE)
    count = near.sum(1)
    on = np.zeros((len(near), body.limb_count), np.float32)
    for k, limb in enumerate(np.asarray(named_points(body)[0])[markers.rows]):
        on[:, limb] += near[:, k]
    share = count / np.maximum(markers.seen.sum(1), 1)
    residual = np.sqrt(np.where(near, off**2, 0).sum(1) / np.maximum(count, 1))
    return Explained(share.astype(np.float32), residual.astype(np.float32), on)
