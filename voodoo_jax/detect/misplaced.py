"""Sensors that a log places wrongly beside each other: a surface that two of them see is one surface. Host side, NumPy.

Point-to-plane ICP (Chen and Medioni 1992, doi:10.1016/0262-8856(92)90066-C) of one sensor's points onto the surfaces
that the others see at the same time, in several frames at once: one shift and turn for all.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64
from scipy.spatial import KDTree

from voodoo_jax.detect.camera_motion import FASTER, STILL, moved, onto_planes, turned
from voodoo_jax.detect.crops import RIGHT
from voodoo_jax.io.as_shown import TORN, is_told, off_level
from voodoo_jax.io.log_reader import LogReader
from voodoo_jax.records.recording import Frame

# By hand, tried on simulated pairs of cameras; judged on others in experiments/scoreboard/promises/sensors_agree.py
# Frames of a sensor, spread over the log; points of a frame; points around one that show its normal.
FRAMES, POINTS, PATCH = 10, 8000, 12
# By hand, as above: metres from a surface, at most; share of a sensor's upright points on others' surfaces, and points,
# at least; times as many as at first; of the best fit's, those of one as good
REACH, SHARED, FEWEST, BETTER, ALMOST = 0.35, 0.1, 100, 1.2, 0.95
# By hand, as above: degrees and metres from the first fit, at which further ones begin, and how many; steps of each
YAWS, SHIFTS, TRIED, STEPS = (-6.0, -3.0, 0.0, 3.0, 6.0), (-0.15, 0.0, 0.15), 4, 30
# cosine between normals of one surface, or of an upright one and up; of a patch's extent, squared, at most; by hand
FACING, FLAT = 0.8, 0.05
NOISE = 0.015  # metres, of depth at 3 metres (Khoshelham and Elberink 2012, doi:10.3390/s120201437: 0.013)
ON, OFF = 4 * NOISE, 2 * NOISE  # so near one surface ends; less is usual for calibrations, and between halves; by hand
TOGETHER_NS = 50_000_000  # between frames that show the same; by hand


class Surface(NamedTuple):
    """What a sensor sees in one frame."""

    points: Float64[np.ndarray, "point 3"]
    normals: Float64[np.ndarray, "point 3"]  # unit, towards the sensor


def with_sensors_in_place(reader: LogReader) -> LogReader:
    """The reader with misplaced sensors moved to where they fit the others, where one place alone does; else its places
    are doubted. Sensors that move are left alone. Of two that contradict each other the one whose floor is less level
    is moved, and never one that read.transform places."""
    one_each = {reader.frame_name(topic): topic for topic in reversed(reader.sensors)}
    if len(one_each) < 2:
        return reader
    given, coarse = reader.given_frames, reader.coarse(POINTS)
    off = {topic: 0.0 if frame in given else off_level(reader, topic) for frame, topic in one_each.items()}
    first, *others = sorted(off, key=lambda topic: (reader.frame_name(topic) not in given, off[topic], topic))
    known = {frame.time_ns: [_surface(frame)] for frame in _frames(coarse, first, None)}
    for topic in others if known else ():
        pairs = []
        for frame in _frames(coarse, topic, np.array(list(known))):
            nearest = min(known, key=lambda t: abs(t - frame.time_ns))
            if abs(nearest - frame.time_ns) < TOGETHER_NS:
                pairs.append((nearest, _surface(frame)))
        T, sure = correction([(_joined(known[at]), mine) for at, mine in pairs], reader.up)
        away = [_apart(mine.points, T, STILL) for _, mine in pairs if len(mine.points)]
        if away and max(away) > OFF and reader.frame_name(topic) not in given:
            lines = reader.move(topic, T) if sure else ("", "")
            _say(reader, (first, topic), max(away), is_told(off[first], off[topic]), lines)
        else:
            T = STILL
        for at, mine in pairs:
            known[at].append(Surface(moved(mine.points, T), mine.normals @ T[:3, :3].T) if sure else mine)
    return reader


def _say(reader: LogReader, topics: tuple[str, str], away: float, told: bool, lines: tuple[str, str]) -> None:
    """Says that two sensors contradict each other, and what was done; and how far the places are to be believed."""
    (first, topic), (line, before) = topics, lines
    if away > RIGHT and not (line and told):
        reader.sure *= TORN
    found = f"'{topic}' sees what '{first}' sees, too, up to {100 * away:.0f} cm off: one of their transforms is wrong"
    if not line:
        reader.say(f"{found}. By how much is not certain; read.transform settles it.")
        return
    why = "the floor is level with that of the others" if told else "nothing tells which"
    reader.say(
        f'{found} ({why}). It was moved, as --read.transform "{line}" says; --read.transform "{before}" says that the '
        "other one is wrong."
    )


class _Pairs(NamedTuple):
    """What others see, and what one sensor sees at the same time, in several frames."""

    there: tuple[Surface, ...]
    trees: tuple[KDTree, ...]
    mine: tuple[Surface, ...]

    @classmethod
    def of(cls, pairs: list[tuple[Surface, Surface]]) -> "_Pairs":
        there, mine = tuple(one for one, _ in pairs), tuple(other for _, other in pairs)
        return cls(there, tuple(KDTree(one.points) for one in there), mine)

    def part(self, begin: int, step: int) -> "_Pairs":
        """Every so many-th pair."""
        return _Pairs(self.there[begin::step], self.trees[begin::step], self.mine[begin::step])

    def matched(self, T: np.ndarray, reach: float, every: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """The points (of which every so many-th is asked) that have a surface within reach which faces as theirs, its
        normals, how far they are from it, and of how many points they are."""
        points, normals, offs, count = [], [], [], 0
        for there, tree, mine in zip(self.there, self.trees, self.mine):
            asked, facing = moved(mine.points[::every], T), mine.normals[::every] @ T[:3, :3].T
            away, which = tree.query(asked, distance_upper_bound=reach)
            near = np.flatnonzero(np.isfinite(away))
            near = near[np.sum(facing[near] * there.normals[np.asarray(which)[near]], 1) > FACING]
            nearest = np.asarray(which)[near]
            points.append(asked[near])
            normals.append(there.normals[nearest])
            offs.append(np.sum((asked[near] - there.points[nearest]) * there.normals[nearest], 1))
            count += len(asked)
        return np.concatenate(points), np.concatenate(normals), np.concatenate(offs), count

    def shared(self, T: np.ndarray, up: np.ndarray) -> float:
        """The share of the points on upright surfaces that lie on what others see; of level ones each shift shares as
        many."""
        _, normal, off, _ = self.matched(T, ON, 4)
        count = sum(np.sum(np.abs(mine.normals[::4] @ up) < FACING) for mine in self.mine)
        on = np.clip(1 - (off / (2 * NOISE)) ** 2, 0, None) ** 2
        return float(on[np.abs(normal @ up) < FACING].sum() / max(count, 1))

    def fitted(self, T: np.ndarray = STILL, reach: float = REACH) -> np.ndarray:
        """The best fit of the sensor's surfaces to the others', from `T` on."""
        whole, pivot = np.zeros(6), self.middle
        for _ in range(STEPS):
            points, normal, off, _ = self.matched(T, reach)
            if len(off) < FEWEST:
                return T
            size = np.full(len(off), reach)
            x, _, _ = onto_planes(points - pivot, normal, off, np.full(len(off), NOISE), size, whole)
            whole = whole + x
            T = turned(x, pivot) @ T
            if reach <= ON and np.abs(x).max() < 1e-3:
                break
            reach = max(reach * FASTER**0.5, ON)
        return T

    @property
    def middle(self) -> np.ndarray:
        return np.concatenate([mine.points for mine in self.mine]).mean(0)


def correction(
    pairs: list[tuple[Surface, Surface]], up: Float[np.ndarray, "3"]
) -> tuple[Float64[np.ndarray, "4 4"], bool]:
    """What takes the second surfaces onto the first ones, in pairs that are seen at the same time, and whether nothing
    else does so as well. The identity where they lie on each other already, or nothing tells."""
    both = _Pairs.of([(there, mine) for there, mine in pairs if len(there.points) >= FEWEST and len(mine.points)])
    if len(both.mine) < 2:
        return STILL, True
    T, points = both.fitted(), np.concatenate([mine.points for mine in both.mine])[::10]
    if _apart(points, T, STILL) < OFF:
        return STILL, True
    level = np.linalg.svd(up[None].astype(float))[2][1:]
    starts = [
        turned(np.concatenate([np.radians(yaw) * up, a * level[0] + b * level[1]]), both.middle) @ T
        for yaw in YAWS for a in SHIFTS for b in SHIFTS
    ]  # fmt: skip
    best = sorted(starts, key=lambda start: -both.shared(start, up))[:TRIED]
    fits = [T, *(both.fitted(start) for start in best)]
    shares = [both.shared(fit, up) for fit in fits]
    if max(shares) <= max(SHARED, BETTER * both.shared(STILL, up)):
        return T, False  # level surfaces alone are brought together
    found = fits[int(np.argmax(shares))]
    as_good = [fit for fit, share in zip(fits, shares) if share > ALMOST * max(shares)]
    halves = [both.part(k, 2).fitted(found, 2 * ON) for k in (0, 1)]
    return found, all(_apart(points, found, other) < OFF for other in (*as_good, *halves))


def _apart(points: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    """Root mean square distance between where two transforms take points, metres."""
    return float(np.sqrt(np.mean(np.sum((moved(points, one) - moved(points, other)) ** 2, 1))))


def _frames(reader: LogReader, topic: str, at: np.ndarray | None) -> list[Frame]:
    """Some frames of a sensor that stands still, those nearest to some times if any are given."""
    samples = reader.sampled(topic, FRAMES, spread=True, at=at)
    frames = [frame for sample in samples if (frame := reader.frame_of(topic, sample)) is not None]
    if not frames or np.ptp([frame.origins[0] for frame in frames], axis=0).max() > 0.01:
        return []
    return frames


def _surface(frame: Frame) -> Surface:
    """The points of a frame that lie on something smooth, with its normals."""
    points = frame.points.astype(float)
    if len(points) < PATCH:
        return Surface(points[:0], points[:0])
    around = points[KDTree(points).query(points, PATCH)[1]] - points[:, None]
    normals, flat = normals_of(around - around.mean(1, keepdims=True))
    normals *= np.sign(np.sum(normals * (frame.origins[0] - points), 1))[:, None]
    return Surface(points[flat], normals[flat])


def normals_of(patches: Float[np.ndarray, "patch point 3"]) -> tuple[np.ndarray, np.ndarray]:
    """The normal of each patch of points about their middle, and whether it is flat. No LAPACK in batches: where one
    eigenvalue is small, the adjugate of the covariance is the normal's projection, and its largest column the normal.
    """
    C = np.einsum("kpi,kpj->kij", patches, patches)
    rows = C[:, [1, 2, 0]], C[:, [2, 0, 1]]
    adjugate = np.cross(*rows)
    size = np.linalg.norm(adjugate, axis=2)
    best = np.take_along_axis(adjugate, size.argmax(1)[:, None, None], 1)[:, 0]
    normals = best / np.maximum(size.max(1), 1e-30)[:, None]
    least = np.einsum("ki,kij,kj->k", normals, C, normals)
    return normals, least < FLAT * np.trace(C, axis1=1, axis2=2)


def _joined(surfaces: list[Surface]) -> Surface:
    return Surface(*(np.concatenate(parts) for parts in zip(*surfaces)))
