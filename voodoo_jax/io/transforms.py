"""Coordinate frames of a log: a tree of rigid transforms over time, looked up at the stamp of a measurement."""

from array import array
from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64
from scipy.spatial.transform import Rotation, Slerp

from voodoo_jax.config.limited import PLACE, QUATERNION, TIME, limits

# of a frame with several poses: jumps that tell it, how far (metres, with so many for a radian), how near to
# where it was before (of the jump), and how many poses at most; by hand
FEWEST, JUMP, LEVER, SAME, MOST = 8, 0.03, 1.0, 0.25, 4
HOLD_NS = 500_000_000  # a moving transform is believed for this long before its first and after its last sample


@dataclass(frozen=True)
class Transform:
    """`parent_T_child` at one time: a point p of the child frame is rotation * p + translation in the parent frame."""

    stamp_ns: int
    parent: str
    child: str
    translation: Float[np.ndarray, "3"]  # metres
    rotation: Float[np.ndarray, "4"]  # quaternion x, y, z, w; any length but 0


class Moving:
    """Samples of one frame as they come from a log, in 80 bytes each: an object for each would be six times that."""

    def __init__(self):
        self._stamps, self._log_times = array("q"), array("q")  # nanoseconds
        self.numbers = array("d")  # translation and rotation of each
        self.names: dict[str, int] = {}  # of parents
        self.parents = array("i")  # number of its parent

    def add(self, transform: Transform, log_time_ns: int) -> None:
        """Adds a sample with a valid stamp and log time (limits.TIME)."""
        self._stamps.append(transform.stamp_ns)
        self._log_times.append(log_time_ns)
        self.numbers.extend(transform.translation)
        self.numbers.extend(transform.rotation)
        self.parents.append(self.names.setdefault(transform.parent, len(self.names)))

    @property
    def stamps_ns(self) -> Int64[np.ndarray, " sample"]:
        return np.array(self._stamps, np.int64)

    @property
    def log_times_ns(self) -> Int64[np.ndarray, " sample"]:
        return np.array(self._log_times, np.int64)


class _Samples(NamedTuple):
    """Samples of one frame in another one."""

    stamps: Int64[np.ndarray, " sample"]  # nanoseconds
    numbers: Float[np.ndarray, "sample 7"]  # translation, metres, and quaternion x, y, z, w


@dataclass(frozen=True)
class _Edge:
    parent: str
    stamps: Int64[np.ndarray, " moving"]  # empty for a transform that never changes
    translations: Float[np.ndarray, "sample 3"]
    rotations: Rotation

    def away(self, other: "_Edge") -> float:
        """How far its pose is from a static one, metres with LEVER for a turn; the median of its samples."""
        q = other.rotations.as_quat()[:1]
        return float(np.median(_away(self.translations, self.rotations.as_quat(), other.translations[:1], q)))

    def at(self, stamp_ns: int, hold_ns: int | None) -> tuple[np.ndarray, np.ndarray] | None:
        times = self.stamps
        if len(times) == 0:
            return self.rotations[0].as_matrix(), self.translations[0]
        if hold_ns is not None and not times[0] - hold_ns <= stamp_ns <= times[-1] + hold_ns:
            return None
        i = int(np.searchsorted(times, stamp_ns))
        if i == 0 or i == len(times) or times[i] == stamp_ns:
            i = min(i, len(times) - 1)
            return self.rotations[i].as_matrix(), self.translations[i]
        f = (stamp_ns - int(times[i - 1])) / int(times[i] - times[i - 1])
        translation = (1 - f) * self.translations[i - 1] + f * self.translations[i]
        return Slerp([0.0, 1.0], self.rotations[i - 1 : i + 1])(f).as_matrix(), translation


