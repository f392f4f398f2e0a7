"""Finds points between a sensor and the body, which may hide limbs: furniture, and other people. Host side, NumPy."""

import numpy as np
from jaxtyping import Float32, Int

from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.point_cloud import even_share, picked
from voodoo_jax.records.observation import BodyObservation

# points of a frame that are looked at first, and those that are kept at most: two in a limb's width; by hand
LOOKED_AT, KEPT = 2500, 400
# of those looked at first: measured, up to 6 where nothing is between, 8 and more where somebody else is 1 m nearer
# than who is 5 m from a camera of 320 x 288 pixels. And of those kept, by hand; fewer may be noise
ANY, FEWEST = 8, 20
ASIDE = 0.6  # metres beside the body's middle that limbs reach, by hand
LOW = 0.05  # metres above the floor: nothing stands behind what is lower; by hand
NEAR = 0.5  # metres, on the level, from a sensor above the body: nothing is between them; by hand
SOME = 200  # points of the body that tell its middle, by hand


def in_the_way(
    frame: BodyObservation, own: Int[np.ndarray, " own"], floor: Plane
) -> tuple[Float32[np.ndarray, "some 3"], Int[np.ndarray, " some"]]:
    """Some points of a whole frame that are between a sensor and the body, or where its hidden limbs may be, and which
    sensor saw each.

    **Arguments:** `own` indices of the body's points, which are none of them.
    """
    nothing = np.zeros((0, 3), np.float32), np.zeros(0, np.int8)
    if not len(own):
        return nothing
    middle = np.sort(frame.points[own[:: len(own) // SOME + 1]], 0)
    middle = middle[len(middle) // 2]
    whole = max(0, (len(frame.points) // LOOKED_AT).bit_length())
    kept = _between(frame, own, floor, middle, whole)
    if len(kept) < ANY:
        return nothing
    if whole and len(kept) < KEPT:  # again, of as many points as it takes
        kept = _between(frame, own, floor, middle, max(0, whole - (KEPT // len(kept)).bit_length()))
    kept = kept[:: len(kept) // KEPT + 1] if len(kept) >= FEWEST else kept[:0]
    return frame.points[kept], frame.sensor[kept].astype(np.int8)


def _between(
    frame: BodyObservation, own: Int[np.ndarray, " own"], floor: Plane, middle: Float32[np.ndarray, "3"], halved: int
) -> Int[np.ndarray, " some"]:
    """Indices of the points between a sensor and the body's `middle`, `halved` that many times."""
    some = even_share(0.5**halved, len(frame.points))  # few shares, for which indices are kept
    points, sensor = picked(frame.points, some), frame.sensor[some]
    up, origins = floor.normal, frame.origins
    way = middle - origins
    way -= (way @ up)[:, None] * up  # on the level
    far = np.linalg.norm(way, axis=1)
    way /= np.maximum(far, NEAR)[:, None]
    kept, height = np.zeros(0, int), floor.height(points)
    for k in np.flatnonzero(far > NEAR):
        (x, y, z), (u, v, w) = way[k], up
        axes = np.array([way[k], (v * z - w * y, w * x - u * z, u * y - v * x)], np.float32)  # along, across: up x way
        along, aside = axes @ points.T - (axes @ origins[k])[:, None]
        between = (along > 0) & (along < far[k]) & (np.abs(aside) * far[k] < ASIDE * along) & (height > LOW)
        if len(origins) > 1:
            between &= sensor == k
        kept = np.concatenate([kept, np.flatnonzero(between)])
    kept, of_body = some[kept], np.zeros(len(frame.points), bool)
    of_body[own] = True
    return kept[~of_body[kept]]
