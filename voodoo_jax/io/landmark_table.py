"""All named features of a topic in one table, with their final names and stamps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64

from voodoo_jax.records.messages import Features, many


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
