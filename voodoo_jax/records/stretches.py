"""Stretches of frames, and frames spread over them."""

import numpy as np
from jaxtyping import Bool, Int


def spread(length: int, count: int) -> Int[np.ndarray, " chosen"]:
    """Indices of `count` evenly spaced frames of `length`, one at least; all where there are fewer."""
    return np.unique(np.linspace(0, length - 1, min(max(count, 1), length)).round().astype(int))


def stretches(
    there: Bool[np.ndarray, " frame"], breaks: Bool[np.ndarray, " frame"] | None = None
) -> list[tuple[int, int]]:
    """Begin and end (the first frame after it) of each run of True.

    `breaks`: frames before which a run ends even so.
    """
    new = np.zeros(len(there), bool) if breaks is None else breaks
    before, after = np.concatenate([[False], there[:-1]]), np.concatenate([there[1:], [False]])
    begins = np.flatnonzero(there & (~before | new))
    ends = np.flatnonzero(there & (~after | np.concatenate([new[1:], [True]]))) + 1
    return list(zip(begins.tolist(), ends.tolist()))
