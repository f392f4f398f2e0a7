"""A frame without floor, walls and flying pixels. Host side, NumPy; one frame at a time, no look ahead."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import TELLING
from voodoo_jax.detect.scene import BEHIND
from voodoo_jax.geometry.point_cloud import along, even_share, inside, picked, point_gap, point_spacing, without_strays
from voodoo_jax.records.observation import BodyObservation, assigned, whole
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene

DENSE = 0.008  # radians between the points of a sensor in any direction: whose are closer needs no longer link
GAPS = 2.1  # times the gap between a scanner's rows: cells of half of that touch each other
USUAL_SPACING = 0.005  # radians between neighbouring points, of a sensor that has shown too few to tell


class Cleared(NamedTuple):
    """A frame without floor, walls and flying pixels, computed once for all tracklets."""

    seen: BodyObservation  # what is left of it
    index: Int[np.ndarray, " point"]  # of which of its points
    scene: Scene  # whose floor and walls are gone
    frame: Frame | BodyObservation  # all of it

    @property
    def time_ns(self) -> int:
        return self.frame.time_ns


class Clearing:
    """Floor and walls of a scene, and the spacing of each sensor's points."""

    def __init__(self, scene: Scene, settings: DetectSettings):
        self.settings = settings
        self.spacing: dict[int, float] = {}  # of each sensor: angle between neighbouring points, radians,
        self.gap: dict[int, float] = {}  # and across which there is another one in any direction
        self.take(scene)

    def another(self, scene: Scene, settings: DetectSettings) -> "Clearing":
        """One for the same sensors."""
        other = Clearing(scene, settings)
        other.spacing, other.gap = dict(self.spacing), dict(self.gap)
        return other

    def take(self, scene: Scene) -> None:
        """Uses this floor and these walls from now on."""
        across = np.linalg.svd(scene.floor.normal[None])[2][1:]  # two level directions
        self.scene = scene
        planes = (scene.floor, *scene.walls)
        self._normals = np.array([plane.normal for plane in planes], np.float32)
        self._offsets = np.array([plane.offset for plane in planes], np.float32)
        self._axes = np.array([scene.floor.normal, *across], np.float32)

    def cleared(
        self,
        frame: Frame | BodyObservation,
        share: float = 1.0,
        boxes: Sequence[tuple[np.ndarray, np.ndarray]] | None = None,
    ) -> Cleared:
        """The frame without floor, walls and flying pixels, for all tracklets: of a share of its points, those within
        the boxes (None: all)."""
        seen = whole(frame)
        index, known = even_share(share, len(seen.points)), np.flatnonzero(assigned(seen))
        if boxes is not None:
            parts = [inside(seen.points, low, high, index) for low, high in boxes]
            wanted = np.zeros(len(seen.points) if len(parts) > 1 else 0, bool)
            for part in parts if len(parts) > 1 else ():
                wanted[part] = True
            index = parts[0] if len(parts) == 1 else wanted.nonzero()[0]
        index = index[self.off_planes(picked(seen.points, index))]
        if seen.part is not None:
            index = index[seen.part[index] < 0]  # what is known passes all tests
        index = self._without_strays(seen, index, share)
        index = np.sort(np.concatenate([index, known])) if len(known) else index
        return Cleared(seen.only(index), index, self.scene, frame)

    def off_planes(self, points: Float32[np.ndarray, "point 3"]) -> Bool[np.ndarray, " point"]:
        """Which points are off floor and walls."""
        height, *walls = along(self._normals, points, self._offsets)
        off = height > self.settings.floor_margin
        for distance, wall in zip(walls, self.scene.walls):
            off &= (distance > max(0.06, wall.noise)) | (distance < -BEHIND)
        return off

    def places(self, points: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, "3 point"]:
        """Height above the floor and level coordinates, metres."""
        return along(self._axes, points, np.array([self.scene.floor.offset, 0, 0], np.float32))

    def _without_strays(self, frame: BodyObservation, index: np.ndarray, share: float) -> np.ndarray:
        """The indices, of a share of the points, without those of flying pixels: each sensor's points are compared
        among themselves."""
        kept, wider = [index[:0]], share**-0.5
        present = np.flatnonzero(np.bincount(frame.sensor[index])).tolist() if len(frame.origins) > 1 else [0]
        for sensor in present:
            mine = index[frame.sensor[index] == sensor] if len(present) > 1 else index
            points, origin = picked(frame.points, mine), frame.origins[sensor]
            spacing = self.spacing.get(sensor) or (point_spacing(points, origin) if len(points) > 4 else 0.0)
            if len(points) > 100 and sensor not in self.spacing:
                self.spacing[sensor], self.gap[sensor] = spacing, point_gap(points, origin)
            kept.append(mine[without_strays(points, origin, spacing * wider)])
        return kept[-1] if len(present) == 1 else np.sort(np.concatenate(kept))

    def of_sensors(self, known: dict[int, float], seen: BodyObservation) -> list[float]:
        """The spacings or gaps of a frame's sensors, radians."""
        return [known.get(k, USUAL_SPACING) for k in range(len(seen.origins))]

    def link(self, seen: BodyObservation) -> float:
        """Points closer than this belong to the same object, metres; at least the gaps between a scanner's rows."""
        gaps = [gap for sensor, gap in self.gap.items() if gap > 0 and (seen.sensor == sensor).sum() >= TELLING]
        if not gaps or min(gaps) < DENSE:
            return self.settings.link
        return max(self.settings.link, GAPS * min(gaps) * float(np.median(distances(seen))))


def distances(seen: BodyObservation) -> Float32[np.ndarray, " point"]:
    """Of points from their sensors, metres."""
    return np.linalg.norm(seen.points - seen.origins[seen.sensor], axis=1)
