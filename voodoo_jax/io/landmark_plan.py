"""Assigns named features to frames: rays through calibrated cameras and 3D points, in the fixed frame."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int64

from voodoo_jax.geometry import lens
from voodoo_jax.io.calibrations import camera_of, lens_of
from voodoo_jax.io.frame_sync import join, period_of
from voodoo_jax.io.key_points import Sight, order_of, people_of, sights
from voodoo_jax.io.landmark_table import Gathered
from voodoo_jax.io.log_index import Scan
from voodoo_jax.io.point_labels import Parts
from voodoo_jax.io.transforms import HOLD_NS
from voodoo_jax.model.marker_names import net_key_points
from voodoo_jax.records.messages import PAIRS, RAYS
from voodoo_jax.records.recording import Pairs, Rays


@dataclass
class FeaturePlan:
    """Rays and pairs by frame number, their topics, and notes on features left out."""

    rays: dict[int, Rays] = field(default_factory=dict)
    pairs: dict[int, Pairs] = field(default_factory=dict)
    topics: tuple[str, ...] = ()
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class _Placed:
    """Features of one topic in the fixed frame, at most one of a name in each frame."""

    frame: Int64[np.ndarray, " feature"]  # number of the frame
    names: tuple[str, ...]
    weights: Float[np.ndarray, " feature"]
    origins: Float[np.ndarray, "feature 3"]  # of the camera or the coordinate frame, metres
    values: Float[np.ndarray, "feature 3"]  # unit directions, or metres


def plan_features(
    scan: Scan, fixed: str, topics: list[str], times: Int64[np.ndarray, " frame"], weights: Parts, after_ns: int = -1
) -> FeaturePlan:
    """Assigns each feature of the topics to the frame with the nearest stamp (`times`, increasing, nanoseconds), if
    that is after `after_ns`.

    A frame gets one feature for each name and topic: the nearest in time, then the one with the highest score.
    """
    plan = FeaturePlan()
    found: dict[str, list[_Placed]] = {RAYS: [], PAIRS: []}
    used = []
    for name in sorted(topics):
        counted: Counter[str] = Counter()
        placed = _place(scan, fixed, name, times, counted, weights.weight(name), after_ns)
        if isinstance(placed, str):
            plan.notes.append(f"'{name}' is left out: {placed}.")
            continue
        plan.notes += [f"'{name}': {n} {'feature' if n == 1 else 'features'} {what}." for what, n in counted.items()]
        if placed.names:
            used.append(name)
            found[scan.uses[name]].append(placed)
    for i, names, origins, directions, weight in _by_frame(found[RAYS]):
        plan.rays[i] = Rays(names, origins, directions, weight)
    for i, names, _, points, weight in _by_frame(found[PAIRS]):
        plan.pairs[i] = Pairs(names, points, weight)
    plan.topics = tuple(used)
    return plan


def plan_key_points(
    scan: Scan, fixed: str, topics: list[str], times: Int64[np.ndarray, " frame"], weights: Parts
) -> FeaturePlan:
    """Key points of several cameras as named 3D points and the lines of sight to them, for each person; frames as for
    plan_features."""
    plan, frames = FeaturePlan(), {}
    counted: Counter[str] = Counter()
    for camera, name in enumerate(sorted(topics)):
        for i, some in _sights(scan, fixed, name, times, weights.weight(name), counted).items():
            frames.setdefault(i, [[] for _ in topics])[camera] = some
    plan.notes += [f"{n} {'feature' if n == 1 else 'features'} {what}." for what, n in counted.items()]
    plan.pairs, plan.rays = people_of(frames)
    plan.topics = tuple(sorted(topics))
    return plan


# 6 parameters, as _place
def _sights(
    scan: Scan, fixed: str, name: str, times: np.ndarray, weight: float, counted: Counter[str]
) -> dict[int, list[Sight]]:
    """What a camera sees of each person, by frame: of several messages the nearest in time."""
    found = scan.topics[name].gathered
    assert found is not None
    sources, directions = _rays(scan, name, counted)
    nearest, joins = join(times, period_of(times), found.stamps)
    weights = weight * _sure(found)
    order, messages = order_of(found.names, found.stamps), dict[int, int]()
    for i, stamp in dict.fromkeys(zip(nearest[joins].tolist(), found.stamps[joins].tolist())):
        if i not in messages or abs(stamp - times[i]) < abs(messages[i] - times[i]):
            messages[i] = stamp
    kept = np.flatnonzero(joins & np.isfinite(directions).all(axis=1))
    rows: dict[int, list[int]] = {}
    for k in kept.tolist():
        if messages[i := int(nearest[k])] == int(found.stamps[k]):
            rows.setdefault(i, []).append(k)
    out = {}
    for i, some in rows.items():
        pose = scan.tree.lookup(fixed, str(sources[some[0]]), messages[i])
        if pose is not None:
            names = [found.names[k] for k in some]
            out[i] = sights(pose[1], names, directions[some] @ pose[0].T, weights[some], order)
    return out


def _by_frame(parts: list[_Placed]):
    """(frame, names, origins, values, weights) for each frame with features, topics in order; weights None: all 1."""
    if not parts:
        return
    frame = np.concatenate([p.frame for p in parts])
    order = np.argsort(frame, kind="stable")
    names = [name for p in parts for name in p.names]
    origins = np.concatenate([p.origins for p in parts])[order].astype(np.float32)
    values = np.concatenate([p.values for p in parts])[order].astype(np.float32)
    weights = np.concatenate([p.weights for p in parts])[order].astype(np.float32)
    numbers, starts = np.unique(frame[order], return_index=True)
    for i, a, b in zip(numbers.tolist(), starts, [*starts[1:], len(order)]):
        weight = weights[a:b] if (weights != 1).any() else None
        yield i, tuple(names[k] for k in order[a:b]), origins[a:b], values[a:b], weight


# 7 parameters: what there is, and which of it
def _place(
    scan: Scan, fixed: str, name: str, times: np.ndarray, counted: Counter[str], weight: float, after_ns: int
) -> _Placed | str:
    """The features of a topic, or why it cannot be used; counts the messages that are left out."""
    found = scan.topics[name].gathered
    assert found is not None
    sources, values = np.array(found.frames, object), found.values
    if scan.uses[name] == RAYS:
        sources, values = _rays(scan, name, counted)
    known = sorted(set(sources))
    connected = [frame for frame in known if scan.tree.connected(frame, fixed)]
    if not connected:
        return f"no transform between {', '.join(repr(f) for f in known)} and '{fixed}'"
    nearest, joins = join(times, period_of(times), found.stamps)
    if not joins.all():
        counted["left out, with no frame near in time"] += int((~joins).sum())
    kept = np.flatnonzero(joins & np.isfinite(values).all(axis=1) & (times[nearest] > after_ns))
    number = {n: i for i, n in enumerate(dict.fromkeys(found.names))}
    key = nearest[kept] * len(number) + np.array([number[found.names[k]] for k in kept], np.int64)
    # Of equal frame and name the nearest in time comes first, then the surest, then the first read.
    order = np.lexsort((-found.scores[kept], np.abs(times[nearest] - found.stamps)[kept], key))
    _, first = np.unique(key[order], return_index=True)
    kept = np.sort(kept[order[first]])
    origins, turned, there = np.zeros((len(kept), 3)), np.zeros((len(kept), 3)), np.zeros(len(kept), bool)
    groups: dict[tuple[str, int], list[int]] = {}
    for i, k in enumerate(kept.tolist()):
        groups.setdefault((str(sources[k]), int(found.stamps[k])), []).append(i)
    for (frame, stamp), rows in groups.items():
        pose = scan.tree.lookup(fixed, frame, stamp)
        if pose is None:
            why = f"no transform from '{frame}' to '{fixed}' within {HOLD_NS / 1e9:g} s of the stamp"
            counted[f"left out, {why}"] += len(rows)
            continue
        there[rows] = True
        origins[rows] = pose[1]
        turned[rows] = values[kept[rows]] @ pose[0].T + (0.0 if scan.uses[name] == RAYS else pose[1])
    kept = kept[there]
    names, weights = tuple(found.names[k] for k in kept), weight * _sure(found)[kept]
    return _Placed(nearest[kept], names, weights, origins[there], turned[there])


def _sure(found: Gathered) -> np.ndarray:
    """What each feature's score is worth: of a pose net's key points as much as it says, of others 1, for a detector's
    scores have no common scale."""
    scored = (found.scores > 0) & (found.scores <= 1)
    if not scored.any() or not net_key_points(found.names):
        return np.ones(len(found.names))
    return np.where(scored, found.scores, np.where(found.scores > 1, 1.0, 0.0))


def _rays(scan: Scan, name: str, counted: Counter[str]) -> tuple[np.ndarray, np.ndarray]:
    """Frame of the camera and unit direction in it for each 2D feature of a topic; NaN where there is none."""
    found = scan.topics[name].gathered
    assert found is not None
    sources, directions = np.array(found.frames, object), np.full((len(found.names), 3), np.nan)
    for frame in set(found.frames):
        rows = np.flatnonzero(np.array(found.frames, object) == frame)
        c = camera_of(scan.topics, name, frame)
        if c is None:
            counted[f"left out, no calibration for frame '{frame}'"] += len(rows)
            continue
        sources[rows] = frame or c.frame
        x = np.column_stack([lens.undistort(found.values[rows], *lens_of(name, c), c.model), np.ones(len(rows))])
        directions[rows] = x / np.linalg.norm(x, axis=1, keepdims=True)
        if lost := int(np.isnan(x).any(axis=1).sum()):
            counted["left out, where the lens model cannot be inverted"] += lost
    return sources, directions
