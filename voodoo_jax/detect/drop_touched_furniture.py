"""Takes out furniture that the body touched, once it is known where the body went. Host side, NumPy; looks ahead."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float32

from voodoo_jax.detect.stage import Target, windows
from voodoo_jax.geometry.voxels import cells_of, touching, unique_cells
from voodoo_jax.records.observation import PersonFrame, assigned

AWAY = 0.55  # metres from the body's axis: not part of it
MOVED = 0.4  # metres by which the body must come nearer to a thing or go farther from it, to be told from it
CELL = 0.1  # metres, of the grid in which furniture is looked for
BLOCK = 4_000_000  # cells times frames that are compared at once


@dataclass(frozen=True)
class DropTouchedFurniture:
    """What stayed in its place while the body came or went."""

    name: ClassVar = "drop_touched_furniture"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset()

    def __call__(self, frames: Iterable[PersonFrame], target: Target) -> Iterator[PersonFrame]:
        for window in windows(frames):
            yield from without_furniture(window, target.finder.scene.floor.normal)


def without_furniture(frames: list[PersonFrame], up: Float32[np.ndarray, "3"]) -> list[PersonFrame]:
    """Takes out what stayed in its place while the body came or went: furniture that the body touched.

    A cell counts as furniture where points were seen in most of the frames in which the body's axis was more than half
    a metre away, and the axis came closer or went farther by MOVED meanwhile. Uses all frames. A body that never leaves
    its place tells nothing, and its frames come back as they are.
    """
    seen = [i for i, f in enumerate(frames) if len(f.points) >= 30]
    if len(seen) < 10:
        return frames
    axis = np.full((len(frames), 3), np.nan, np.float32)
    for i in seen:
        height = frames[i].points @ up
        axis[i] = np.median(frames[i].points[height > np.percentile(height, 60)], 0)
        axis[i] -= (axis[i] @ up) * up
    if np.linalg.norm(np.ptp(axis[seen], 0)) <= MOVED:  # then no cell's distance changes by more
        return frames
    cells = [unique_cells(cells_of(frames[i].points, CELL))[0] for i in seen]
    frame_of = np.repeat(np.arange(len(seen)), [len(c) for c in cells])
    unique, which = unique_cells(np.concatenate(cells))
    middle = (unique + 0.5).astype(np.float32) * np.float32(CELL)
    middle -= (middle @ up)[:, None] * up
    # where it was seen: per occurrence; where it could have been: per cell and frame, in blocks
    distance = np.linalg.norm(middle[which] - axis[seen][frame_of], axis=1)
    seen_away = np.bincount(which, distance > AWAY, len(unique))
    nearest, farthest = np.full(len(unique), np.inf), np.zeros(len(unique))
    np.minimum.at(nearest, which, distance)
    np.maximum.at(farthest, which, distance)
    away = np.zeros(len(unique), int)
    for block in np.array_split(np.array(seen), max(1, len(seen) * len(unique) // BLOCK)):
        away += (np.linalg.norm(middle[:, None] - axis[block][None], axis=2) > AWAY).sum(1)
    share = seen_away / np.maximum(away, 1)
    furniture = unique[(farthest - nearest > MOVED) & (share > 0.5) & (away >= 8)]
    if not len(furniture):
        return frames
    # the cells around too: noise at the faces
    return [f.only(~touching(cells_of(f.points, CELL), furniture) | assigned(f)) for f in frames]
