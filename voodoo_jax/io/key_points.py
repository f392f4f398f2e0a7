"""Triangulates key points of several calibrated cameras to named 3D points, and associates them with people.

Lines of sight alone cannot start a body, since its distance is unknown. Detections of one message are split into people
by their names, which repeat for each person. People in several cameras are associated if their lines of sight meet;
associations of the previous frame are tried first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int64

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.records.recording import Pairs, Rays, joined_rays

MEET = 0.15  # metres between lines of sight to a point of one person, in the median, at most; by hand
CLOSE = 0.08  # metres of a line of sight from the point that the others give: one farther off is wrong; by hand
APART = 0.998  # cosine between lines of sight: more parallel ones determine no point; by hand
LEAST = 6  # points of a person that two cameras have to see; by hand
SELDOM = 0.1  # of the frames with people, or with markers: what is there in fewer does not count; by hand


@dataclass(frozen=True)
class Sight:
    """Detections of one person by one camera at one time."""

    origin: Float[np.ndarray, "3"]
    names: tuple[str, ...]
    directions: Float[np.ndarray, "name 3"]  # unit vectors
    weights: Float[np.ndarray, " name"]


@dataclass
class _Person:
    """A person from their appearance until they leave."""

    points: dict[str, np.ndarray]  # where they were last
    last: int  # frame in which they were
    frames: dict[int, tuple[dict[str, np.ndarray], list[Sight]]] = field(default_factory=dict)


def order_of(names: Sequence[str], stamps: Int64[np.ndarray, " name"]) -> tuple[str, ...]:
    """The order of names in a camera's detections of a person: the longest beginning of a message without repeated
    names, and then the others."""
    starts = [0, *(np.flatnonzero(np.diff(stamps)) + 1).tolist(), len(names)]
    best: list[str] = []
    for a, b in zip(starts, starts[1:]):
        own = list(names[a:b])
        run = next((own[:k] for k in range(1, len(own)) if own[k] in own[:k]), own)
        best = max(best, run, key=len)
    return tuple(dict.fromkeys([*best, *names]))


# 5 parameters: what a camera sees at one time
def sights(
    origin: np.ndarray, names: Sequence[str], directions: np.ndarray, weights: np.ndarray, order: Sequence[str]
) -> list[Sight]:
    """The detections of a message in their order, split into people: names come in one `order`, once for each
    person."""
    place = {name: k for k, name in enumerate(order)}
    at = [place[name] for name in names]
    cuts = [0, *(k for k in range(1, len(at)) if at[k] <= at[k - 1]), len(at)]
    return [
        Sight(origin, tuple(names[a:b]), directions[a:b], weights[a:b]) for a, b in zip(cuts, cuts[1:]) if b - a > 1
    ]


def people_of(frames: dict[int, list[list[Sight]]]) -> tuple[dict[int, Pairs], dict[int, Rays]]:
    """Named 3D points and the lines of sight to them, by frame, from the sights [camera][person]; for several people
    names begin with `person<k>:`, in order of the time in view."""
    people: list[_Person] = []
    for i in sorted(frames):
        _take(people, i, [list(seen) for seen in frames[i]])
    seen = len({i for one in people for i in one.frames})
    people = [one for one in people if len(one.frames) >= max(2, SELDOM * seen)]
    people.sort(key=lambda one: -len(one.frames))
    pairs: dict[int, list[Pairs]] = {}
    rays: dict[int, list[Rays]] = {}
    for number, one in enumerate(people, 1):
        prefix = f"person{number}:" if len(people) > 1 else ""
        for i, (points, looks) in one.frames.items():
            names = tuple(prefix + name for name in points)
            pairs.setdefault(i, []).append(Pairs(names, np.array(list(points.values()), np.float32), None))
            rays.setdefault(i, []).append(_rays(prefix, points, looks))
    joined = {
        i: Pairs(tuple(n for p in some for n in p.names), np.concatenate([p.points for p in some]), None)
        for i, some in pairs.items()
    }
    return joined, {i: joined_rays(some) for i, some in rays.items()}


def _take(people: list[_Person], i: int, left: list[list[Sight]]) -> None:
    """Gives what the cameras see in a frame to people who are known, and makes new ones of the rest."""
    for one in sorted((p for p in people if i - p.last <= DetectSettings.forget), key=lambda p: -len(p.frames)):
        chosen: list[tuple[int, Sight]] = []
        for camera, seen in enumerate(left):
            costs = [_off(sight, one.points) for sight in seen]
            if costs and min(costs) < MEET + 0.02 * (i - one.last):
                chosen.append((camera, seen[int(np.argmin(costs))]))
        _settle(one, i, chosen, left)
    while (best := _best_pair(left)) is not None:
        (a, one), (b, other) = best
        points = triangulated([one, other])
        chosen = [(a, one), (b, other)]
        for camera, seen in enumerate(left):
            if camera in (a, b) or not seen:
                continue
            costs = [_off(sight, points) for sight in seen]
            if min(costs) < MEET:
                chosen.append((camera, seen[int(np.argmin(costs))]))
        found = _Person(points, i)
        if not _settle(found, i, chosen, left):
            for camera, sight in chosen[:2]:
                _remove(left, camera, sight)
            continue
        people.append(found)


def _settle(one: _Person, i: int, chosen: list[tuple[int, Sight]], left: list[list[Sight]]) -> bool:
    """A person's points in a frame from the views of the cameras, if there are enough."""
    points = triangulated([sight for _, sight in chosen]) if len(chosen) > 1 else {}
    shared = [name for name in points if name in one.points]
    if len(points) < LEAST or not shared:
        return False
    if np.median([np.linalg.norm(points[n] - one.points[n]) for n in shared]) > DetectSettings.move:
        return False
    one.points, one.last = {**one.points, **points}, i
    one.frames[i] = points, [sight for _, sight in chosen]
    for camera, sight in chosen:
        _remove(left, camera, sight)
    return True


