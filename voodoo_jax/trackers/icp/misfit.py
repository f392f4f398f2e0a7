"""Misfit of tracked limbs: points beside them that no limb explains, and visible limbs without points. Host side,
NumPy.

Covariances and residuals use points near a limb, and do not show that the limb is on another object, or that an arm was
fitted to points of the chest while the true one is hidden.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from voodoo_jax.geometry.rotations import rotations
from voodoo_jax.model.body import Body, Topology
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.trackers.shared.confidence import EXPLAINED
from voodoo_jax.trackers.shared.leftovers import signed_distance
from voodoo_jax.trackers.shared.runner import FEW_POINTS

# figures are of the log loss of the confidence (experiments/numbers), worse where positive
POINTS = 250  # of a frame, evenly taken; measured: with 167 +0.008 +- 0.006, with 375 -0.001 +- 0.004 (39 logs)
# metres from a limb's surface: farther off no point is its. Measured: 0.17 to 0.375 are alike, without a limit
# +0.025 +- 0.019 (11 logs worse, one better)
AROUND = 0.25
# metres from all limbs that are not joined to a limb: its points there are its own. Of 3, 5 and 7 cm the last tells
# right from wrong best in kinds of logs left out, see experiments/trust. What is so much nearer than a limb's surface
# hides it; through a limb whose axis is so much nearer than what is seen there, the sensor sees: 0.15 gives the same
OWN = 0.07
NOISE = 2.5  # times a sensor's noise: not explained, too; measured: with 3 -0.002 +- 0.001, with 1.7 +0.04 +- 0.02
USUAL = 0.8  # derived: mean distance that a normal error makes, sqrt(2 / pi) of its standard deviation
ALONG = 4  # places along a limb's axis that are looked at; measured: 2, 3 and 6 are alike (0.001)
# metres that a line of sight may pass a limb's surface by: derived, half of the distance of POINTS on the 0.6 m2 of a
# person that a sensor sees
WIDER = 0.025
BATCH = 100  # frames that are looked at at once: any gives the same


def body_distance(
    sizes: Float32[np.ndarray, "limb 5"],
    rotation: Float32[np.ndarray, "limb 4"],
    translation: Float32[np.ndarray, "limb 3"],
    points: Float32[np.ndarray, "point 3"],
    most: float = np.inf,
) -> Float[np.ndarray, " point"]:
    """Distances of points from the surface of the nearest limb, inside or outside, metres; at most `most`.

    **Arguments:** `rotation`, `translation` of the limbs, unit quaternions wxyz and metres; limbs without a pose are
    left out.
    """
    out = np.full(len(points), min(most, 1e3))
    there = np.isfinite(translation).all(-1)
    if not there.any() or not len(points):
        return out
    reach = min(most, 1e3) + float(np.max(sizes))  # a limb is no longer than the longest
    low, high = np.min(translation[there], 0) - reach, np.max(translation[there], 0) + reach
    near = np.flatnonzero(np.all((points > low) & (points < high), 1))
    some = points[near]
    best = out[near]
    for limb in np.flatnonzero(there):
        best = np.minimum(best, np.abs(signed_distance(sizes[limb], _into(rotation[limb], some - translation[limb]))))
    out[near] = best
    return out


def _into(turn: Float32[np.ndarray, "4"], v: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, "point 3"]:
    """Vectors in a limb's frame; `turn` unit quaternion wxyz of the limb."""
    w, axis = turn[0], turn[1:]
    twice = 2 * np.cross(-axis, v)
    return v + w * twice + np.cross(-axis, twice)


class Misfit(NamedTuple):
    """Of each limb in each frame; NaN in frames with few points. Shares are 0 to 1."""

    beside: Float32[np.ndarray, "frame limb"]  # of the points nearest to it, that are not explained
    # metres from its surface, mean of the points nearest to it, beyond what noise makes of it
    distance: Float32[np.ndarray, "frame limb"]
    bare: Float32[np.ndarray, "frame limb"]  # of its length, on which there are none, and nothing hides it
    # of the points that it explains, that no other limb would, but for those joined to it; NaN where there are none
    own: Float32[np.ndarray, "frame limb"]


def misfit(
    body: Body,
    rotation: Float[np.ndarray, "frame limb 4"],
    translation: Float[np.ndarray, "frame limb 3"],
    people: Sequence[BodyObservation],
) -> Misfit:
    """Misfits of limbs and the points of each frame.

    **Arguments:** poses T_fixed_limb of its limbs in the frame of the points, unit quaternions wxyz and metres.
    """
    # the points' own precision: a micrometre, and half of the time
    sizes, translation = np.asarray(body.sizes, np.float32), np.asarray(translation, np.float32)
    joined = _joined(body.topology)
    frames, limbs = translation.shape[:2]
    out = np.full((4, frames, limbs), np.nan, np.float32)
    there = np.all(np.isfinite(translation[:, 0]), axis=1)
    use = np.array([k for k, f in enumerate(people) if there[k] and len(f.points) >= FEW_POINTS], int)
    for at in range(0, len(use), BATCH):
        some = use[at : at + BATCH]
        clouds = [people[k] for k in some]
        out[0, some], out[1, some], out[3, some] = _beside(sizes, joined, rotation[some], translation[some], clouds)
        out[2, some] = _covered(sizes, rotation[some], translation[some], clouds)
    return Misfit(*out)


def _joined(topology: Topology) -> Bool[np.ndarray, "limb limb"]:
    """Which limbs share a joint; each with itself, too."""
    near = np.eye(len(topology.limbs), dtype=bool)
    parents, children = np.array(topology.parents, int), np.array(topology.children, int)
    near[parents, children] = near[children, parents] = True
    return near


