"""What is between a sensor and the body, and may hide its limbs: furniture, and other people. Host side, NumPy."""

import numpy as np
from jaxtyping import Float32, Int

from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.point_cloud import even_share, picked
from voodoo_jax.records.observation import BodyObservation

# points of a frame, and those that are kept at most: two in a limb's width; by hand
LOOKED_AT, KEPT = 2500, 400
FEWEST = 20  # of those looked at: fewer may be noise; by hand
ASIDE = 0.6  # metres beside the body's middle that limbs reach, by hand
LOW = 0.05  # metres above the floor: nothing stands behind what is lower; by hand
NEAR = 0.5  # metres, on the level, from a sensor above the body: nothing is between them; by hand
SOME = 200  # points of the body that tell its middle, by hand


def in_the_way(
    frame: BodyObservation, body: Float32[np.ndarray, "point 3"], floor: Plane
) -> tuple[Float32[np.ndarray, "some 3"], Int[np.ndarray, " some"]]:
    """Some points of a whole frame that are between a sensor and the `body` (metres), or where its hidden limbs may be,
    and which sensor saw each."""
    if not len(body):
        return body, np.zeros(0, np.int8)
    halved = max(0, (len(frame.points) // LOOKED_AT).bit_length())  # few shares, for which indices are kept
    some = even_share(0.5**halved, len(frame.points))
    points, sensor = picked(frame.points, some), frame.sensor[some]
    up, origins = floor.normal, frame.origins
    middle = np.sort(body[:: len(body) // SOME + 1], 0)
    way = middle[len(middle) // 2] - origins
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
    kept = kept[:: len(kept) // KEPT + 1] if len(kept) >= FEWEST else kept[:0]
    return points[kept], sensor[kept].astype(np.int8)