class TransformTree:
    """All transforms of a log. Use `add`, then `close`, then `lookup`. `notes` list oddities."""

    def __init__(self):
        self._samples: dict[tuple[str, str], list[_Samples]] = {}  # (child, parent), of those that move
        self._static: dict[tuple[str, str], list[_Edge]] = {}  # all different ones, the last one first
        self._given: dict[str, str] = {}  # parent, by child, of what a user gives
        self._edges: dict[str, _Edge] = {}
        self._cache: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]] = {}
        self._odd: Counter[str] = Counter()
        self._unused: dict[str, str] = {}  # frames that the log places, too, and where they are given
        self._near = "", np.zeros(3)  # the frame that is given from another origin, and where that is in it
        self.torn: dict[str, tuple[_Edge, ...]] = {}  # frames with contradicting poses or parents: all of them
        self.notes: list[str] = []

    def choose(self, child: str, which: int) -> str:
        """Selects one of the poses of a frame that has several; returns its read.transform text."""
        edge = self._edges[child] = self.torn[child][which]
        self._cache.clear()
        return self.said(child, len(edge.stamps) // 2)

    def said(self, child: str, sample: int = 0) -> str:
        """The read.transform text of a frame's pose in its parent; empty without a parent."""
        edge = self._edges.get(child)
        if edge is None:
            return ""
        numbers = (*edge.translations[sample], *edge.rotations[sample].as_quat())
        return f"{edge.parent} {child} {' '.join(f'{x:.5g}' for x in numbers)}"

    def move(self, child: str, target: str, T: Float[np.ndarray, "4 4"]) -> bool:
        """Moves a frame that is static in its parent by `T`, in `target` as `lookup` gives it. Returns whether this was
        possible."""
        edge = self._edges.get(child)
        if edge is None or len(edge.stamps):
            return False
        there, above = (self.lookup(target, frame, 0, hold_ns=None) for frame in (child, edge.parent))
        if there is None or above is None:
            return False
        rotation = Rotation.from_matrix((above[0].T @ T[:3, :3] @ there[0])[None])
        translation = above[0].T @ (T[:3, :3] @ there[1] + T[:3, 3] - above[1])
        self._edges[child] = _Edge(edge.parent, edge.stamps, translation[None], rotation)
        self._cache.clear()
        return True

    def add(self, transform: Transform, static: bool) -> None:
        """Adds one sample. A static transform holds for the whole log; the last one counts."""
        possible = abs(transform.stamp_ns) < TIME
        stamps = np.array([transform.stamp_ns if possible else TIME], np.int64)
        numbers = np.concatenate([transform.translation, transform.rotation])[None].astype(float)
        self._add(transform.child, transform.parent, _Samples(stamps, numbers), static)

    def give(self, transform: Transform) -> None:
        """Adds a transform from the user, which overrides the log's for the whole log."""
        if self._given.pop(transform.child, None) is not None:  # one that was given before
            self._static = {key: ways for key, ways in self._static.items() if key[0] != transform.child}
        self.add(transform, True)
        self._given[transform.child] = transform.parent

    def add_moving(self, child: str, moving: Moving, by_ns: Int64[np.ndarray, " sample"]) -> None:
        """Adds all samples of a moving frame, delayed by a time."""
        samples = _Samples(moving.stamps_ns + by_ns, np.array(moving.numbers).reshape(-1, 7))
        parents = np.array(moving.parents, np.int64)
        for number, parent in enumerate(moving.names):
            mine = parents == number
            self._add(child, parent, _Samples(samples.stamps[mine], samples.numbers[mine]), False)

    def _add(self, child: str, parent: str, given: "_Samples", static: bool) -> None:
        there = plausible(given.numbers[:, :3], given.numbers[:, 3:]) & (np.abs(given.stamps) < TIME)
        samples, count = _Samples(given.stamps[there], given.numbers[there]), int(there.sum())
        if count < len(there):
            self._odd["transforms without finite and possible numbers were left out"] += len(there) - count
        if not count:
            return
        if child in self._given:
            self._unused[child] = self._given[child]
            return
        if not child or child == parent:
            self._odd["transforms without a child frame were left out"] += count
            return
        if zeros := int((samples.numbers[:, 3:] == 0).all(1).sum()):
            self._odd["transforms have a rotation of all zeros, treated as no rotation"] += zeros
        key = (child, parent)
        if key not in self._samples and len(self._samples) >= limits().names:
            self._odd[f"transforms beyond those of {limits().names} frames were left out (--limits.names)"] += count
            return
        own = self._samples.setdefault(key, [])
        if not static:
            own.append(samples)
            return
        way, ways = _edge(parent, samples.stamps[:0], samples.numbers), self._static.setdefault(key, [])
        away = [way.away(other) for other in ways]
        if away and away[0] > 1e-9:
            self._odd["times a static transform changed; its last value is used for the whole log"] += 1
        if len(ways) > MOST:  # it moves
            ways[0] = way
        else:
            ways[:] = [way, *(other for other, off in zip(ways, away) if off > JUMP)]

    def close(self) -> None:
        """Sorts the samples, finds the poses of each frame, and selects the first one."""
        ways: dict[str, list[_Edge]] = {}
        for (child, parent), samples in self._samples.items():
            found = self._static.get((child, parent), [])
            found = found[:1] if len(found) > MOST else found
            if samples:
                found = found + [way for way in _moving(parent, samples) if not found or way.away(found[0]) > JUMP]
            ways.setdefault(child, []).extend(found)
        self._edges = {child: found[0] for child, found in ways.items()}
        self.torn = {child: tuple(found) for child, found in ways.items() if len(found) > 1}
        for child, parent in self._unused.items():
            self.notes.append(f"Frame '{child}' has the pose in '{parent}' of read.transform, not of the log.")
        self.notes += [f"{n} {what}." for what, n in self._odd.items()]
        self._samples.clear()

    def give_from(self, frame: str, origin: Float[np.ndarray, "3"]) -> None:
        """Sets another origin, metres, for positions in `frame`, near which float32 is accurate."""
        self._near = frame, origin
        self._cache.clear()

    def moving_between(self, a: str, b: str) -> set[str]:
        """Frames on the way between two that move in their parents."""
        way = set(self.way(a)) ^ set(self.way(b))
        return {frame for frame in way if frame in self._edges and len(self._edges[frame].stamps)}

    @property
    def known_until(self) -> dict[str, int]:
        """Stamp of the last sample of each frame that moves, nanoseconds."""
        return {child: int(edge.stamps[-1]) for child, edge in self._edges.items() if len(edge.stamps)}

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        return tuple(sorted({*self._edges, *(e.parent for e in self._edges.values())}))

    def way(self, frame: str) -> list[str]:
        """The frame and its ancestors; a loop in a bad log ends the way."""
        way = [frame]
        while way[-1] in self._edges and self._edges[way[-1]].parent not in way:
            way.append(self._edges[way[-1]].parent)
        return way

    def root(self, frame: str) -> str:
        """The top of the tree that holds `frame`; the frame itself if it has no parent."""
        return self.way(frame)[-1]

    def connected(self, a: str, b: str) -> bool:
        """Whether the log has a chain of transforms between two frames."""
        return self.root(a) == self.root(b)

    def lookup(
        self, target: str, source: str, stamp_ns: int, hold_ns: int | None = HOLD_NS
    ) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]] | None:
        """Rotation matrix and translation (metres) which take points of `source` to `target` at a time, or None.

        Between samples: linear and slerp. Outside of them the nearest sample holds for `hold_ns`, None: for ever.
        """
        if (target, source) in self._cache:
            return self._cache[target, source]
        below, above = self.way(source), self.way(target)
        meet = next((frame for frame in below if frame in above), None)
        if meet is None:
            return None
        chains = below[: below.index(meet)], above[: above.index(meet)]
        both = []
        for chain in chains:
            rotation, translation = np.eye(3), np.zeros(3)
            for frame in chain:
                step = self._edges[frame].at(stamp_ns, hold_ns)
                if step is None:
                    return None
                rotation, translation = step[0] @ rotation, step[0] @ translation + step[1]
            both.append((rotation, translation))
        (rs, ts), (rt, tt) = both
        result = rt.T @ rs, rt.T @ (ts - tt)
        if target == self._near[0]:
            result = result[0], result[1] - self._near[1]
        if all(len(self._edges[frame].stamps) == 0 for frame in chains[0] + chains[1]):
            self._cache[target, source] = result
        return result