def evenly(points: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, "some 3"]:
    """At most POINTS of some points."""
    return points[:: len(points) // POINTS + 1]


def _beside(
    sizes: np.ndarray,
    joined: np.ndarray,
    rotation: np.ndarray,
    translation: np.ndarray,
    clouds: list[BodyObservation],
) -> Float[np.ndarray, "3 frame limb"]:
    """Of the points nearest to each limb, the share that is not explained, and their mean distance, metres; and of
    those that are explained, the share that no other limb would explain."""
    turn = rotations(rotation).inv().as_matrix().astype(np.float32).reshape(*translation.shape, 3)
    some = [evenly(f.points) for f in clouds]
    frame = np.repeat(np.arange(len(clouds)), [len(points) for points in some])
    nearest, limb, other = map(np.concatenate, zip(*map(partial(_nearest, sizes, joined), turn, translation, some)))
    key = frame * len(sizes) + limb
    shape = (len(clouds), len(sizes))
    noise = np.array([f.noise for f in clouds])
    off = np.maximum(EXPLAINED, NOISE * noise)[frame]

    def mean(values: np.ndarray, near: np.ndarray, nothing: float = 0.0) -> np.ndarray:
        count = np.bincount(key[near], minlength=shape[0] * shape[1])
        total = np.bincount(key[near], values[near], shape[0] * shape[1])
        return np.where(count > 0, total / np.maximum(count, 1), nothing).reshape(shape)

    around = nearest < AROUND
    distance = mean(nearest, around) ** 2 - (USUAL * noise[:, None]) ** 2
    own = mean(other > OWN, nearest < off, np.nan)
    return np.stack([mean(nearest > off, around), np.sqrt(np.maximum(distance, 0)), own])


def _nearest(
    size: Float32[np.ndarray, "limb 5"],
    joined: Bool[np.ndarray, "limb limb"],
    turn: Float32[np.ndarray, "limb 3 3"],
    place: Float32[np.ndarray, "limb 3"],
    points: Float32[np.ndarray, "point 3"],
) -> tuple[Float32[np.ndarray, " point"], Int[np.ndarray, " point"], Float32[np.ndarray, " point"]]:
    """Distance of each point from the surface of the nearest limb, metres, the index of this limb, and the distance
    from limbs not `joined` to it; `turn` into the limbs' frames, `place` of these."""
    local = turn @ points.T - np.sum(turn * place[:, None], -1, keepdims=True)  # [limb, 3, point]: fastest so
    off = np.abs(signed_distance(size[:, None], np.moveaxis(local, 1, -1)))
    off[np.isnan(off)] = np.inf  # a limb without a place
    limb = np.argmin(off, 0)
    others = np.min(off, 0, where=~joined[:, limb], initial=np.inf)
    return off[limb, np.arange(len(points))], limb, others


def _covered(
    sizes: np.ndarray, rotation: np.ndarray, translation: np.ndarray, clouds: list[BodyObservation]
) -> Float[np.ndarray, "frame limb"]:
    """Share of each limb's length that is visible without points; by the sensor that sees least of that."""
    share = ((np.arange(ALONG) + 0.5) / ALONG).astype(np.float32)
    axis = rotations(rotation).apply([0.0, 0.0, 1.0]).reshape(translation.shape).astype(np.float32)
    spots = translation[:, :, None] + axis[:, :, None] * (share * sizes[:, 4:])[None, :, :, None]
    radius = np.minimum(sizes[:, :1], sizes[:, 1:2]) * (1 - share) + np.minimum(sizes[:, 2:3], sizes[:, 3:4]) * share
    bare = np.full(translation.shape[:2], np.nan)
    for k, cloud in enumerate(clouds):
        found = [
            _by_sensor(spots[k], radius, evenly(cloud.points[mine]), _before(cloud, sensor), origin)
            for sensor, origin in enumerate(cloud.origins)
            if len(mine := np.flatnonzero(cloud.sensor == sensor)) >= FEW_POINTS
        ]
        if found:
            bare[k] = np.min(found, 0)
    return bare


def _before(cloud: BodyObservation, sensor: int) -> Float32[np.ndarray, "some 3"]:
    """Points between a sensor and the body."""
    if cloud.before is None or cloud.before_sensor is None:
        return np.zeros((0, 3), np.float32)
    return cloud.before[cloud.before_sensor == sensor]


def _by_sensor(
    spots: Float32[np.ndarray, "limb place 3"],
    radius: Float32[np.ndarray, "limb place"],
    points: Float32[np.ndarray, "point 3"],
    before: Float32[np.ndarray, "some 3"],
    origin: Float32[np.ndarray, "3"],
) -> Float[np.ndarray, " limb"]:
    """Share of the limbs' places that are visible without points: hidden neither by other points of the body nor by
    points `before` it."""
    to = spots.reshape(-1, 3) - origin
    away = np.linalg.norm(to, axis=1)
    ray, reach = to / away[:, None], radius.reshape(-1, 1)
    count = len(points)
    p = np.concatenate([points, before]) - origin
    along = ray @ p.T
    aside = np.sum(p * p, 1) - along**2  # squared
    passes = aside < (reach + np.float32(WIDER)) ** 2
    depth = along - away[:, None]
    on = np.any((passes & (depth > -reach - OWN) & (depth < OWN))[:, :count], 1)
    hidden = np.any(passes & (depth <= -reach - OWN), 1)
    return (~on & ~hidden).reshape(radius.shape).mean(1)
