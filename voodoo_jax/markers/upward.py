"""Estimates the upward direction of recordings of named points alone: in laboratories y is up as often as z. Host side,
NumPy.

It uses the tracked bodies: a person who stands or walks has the head above the feet, rests on the feet, and moves the
trunk more than the foot on the floor. The direction that the log states is kept unless bodies do not stand along it.
For people who lie, the resting parts and the height of the floor decide, since laboratories have their zero on the
floor.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from voodoo_jax.detect.scene import STEEPEST
from voodoo_jax.io.key_points import SELDOM
from voodoo_jax.records.tracks import Tracks

# STEEPEST, 40 degrees: of a standing person from the feet to the neck, and the largest bend of a straight knee
CLIMB = 1.5  # metres: hips that move farther move along the floor, not upwards; by hand
# between trunk and legs of a person who stands straight: in 12 laboratories they are upright to 4 degrees (measured)
STRAIGHT = np.cos(np.radians(15))
ALONG = np.cos(np.radians(8))  # of the largest angle at which upwards is an axis of the frame; by hand
SPAN = 0.5  # seconds over which rest is tested: noise of markers is small over them; by hand
REST = 0.03  # metres per second: a slower trunk rests; by hand
ANKLE, FLOOR = 0.08, 0.1  # metres above the floor: a standing ankle, a lying person's lowest joint; by hand
PELVIS, SIDES = ("l_hip", "r_hip"), ("l_talocrural", "r_talocrural")


def with_upward(people: Sequence[Tracks], stated: Float[np.ndarray, "3"]) -> list[Tracks]:
    """Tracks of all people in a recording of named points, with the upward direction, and a note if it differs from
    that of the log, `stated`."""
    found = upward(people, stated)
    if found @ stated > ALONG:
        return list(people)
    axis = int(np.abs(found).argmax())
    along = abs(found[axis]) > 0.999
    word = ("-" if found[axis] < 0 else "") + "xyz"[axis] if along else ",".join(f"{x:.2f}" for x in found + 0.0)
    was = ",".join(f"{x:g}" for x in np.round(stated, 2) + 0.0)
    note = f"Up is {word}, not ({was}), judged by standing people; for a lying person set read.up={was}."
    return [replace(one, up=found.astype(np.float32), notes=(*one.notes, note)) for one in people]


def upward(people: Sequence[Tracks], stated: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Upwards in the fixed frame, a unit vector: `stated`, unless people stand along another direction."""
    stated = np.asarray(stated, float)
    ways = [way for one in people if len((way := _way(one)).body)]
    if not ways:
        return stated
    body, straight = np.concatenate([way.body for way in ways]), np.concatenate([way.straight for way in ways])
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    travel = np.max([np.ptp(np.percentile(way.hips, (2, 98), axis=0), axis=0) for way in ways], 0)
    share = np.where(np.tile(travel, 2) < CLIMB, (body @ axes.T > STEEPEST).mean(0), 0.0)
    # of cameras that are tilted no axis is up
    middle = body.mean(0) / max(float(np.linalg.norm(body.mean(0))), 1e-9)
    best = axes[int(share.argmax())] if share.max() > SELDOM else middle
    stand = body @ best > STEEPEST
    if (body @ stated > STEEPEST).mean() > SELDOM or stand.mean() <= SELDOM:
        return stated
    if sum(_lies(one, best, stated) for one in people) > 0:
        return stated
    if (stand & straight).mean() > SELDOM:
        mean = body[stand & straight].mean(0)
        mean /= np.linalg.norm(mean)
        return best if mean @ best > ALONG else mean
    return best


def _at(tracks: Tracks, names: Sequence[str]) -> Float[np.ndarray, "frame 3"] | None:
    """The middle of some joints; None if the body lacks one of them."""
    centres = tracks.body.topology.centres
    if not {*names} <= {*centres}:
        return None
    return np.mean([tracks.joints[:, centres.index(name)] for name in names], 0).astype(float)


class _Way(NamedTuple):
    """A body's posture in the tracked frames."""

    body: Float[np.ndarray, "frame 3"]  # from the ankles over the hips to the neck, unit vectors
    straight: Bool[np.ndarray, " frame"]  # trunk, thighs and shanks are in one line, and shanks were seen
    hips: Float[np.ndarray, "frame 3"]  # metres


def _way(tracks: Tracks) -> _Way:
    t = tracks.body.topology
    found = [_at(tracks, (name,)) for name in ("vc7", *PELVIS, "l_knee", "r_knee", *SIDES)]
    if any(x is None for x in found):
        return _Way(np.zeros((0, 3)), np.zeros(0, bool), np.zeros((0, 3)))
    places = np.stack([x for x in found if x is not None])
    there = tracks.tracked & np.isfinite(places).all((0, 2))
    neck, lh, rh, lk, rk, la, ra = places[:, there]
    unit = lambda x: x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)  # noqa: E731
    hips = (lh + rh) / 2
    trunk, legs = unit(neck - hips), unit(hips - (la + ra) / 2)
    bends = [(trunk, legs), (unit(lh - lk), unit(lk - la)), (unit(rh - rk), unit(rk - ra))]
    shanks = [t.centre_limbs[t.centres.index(name)] for name in SIDES]
    seen = (tracks.evidence.limb_weight[there][:, shanks] > 0).all(1)
    straight = np.all([(a * b).sum(1) > angle for (a, b), angle in zip(bends, (STRAIGHT, STEEPEST, STEEPEST))], 0)
    return _Way(unit(trunk + legs), straight & seen, hips)


def _lies(tracks: Tracks, stands: np.ndarray, lies: np.ndarray) -> float:
    """Logarithm of the odds, by the resting parts and the floor, that a person lies, with another direction up, and
    does not stand along this one."""
    found = [_at(tracks, names) for names in (("vc7",), PELVIS, SIDES[:1], SIDES[1:])]
    if any(x is None for x in found) or not tracks.tracked.any():
        return 0.0
    places = np.stack([x for x in found if x is not None])
    there = tracks.tracked & np.isfinite(places).all((0, 2))
    if not there.any():
        return 0.0
    odds = 0.0
    every = tracks.joints[there].astype(float)
    low = np.median((every @ lies).min(1)) - FLOOR, np.median((places[2:, there] @ stands).min(0)) - ANKLE
    odds += (1.0 if abs(low[0]) < FLOOR else -0.5) + (-2.0 if abs(low[1]) < FLOOR else 0.5)
    seconds = (tracks.time_ns - tracks.time_ns[0]) / 1e9
    after = np.searchsorted(seconds, seconds + SPAN)
    first = np.flatnonzero(after < len(seconds))
    first = first[there[first] & there[after[first]]]
    if len(first):
        span = seconds[after[first]] - seconds[first]
        speed = np.linalg.norm(places[:, after[first]] - places[:, first], axis=2) / span
        trunk, foot = np.median(speed[:2].mean(0)), np.median(speed[2:].min(0))
        if foot < trunk:
            odds -= 2.0 * float(trunk > 2 * foot)
        elif trunk < REST:
            odds += 2.0 * float(foot > 2 * trunk)
    return odds
