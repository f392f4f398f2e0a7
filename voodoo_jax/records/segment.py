"""Rows of a segment: arrays of consecutive frames that were tracked as one. Host side."""

import numpy as np
from jaxtyping import Bool

from voodoo_jax.geometry.rigid import Poses

Rows = dict[str, np.ndarray]  # arrays of Tracks, and "cost" [frame], square metres; leading axis: frame
# what tracks take from each Step as it is
SEEN = {name: name for name in ("residual", "explained", "steps", "limb_weight")} | {"limb_covariance": "covariance"}
PASSAGE = ("status", "rotation", "translation", "cost", "passes_apart", *SEEN)


def pose_at(rows: Rows, at: int) -> Poses:
    """The pose in one of the frames."""
    return Poses(rows["rotation"][at], rows["translation"][at])


def part(rows: Rows, begin: int | None, end: int | None) -> Rows:
    """Some of the frames."""
    return {name: row[begin:end] for name, row in rows.items()}


def with_part(rows: Rows, begin: int, other: Rows, taken: Bool[np.ndarray, " frame"]) -> Rows:
    """The rows with those of other ones that begin in frame `begin`, where they are taken."""
    at = begin + np.flatnonzero(taken)
    found = {name: np.array(row) for name, row in rows.items()}
    for name, row in found.items():
        row[at] = other[name][taken]
    return found
