"""All named features of a topic in one table, with their final names and stamps, without those of hidden markers:
drivers of motion capture send a placeholder for "not seen", or repeat the last position."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64

from voodoo_jax.records.messages import Features, many
from voodoo_jax.records.stretches import stretches

# names, or times one after the other, that exactly one place has: no marker with noise has that by chance; by hand
REPEATS = 3
# metres that others have moved meanwhile, and that it jumps from a place that was held, at least; by hand
JUMP = 0.02
AT_ONCE = 0.05  # metres a second: nobody who moves faster stands as still as a number at once; by hand
SHARE = 0.5  # of how far others have moved meanwhile: so far it jumps after them at least; by hand
OTHERS = 16  # names that are asked how far they have moved: some of them, for the time it takes; by hand


@dataclass(frozen=True)
class Gathered:
    """The features of a topic, one row each, in the order of reading."""

    message_stamps: Int64[np.ndarray, " message"]  # nanoseconds; messages without stamp and features are left out
    names: tuple[str, ...]
    frames: tuple[str, ...]  # "": not said
    stamps: Int64[np.ndarray, " feature"]  # nanoseconds
    values: Float[np.ndarray, "feature dim"]  # 2 pixels, or 3 metres
    scores: Float[np.ndarray, " feature"]


# metres from end to end of what is marked at one time, and the unit of numbers that would make it so; a body with
# arms stretched, or two people beside each other, by hand
EXTENTS = ((0.3, 10.0, 1.0), (30.0, 250.0, 0.01), (300.0, 10_000.0, 0.001))


def unit_of(found: "Gathered", fewest: int = 4) -> float:
    """Metres per unit of 3D features, by their extent at one time; 1 if ambiguous."""
    if found.values.shape[1:] != (3,) or len(found.values) < fewest:
        return 1.0
    times, index, count = np.unique(found.stamps, return_inverse=True, return_counts=True)
    some = np.flatnonzero(count >= fewest)[:: max(1, len(times) // 50)]
    rows = [found.values[index == k] for k in some]
    if not rows:
        return 1.0
    extent = float(np.median([np.linalg.norm(np.ptp(p, axis=0)) for p in rows]))
    return next((unit for low, high, unit in EXTENTS if low <= extent <= high), 1.0)


def gather(topic: str, messages: Sequence[Features], log_times: Sequence[int], notes: list[str]) -> Gathered:
    """Collects the messages of a topic; `notes` state where the log time replaces a missing stamp.

    A feature's own stamp comes first, then its message's. A name of several points at one time gets their number as a
    second part throughout the log: marker number 3 of `hand` is "hand/3".
    """
    last = topic.rstrip("/").rsplit("/", 1)[-1]
    own = np.array([m.stamp_ns for m in messages], np.int64)
    logged = np.array(log_times, np.int64)
    full = np.array([len(m.names) > 0 for m in messages], bool)
    still = len(own) > 1 and (own == own[0]).all() and own[0] != 0 and len(np.unique(logged)) > 1
    without = int((full & (own == 0) & (logged != 0)).sum())  # a clock that begins at 0 has a first message then
    if still:
        notes.append(f"'{topic}': {len(own)} messages have only 1 header stamp; log time is used.")
    elif without:
        notes.append(f"'{topic}': {many(without)} without header stamp; the log time is used for them.")
    of_message = logged if still else np.where(own == 0, logged, own)
    stamps = [
        np.full(len(m.names), t) if still else np.where(m.stamps == 0, t, m.stamps)
        for m, t in zip(messages, of_message)
    ]
    first: dict[tuple[str, int], str] = {}
    repeated = set()
    for m, times in zip(messages, stamps):
        for name, suffix, t in zip(m.names, m.suffixes, times.tolist()):
            if first.setdefault((name, t), suffix) != suffix:
                repeated.add(name)
        if len(first) > 100_000:
            first.clear()  # only features of one time matter, and they stand close together
    names = [
        f"{name or last}/{suffix}" if suffix and name in repeated else name or last
        for m in messages
        for name, suffix in zip(m.names, m.suffixes)
    ]
    dim = messages[0].values.shape[1] if messages else 3
    return Gathered(
        of_message[full | (own != 0)],
        tuple(names),
        tuple(frame for m in messages for frame in m.frames),
        np.concatenate([np.zeros(0, np.int64), *stamps]),
        np.concatenate([np.zeros((0, dim)), *(m.values for m in messages)]),
        np.concatenate([np.zeros(0), *(m.scores for m in messages)]),
    )


def without_placeholders(topic: str, found: Gathered, notes: list[str]) -> Gathered:
    """The features without placeholders for "not seen": repeatedly exactly the same for several names, or in all
    coordinates."""
    return _without(topic, found, _placeholders(found), "whose numbers are placeholders for 'not seen'", notes)


def without_held(topic: str, found: Gathered, notes: list[str]) -> Gathered:
    """The 3D features (metres) without those that repeat their last position until they are visible again."""
    if found.values.shape[1:] != (3,):
        return found
    return _without(topic, found, _held(found), "that repeat their last visible position", notes)


def _without(topic: str, found: Gathered, which: Bool[np.ndarray, " feature"], what: str, notes: list[str]) -> Gathered:
    if not which.any():
        return found
    kept = np.flatnonzero(~which).tolist()
    names = Counter(found.names[k] for k in np.flatnonzero(which).tolist())
    listed = ", ".join(f"'{name}' ({count} times)" for name, count in names.most_common(3))
    listed += ", ..." if len(names) > 3 else ""
    notes.append(f"'{topic}': {names.total()} features left out {what}: {listed}.")
    return replace(
        found, names=tuple(found.names[k] for k in kept), frames=tuple(found.frames[k] for k in kept),
        stamps=found.stamps[kept], values=found.values[kept], scores=found.scores[kept],
    )  # fmt: skip


def _placeholders(found: Gathered) -> Bool[np.ndarray, " feature"]:
    if not found.names:
        return np.zeros(0, bool)
    places, index, count = np.unique(found.values, axis=0, return_inverse=True, return_counts=True)
    index, alike = index.ravel(), (places == places[:, :1]).all(1)
    if found.values.shape[1] == 2:  # whole pixels may be alike by chance
        alike &= (places <= 0).all(1)
    name = _numbered(found.names)
    total = np.bincount(name)
    place, who = np.divmod(np.unique(index * len(total) + name), len(total))  # which names have been in each place
    names, some = np.bincount(place), np.zeros(len(places), int)
    some[place] = who
    # one name that has never been elsewhere is where it is, and so are all if nothing else is seen
    elsewhere = count < np.where(names > 1, len(name), total[some])
    shared = (names >= REPEATS) & (found.values.shape[1] == 3)
    # joints that a tracker has put together are in one place at one time, and in another the next
    stamp = np.unique(found.stamps, return_inverse=True)[1].ravel()
    times = np.bincount(np.unique(index * (int(stamp.max()) + 1) + stamp) // (int(stamp.max()) + 1))
    return (elsewhere & (alike & (count > REPEATS) | shared & (times > REPEATS)))[index]


def _held(found: Gathered) -> Bool[np.ndarray, " feature"]:
    """A place that repeats exactly, while others move on, and that ends by a jump after them, or with the log. A foot
    on the floor begins to move slowly, compared with how far the others have come meanwhile."""
    which, tracks = np.zeros(len(found.names), bool), list(_tracks(found))
    stopped: list[tuple[_Track, int]] = []
    for number, one in enumerate(tracks):
        step = np.linalg.norm(np.diff(one.places, axis=0), axis=1)
        others = [track for k, track in enumerate(tracks) if k != number]
        others = others[:: len(others) // OTHERS + 1]
        if not step.any():
            continue  # it has never been elsewhere
        for first, end in stretches(step == 0):  # of steps: place `end` is the last that is the same
            if end - first < REPEATS:
                continue
            ends = end == len(step)
            moved = _displacement(others, int(one.stamps[first]), int(one.stamps[end if ends else end + 1]))
            if ends and not moved:  # all stay where they are, perhaps from the midst of movement
                stopped.append((one, first))
            elif moved > JUMP and (ends or step[end] > max(JUMP, SHARE * moved)):
                which[one.rows[first + 1 : end + 1]] = True
    speeds = [one.speed(first - 1) for one, first in stopped if first > 0]
    if len(speeds) >= REPEATS and np.median(speeds) > AT_ONCE:
        for one, first in stopped:
            which[one.rows[first + 1 :]] = True
    return which


class _Track(NamedTuple):
    """The features of one name in the order of their stamps."""

    rows: Int64[np.ndarray, " some"]
    stamps: Int64[np.ndarray, " some"]  # nanoseconds
    places: Float[np.ndarray, "some 3"]  # metres

    def speed(self, at: int) -> float:
        """From one to the next, metres a second."""
        away = float(np.linalg.norm(self.places[at + 1] - self.places[at]))
        return away * 1e9 / float(self.stamps[at + 1] - self.stamps[at])


def _displacement(tracks: list[_Track], since: int, until: int) -> float:
    """Median distance between two stamps of the markers that have moved, metres; 0 if none has."""
    away = []
    for one in tracks:
        a, b = np.searchsorted(one.stamps, (since, until)).tolist()
        if b < len(one.rows):
            away.append(float(np.linalg.norm(one.places[b] - one.places[a])))
    away = [x for x in away if x > 0]
    return float(np.median(away)) if away else 0.0


def _tracks(found: Gathered) -> Iterator[_Track]:
    """Of each name that is there one at a time only."""
    names = _numbered(found.names)
    order = np.lexsort((found.stamps, names))
    for rows in np.split(order, np.flatnonzero(np.diff(names[order])) + 1):
        if len(rows) > REPEATS and (np.diff(found.stamps[rows]) > 0).all():
            yield _Track(rows, found.stamps[rows], found.values[rows])


def _numbered(names: tuple[str, ...]) -> Int64[np.ndarray, " feature"]:
    """A number for each name."""
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    return np.array([number[name] for name in names], np.int64)
