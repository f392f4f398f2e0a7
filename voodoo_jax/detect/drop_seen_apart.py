"""Removes objects that were seen apart from the body in other frames. Host side, NumPy; looks ahead."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float32

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import TELLING
from voodoo_jax.detect.segmentation import stands_aside
from voodoo_jax.detect.stage import Target, WindowStage
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.voxels import components, within
from voodoo_jax.records.observation import BodyObservation, assigned

HEAD = 0.8  # of its height: what reaches so high after a thing is taken out was a body that touched the thing


@dataclass(frozen=True)
class DropSeenApart(WindowStage):
    """Removes objects that were seen apart from the body, before or afterwards."""

    name: ClassVar = "drop_seen_apart"
    needs: ClassVar = frozenset()

    def change(self, window: list[BodyObservation], target: Target) -> list[BodyObservation]:
        finder = target.finder
        return without_things(window, finder.scene.floor, finder.apart(), finder.settings.link)


def without_things(
    frames: list[BodyObservation],
    floor: Plane,
    apart: Callable[[Float32[np.ndarray, "point 3"]], Bool[np.ndarray, " point"]],
    link: float = DetectSettings.link,
) -> list[BodyObservation]:
    """Removes objects that were seen apart from the body in other frames, before or afterwards.

    **Arguments:** `apart` selects points at places where such an object was (see BodySegmenter.apart); points nearer
    than `link` metres are of one object. If this would remove the head, the body stood there, and the frame is returned
    unchanged.
    """
    out = []
    for frame in frames:
        keep = ~apart(frame.points) | assigned(frame)
        if not keep.all() and keep.sum() >= TELLING:
            if floor.top(frame.points[keep]) >= HEAD * floor.top(frame.points):
                keep[keep] = ~_remains(frame.points[keep], frame.points[~keep], floor, link) | assigned(frame)[keep]
                frame = frame.only(keep)
        out.append(frame)
    return out


def _remains(
    points: Float32[np.ndarray, "point 3"], gone: Float32[np.ndarray, "gone 3"], floor: Plane, link: float
) -> Bool[np.ndarray, " point"]:
    """Which points remain of an object whose others are `gone`: they touch it, and are low and beside the body."""
    label = components(points, link)
    things = [points[label == k] for k in range(label.max() + 1)]
    tops = np.array([floor.top(thing) for thing in things])
    main = int(np.argmax(np.bincount(label) * (tops >= HEAD * floor.top(points))))
    left = np.zeros(len(things), bool)
    for k in np.flatnonzero(tops < 0.5 * tops[main]):
        left[k] = stands_aside(things[k], things[main], floor) and within(things[k], gone, link).any()
    return left[label]