def _edge(parent: str, stamps: np.ndarray, numbers: np.ndarray) -> _Edge:
    translations, quaternions = numbers[:, :3].copy(), numbers[:, 3:].copy()
    quaternions[(quaternions == 0).all(1)] = [0, 0, 0, 1]
    return _Edge(parent, stamps, translations, Rotation.from_quat(quaternions))


def _moving(parent: str, samples: list[_Samples]) -> list[_Edge]:
    """A moving frame: one edge, or one for each of the publishers who disagree about it."""
    stamps, numbers = (np.concatenate(parts) for parts in zip(*samples))
    samples.clear()
    # Stable sort, then the last of equal stamps: a later message corrects an earlier one.
    order = np.argsort(stamps, kind="stable")
    kept = order[np.append(np.diff(stamps[order]) != 0, True)]
    stamps, numbers = stamps[kept], numbers[kept]
    if np.ptp(numbers, axis=0).max() < 1e-9:
        # never moves; Foxglove has no word for static, and such logs may give it only once
        stamps, numbers = stamps[:1], numbers[:1]
    edge = _edge(parent, stamps if len(stamps) > 1 else stamps[:0], numbers)
    which = to_and_fro(edge.translations, edge.rotations.as_quat())
    if which is None:
        return [edge]
    return [_edge(parent, stamps[which == k], numbers[which == k]) for k in range(which.max() + 1)]


