"""What tells people from other things in one frame."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int

from voodoo_jax.detect.body_likelihood import HEAD, TELLING, Build
from voodoo_jax.geometry.voxels import cells_of, unique_cells

CELL = 0.06  # metres, of the cells whose number is the area that is seen, however dense points are


class Thing(NamedTuple):
    """Features of an object: lengths as shares of the body's height or width, of which the former may be its own if the
    body's is not known; areas as shares of height times width, their logarithms."""

    top: float  # above the floor
    area: float
    width: float  # level, from end to end
    head: float  # area of what is hardly below its top
    bottom: float  # of its lower end above the floor, as a share of its top
    extent: float  # diagonal of its box
    depth: float  # standard deviation on the level, where it is least
    flat: float  # logarithm of its width beside its height, from its lower end on
    upper: float  # level, from end to end, of what is hardly below its top


def described(
    points: Float32[np.ndarray, "point 3"],
    label: Int[np.ndarray, " point"],
    places: Float32[np.ndarray, "3 point"],
    body: Build,
) -> tuple[Int[np.ndarray, " thing"], Float[np.ndarray, "thing feature"]]:
    """Labels of the objects with enough points, and the features of each as in Thing.

    **Arguments:** `label` of each point's object; `places` heights above the floor and level coordinates, metres.
    """
    height, level = places[0], places[1:]
    things, rows = np.flatnonzero(np.bincount(label) >= TELLING), []
    for k in things:
        mine = np.flatnonzero(label == k)
        low, top = np.percentile(height[mine], [0.5, 99.5])
        own = np.clip(top / body.height, 1 - body.loose, 1 + body.loose)
        high, wide = own * body.height, own * body.width
        extent = np.ptp(np.percentile(points[mine], [2, 98], axis=0), axis=0)
        upper = mine[height[mine] > top - HEAD[0] * high]
        off = level[:, mine] - level[:, mine].mean(1, keepdims=True)
        depth = np.sqrt(np.linalg.eigvalsh(off @ off.T / len(mine))[0].clip(0))
        width, broad = (np.hypot(*np.ptp(level[:, some], axis=1)) / wide for some in (mine, upper))
        area, head = (
            np.log(len(unique_cells(cells_of(points[some], CELL))[0]) * CELL**2 / (wide * high))
            for some in (mine, upper)
        )
        rows.append(Thing(
            top / high, area, width, head, low / top, np.linalg.norm(extent) / max(high, wide), depth / wide,
            np.log(width / max(top - low, 1e-3) * high), broad,
        ))  # fmt: skip
    return things, np.array(rows).reshape(len(things), len(Thing._fields))