def _remove(left: list[list[Sight]], camera: int, sight: Sight) -> None:
    left[camera] = [other for other in left[camera] if other is not sight]


def _off(sight: Sight, points: dict[str, np.ndarray]) -> float:
    """Median distance of lines of sight from a person's points, metres; infinite if hardly any is known."""
    known = [k for k, name in enumerate(sight.names) if name in points]
    if len(known) < LEAST:
        return np.inf
    away = np.array([points[sight.names[k]] for k in known]) - sight.origin
    along = (away * sight.directions[known]).sum(1, keepdims=True)
    return float(np.median(np.linalg.norm(away - along * sight.directions[known], axis=1)))


def _best_pair(left: list[list[Sight]]) -> tuple[tuple[int, Sight], tuple[int, Sight]] | None:
    """The two detections of two cameras that are most likely the same person; None if there are none."""
    found = []
    for a, b in combinations(range(len(left)), 2):
        for one in left[a]:
            for other in left[b]:
                if (cost := _gap(one, other)) < MEET:
                    found.append((cost, (a, one), (b, other)))
    return min(found, key=lambda each: each[0])[1:] if found else None


def _gap(one: Sight, other: Sight) -> float:
    """Distance of the lines of sight to points of one name, in the median, metres."""
    shared = [name for name in one.names if name in other.names]
    if len(shared) < LEAST:
        return np.inf
    d = one.directions[[one.names.index(n) for n in shared]], other.directions[[other.names.index(n) for n in shared]]
    across = np.cross(*d)
    length = np.linalg.norm(across, axis=1)
    use = length > 0.05
    if use.sum() < LEAST:
        return np.inf
    return float(np.median(np.abs(across[use] @ (other.origin - one.origin)) / length[use]))


def triangulated(looks: Sequence[Sight]) -> dict[str, np.ndarray]:
    """Points on which at least two lines of sight agree, metres, without outliers."""
    by_name: dict[str, list[tuple[np.ndarray, np.ndarray, float]]] = {}
    for sight in looks:
        for name, direction, weight in zip(sight.names, sight.directions, sight.weights):
            if weight > 0:
                by_name.setdefault(name, []).append((sight.origin, direction, float(weight)))
    found = {}
    for name, lines in by_name.items():
        origins, directions, weights = (np.array(each) for each in zip(*lines))
        point = _point(origins, directions, weights)
        if point is not None:
            found[name] = point
    return found


def _point(origins: np.ndarray, directions: np.ndarray, weights: np.ndarray) -> np.ndarray | None:
    best, support = None, 0.0
    for a, b in combinations(range(len(origins)), 2):
        if abs(directions[a] @ directions[b]) > APART:
            continue
        pair = [a, b]
        point = _nearest(origins[pair], directions[pair], weights[pair])
        near = _distance(origins, directions, point) < CLOSE
        if near[pair].all() and (total := float(weights[near].sum())) > support:
            best, support = near, total
    return None if best is None else _nearest(origins[best], directions[best], weights[best])


def _nearest(origins: np.ndarray, directions: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The point nearest to some lines in weighted least squares."""
    across = weights[:, None, None] * (np.eye(3) - directions[:, :, None] * directions[:, None])
    return np.linalg.solve(across.sum(0), np.einsum("kij,kj->i", across, origins))


def _distance(origins: np.ndarray, directions: np.ndarray, point: np.ndarray) -> np.ndarray:
    away = point - origins
    along = (away * directions).sum(1, keepdims=True)
    return np.where(along[:, 0] > 0, np.linalg.norm(away - along * directions, axis=1), np.inf)


def _rays(prefix: str, points: dict[str, np.ndarray], looks: list[Sight]) -> Rays:
    """The lines of sight that agree with a person's points."""
    names, origins, directions, weights = [], [], [], []
    for sight in looks:
        for name, direction, weight in zip(sight.names, sight.directions, sight.weights):
            if name in points and _distance(sight.origin[None], direction[None], points[name])[0] < CLOSE:
                names.append(prefix + name)
                origins.append(sight.origin)
                directions.append(direction)
                weights.append(weight)
    return Rays(
        tuple(names), np.array(origins, np.float32).reshape(-1, 3), np.array(directions, np.float32).reshape(-1, 3),
        np.array(weights, np.float32),
    )  # fmt: skip
