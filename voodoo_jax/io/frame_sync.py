"""Groups messages into frames by their stamps."""

import numpy as np
from jaxtyping import Bool, Int64

from voodoo_jax.records.messages import many

PAUSE_NS = 1_000_000_000  # so long a person is expected to be where she was


def period_of(stamps: Int64[np.ndarray, " _"]) -> float:
    """Median distance of increasing stamps, nanoseconds; inf for fewer than two."""
    return float(np.median(np.diff(stamps))) if len(stamps) > 1 else np.inf


def join(
    times: Int64[np.ndarray, " frame"], period: float, stamps: Int64[np.ndarray, " message"]
) -> tuple[Int64[np.ndarray, " message"], Bool[np.ndarray, " message"]]:
    """The frame (increasing `times`, usually `period` apart, nanoseconds) nearest to each stamp, and whether the
    stamp belongs to it: within half a period of it, or between two frames that follow each other."""
    if not np.isfinite(period):
        period = 1e8  # a single frame
    after = np.clip(np.searchsorted(times, stamps), 0, len(times) - 1)
    before = np.clip(after - 1, 0, None)
    nearest = np.where(np.abs(times[after] - stamps) < np.abs(times[before] - stamps), after, before)
    inside = (times[before] <= stamps) & (stamps <= times[after]) & (times[after] - times[before] <= 1.5 * period)
    return nearest, inside | (np.abs(times[nearest] - stamps) <= 0.5 * period)


def join_one(times: Int64[np.ndarray, " frame"], stamps: Int64[np.ndarray, " message"]) -> list[tuple[int, int]]:
    """(frame, message) for each frame with a message: the one nearest in time."""
    nearest, joins = join(times, period_of(times), stamps)
    order = np.lexsort((np.abs(times[nearest] - stamps), nearest))
    order = order[joins[order]]
    frames, first = np.unique(nearest[order], return_index=True)
    return [(int(f), int(m)) for f, m in zip(frames, order[first])]


def in_pauses(
    times: Int64[np.ndarray, " frame"], stamps: Int64[np.ndarray, " message"]
) -> Bool[np.ndarray, " message"]:
    """Whether stamps (increasing) lie in a long pause of the frames, before the first or after the last included, and
    farther from the frames than they are from each other."""
    if not len(times) or not len(stamps):
        return np.ones(len(stamps), bool)
    after = np.searchsorted(times, stamps)
    begin = np.where(after > 0, times[after - 1], min(stamps[0], times[0]))
    end = np.where(after < len(times), times[np.minimum(after, len(times) - 1)], max(stamps[-1], times[-1]))
    nearest, _ = join(times, np.inf, stamps)
    return (end - begin > PAUSE_NS) & (np.abs(times[nearest] - stamps) > period_of(stamps))


def clean_stamps(name: str, stamps_ns: list[int], log_times_ns: list[int], notes: list[str]) -> np.ndarray:
    """Stamp of each of a topic's messages, nanoseconds, in the order of reading."""
    stamps, log_times = np.array(stamps_ns, np.int64), np.array(log_times_ns, np.int64)
    zero = (stamps == 0) & (log_times != 0)  # a clock that begins at 0 has a first message then
    if zero.any():
        notes.append(f"'{name}': {many(int(zero.sum()))} without header stamp; the log time is used for them.")
        stamps = np.where(zero, log_times, stamps)
    distinct = len(np.unique(stamps))
    if 2 * distinct < len(stamps) and len(np.unique(log_times)) > distinct:
        notes.append(f"'{name}': {len(stamps)} messages have only {distinct} header stamps; log time is used.")
        stamps, distinct = log_times, len(np.unique(log_times))
    backwards = int((np.diff(stamps) < 0).sum())
    if backwards:
        notes.append(f"'{name}': the stamps run backwards at {backwards} places; messages were sorted.")
    if distinct < len(stamps):
        notes.append(f"'{name}': {many(len(stamps) - distinct)} with the stamp of another, left out.")
    return stamps


def plan_frames(stamps: list[np.ndarray], places: list[np.ndarray]) -> list[tuple[int, list[tuple[int, int]]]]:
    """The messages of each frame: (time_ns, [(sensor, index)]) in order of time, each message once.

    `stamps` per sensor, increasing, sensors in name order. The fastest sensor gives the frames; messages in its pauses
    are planned again among the others.
    """
    period = np.array([period_of(s) for s in stamps])
    left = {i: np.arange(len(s)) for i, s in enumerate(stamps)}
    frames: list[tuple[int, list[tuple[int, int]]]] = []
    while left:
        # Jitter must not decide between equal rates.
        lead = next(i for i in left if period[i] <= 1.05 * min(period[j] for j in left) or len(left) == 1)
        mine = left.pop(lead)
        if not len(mine):
            continue
        times = stamps[lead][mine]
        made = [(int(t), [(lead, int(places[lead][m]))]) for t, m in zip(times, mine)]
        for other in list(left):
            rest = left[other]
            t = stamps[other][rest]
            # A lead with one message has no period: it takes what is as near as half of the other's.
            own = period[lead] if np.isfinite(period[lead]) else min(period[other], 1e8)
            nearest, joins = join(times, own, t)
            for n, m in zip(nearest[joins], rest[joins]):
                made[n][1].append((other, int(places[other][m])))
            left[other] = rest[~joins]
        frames += made
    return sorted(frames, key=lambda frame: frame[0])