def _away(p: np.ndarray, q: np.ndarray, other_p: np.ndarray, other_q: np.ndarray) -> np.ndarray:
    """How far poses are from others, metres; `q` of length 1."""
    # by the chord between quaternions: by their product equal ones may be 4e-8 apart
    chord = np.minimum(np.linalg.norm(q - other_q, axis=-1), np.linalg.norm(q + other_q, axis=-1))
    turn = 4 * np.arcsin(np.clip(chord / 2, 0, 1))
    return np.linalg.norm(p - other_p, axis=-1) + LEVER * turn


def to_and_fro(
    translations: Float[np.ndarray, "sample 3"], quaternions: Float[np.ndarray, "sample 4"]
) -> Int64[np.ndarray, " sample"] | None:
    """For a frame that jumps repeatedly between a few poses (of several publishers, at any rates; each may move): which
    of them each sample has. None for others."""
    p, q = translations, quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    step = _away(p[1:], q[1:], p[:-1], q[:-1])
    jumps = np.flatnonzero(step > JUMP)
    if len(jumps) < FEWEST:
        return None
    which, now = np.zeros(len(p), np.int64), 0
    last = np.array([jumps[0]])  # sample of each pose
    for jump, to in zip(jumps, [*jumps[1:], len(p) - 1]):
        last[now] = jump
        back = _away(p[last], q[last], p[jump + 1], q[jump + 1])
        back[now] = np.inf
        now = int(back.argmin())
        if back[now] >= SAME * step[jump]:
            now, last = len(last), np.append(last, to)
        if len(last) > MOST:
            return None
        which[jump + 1 : to + 1] = now
    return which


def plausible(
    translation: Float[np.ndarray, "*poses 3"], rotation: Float[np.ndarray, "*poses 4"]
) -> Bool[np.ndarray, "*poses"]:
    """Whether poses are plausible: a position on earth, metres, and a quaternion with a norm near 1, or of zeros (not
    filled in). Its square neither overflows nor vanishes."""
    largest = np.abs(rotation).max(-1)
    low, high = QUATERNION
    # NaN fails every comparison
    there = np.abs(translation).max(-1) < PLACE
    return np.asarray(there & (((low < largest) & (largest < high)) | (largest == 0)))
