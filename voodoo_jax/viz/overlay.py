"""The tracked bodies drawn over a camera image."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from voodoo_jax.exporters.limb_shapes import limb_rings, side_of
from voodoo_jax.records.recording import Picture
from voodoo_jax.records.tracks import Tracks

NEAR = 0.05  # metres before the camera, nearer than which nothing is drawn
COLOURS = {"left": (43, 86, 210), "right": (207, 98, 47), "middle": (210, 210, 210)}  # blue, green, red; as in reports


def drawn_over(
    picture: Picture, people: Sequence[Tracks], rows: Sequence[int], origin: np.ndarray | None = None,
    truth: Float[np.ndarray, "joint 3"] | None = None,
) -> UInt8[np.ndarray, "row column 3"]:  # fmt: skip
    """The image (of a pair, the left one) with outlines of limbs, in blue, green, red.

    **Arguments:** `rows` the frame of each person's tracks, -1: not there; `origin` from where the picture's places are
    given (`Recording.origin`), metres; `truth` true joint centres, drawn as crosses, metres in the fixed frame.
    """
    image = np.ascontiguousarray(picture.unpack()[0]).copy()
    T = picture.T_fixed_camera
    for tracks, row in zip(people, rows):
        if row < 0:
            continue
        rings = limb_rings(tracks, row) - (0 if origin is None else origin)
        seen = (rings - T[:3, 3]) @ T[:3, :3]
        order = np.argsort(-np.nan_to_num(seen[:, :, 2].mean(1)))
        for limb in map(int, order):
            points = seen[limb]
            if not np.isfinite(points).all() or points[:, 2].min() < NEAR:
                continue
            pixel = points @ picture.K.T
            outline = cv2.convexHull((pixel[:, :2] / pixel[:, 2:]).round().astype(np.int32))
            colour = COLOURS[side_of(tracks.body.topology.limbs[limb])]
            cv2.polylines(image, [outline], True, colour, 1 + image.shape[1] // 640, cv2.LINE_AA)
    for joint in () if truth is None else truth - (0 if origin is None else origin):
        seen = (joint - T[:3, 3]) @ T[:3, :3]
        if np.isfinite(seen).all() and seen[2] > NEAR:
            at = (picture.K @ seen / seen[2])[:2].round().astype(int)
            cv2.drawMarker(image, at.tolist(), (0, 0, 0), cv2.MARKER_TILTED_CROSS, 9, 3, cv2.LINE_AA)
            cv2.drawMarker(image, at.tolist(), (255, 255, 255), cv2.MARKER_TILTED_CROSS, 9, 1, cv2.LINE_AA)
    return image
