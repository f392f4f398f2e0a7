"""Which way is up where nothing but named points was recorded: laboratories have y up as often as z. Host side, NumPy.

The bodies that were tracked tell it: who stands or walks has the head over the feet, rests on these, and moves the
trunk more than the foot that stands. What the log says is doubted only where bodies do not stand along it, and who lies
stays lying: that is told by what rests, and by where the floor is, for laboratories have their zero on it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from voodoo_jax.records.tracks import Tracks

UPRIGHT = np.cos(np.radians(40))  # of the way from the feet to the neck: nearer to upwards somebody stands; by hand
SELDOM, OFTEN = 0.1, 0.3  # of the frames: who stands in so many does stand, and the other way is asked for; by hand
STRAIGHT = np.cos(np.radians(15))  # between trunk and legs: straight ones are upright to a few degrees; by hand
ALONG = np.cos(np.radians(10))  # so near to an axis of the frame upwards is that axis; by hand
SPAN = 0.5  # seconds over which it is looked at who rests: noise of markers is little over them; by hand
REST = 0.03  # metres per second: a trunk that is slower rests; by hand
ANKLE, FLOOR = 0.08, 0.1  # metres above the floor, of who stands and of the lowest joint of who lies; by hand
LIES = -1.0  # logarithm of the odds that somebody is recorded lying while the log says nothing wrong; by hand
PELVIS, SIDES = ("l_hip", "r_hip"), ("l_talocrural", "r_talocrural")


def with_upward(people: Sequence[Tracks], told: Float[np.ndarray, "3"]) -> list[Tracks]:
    """Tracks of everybody in a recording of named points with the way that is up, with a note where it is not that of
    the log, `told`."""
    found = upward(people, told)
    if found @ told > ALONG:
        return list(people)
    axis = int(np.abs(found).argmax())
    along = abs(found[axis]) > 0.999
    word = ("-" if found[axis] < 0 else "") + "xyz"[axis] if along else ",".join(f"{x:.2f}" for x in found + 0.0)
    was = ",".join(f"{x:g}" for x in np.round(told, 2) + 0.0)
    note = f"By who stands on their feet, up is {word}, not ({was}); if somebody lies there, read.up={was} says so."
    return [replace(one, up=found.astype(np.float32), notes=(*one.notes, note)) for one in people]


def upward(people: Sequence[Tracks], told: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Upwards in the fixed frame, a unit vector: `told`, unless people stand another way."""
    told = np.asarray(told, float)
    ways = [_ways(one) for one in people]
    trunk, legs = (np.concatenate([way[k] for way in ways]) for k in (0, 1)) if ways else (np.zeros((0, 3)),) * 2
    if not len(trunk):
        return told
    body = trunk + legs
    body /= np.maximum(np.linalg.norm(body, axis=1, keepdims=True), 1e-9)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    share = (body @ axes.T > UPRIGHT).mean(0)
    # of cameras that are tilted no axis is up
    middle = body.mean(0) / max(float(np.linalg.norm(body.mean(0))), 1e-9)
    best = axes[int(share.argmax())] if share.max() > OFTEN else middle
    stand = body @ best > UPRIGHT
    if (body @ told > UPRIGHT).mean() > SELDOM or stand.mean() <= OFTEN:
        return told
    if sum(_lies(one, best, told) for one in people) + LIES > 0:
        return told
    straight = stand & ((trunk * legs).sum(1) > STRAIGHT)
    if straight.mean() > SELDOM:
        mean = body[straight].mean(0)
        mean /= np.linalg.norm(mean)
        return best if mean @ best > ALONG else mean
    return best


def _at(tracks: Tracks, names: Sequence[str]) -> Float[np.ndarray, "frame 3"] | None:
    """The middle of some joints; None of a body that has not all of them."""
    centres = tracks.body.topology.centres
    if not {*names} <= {*centres}:
        return None
    return np.mean([tracks.joints[:, centres.index(name)] for name in names], 0).astype(float)


def _ways(tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """From the hips to the neck, and from the ankles to the hips, unit vectors, in the tracked frames."""
    neck, hips, ankles = (_at(tracks, names) for names in (("vc7",), PELVIS, SIDES))
    if neck is None or hips is None or ankles is None:
        return np.zeros((0, 3)), np.zeros((0, 3))
    found = np.stack([neck - hips, hips - ankles])[:, tracks.tracked]
    found = found[:, np.isfinite(found).all((0, 2))]
    found = found / np.maximum(np.linalg.norm(found, axis=2, keepdims=True), 1e-9)
    return found[0], found[1]


def _lies(tracks: Tracks, stands: np.ndarray, lies: np.ndarray) -> float:
    """Logarithm of the odds, by what rests and by the floor, that somebody does not stand along one direction but lies
    with another one up."""
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
