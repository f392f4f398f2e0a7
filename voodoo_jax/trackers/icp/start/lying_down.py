"""Adds starts with a lying body for low, long point sets. Host side."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from voodoo_jax.detect.body_likelihood import Extent, extent
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import Body, rest_box, scaled
from voodoo_jax.model.pose_library import CURLED, in_stance
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis, best_from, tried_on
from voodoo_jax.trackers.icp.start.stage import Search
from voodoo_jax.trackers.icp.trials import place
from voodoo_jax.trackers.shared.confidence import STATURE, STATURES

WAYS = 4  # facing up, left, down and right: any gives the same with these four
# share of half the trunk's depth by which its middle lies behind its visible points: derived, the mean distance of a
# cylinder's axis behind its near side
DEEP = np.pi / 4


@dataclass(frozen=True)
class LyingDown:
    """The best of starts along the longest horizontal extent of the points, with the head at either end, facing up,
    down and to both sides; only for low, long point sets. Arms or feet may be at the ends, and legs may be hidden or
    too close to the floor, so several sizes are tried. Unusual sizes must explain more. Numbers were chosen by hand."""

    name: ClassVar = "lying_down"
    looks_ahead: ClassVar = False
    needs: ClassVar = frozenset({"points"})

    lengths: tuple[float, ...] = (1.05, 0.96, 0.86)  # sizes, as multiples of the visible length
    usual: tuple[float, ...] = (-2.0, -0.7, 0.7, 2.0)  # further, larger sizes, in standard deviations
    larger: float = 1.12  # times the visible length: least of the further sizes
    smallest: float = 0.9  # metres: as for standing people

    def __call__(self, run: Runner, search: Search) -> Search:
        at, frames = search.best.frame, tried_on(run, search.best.frame)
        if run.body.scale_name != "stature" or not frames:
            return search
        seen = extent(frames[0].points, run.scene.floor)
        if not seen.lies:
            return search
        found: list[StartHypothesis] = []
        for body in self._list_bodies(run, search, seen):
            for rest in filter(None, (body, in_stance(body, CURLED))):
                places = lying_places(rest, frames[-1], run.scene.floor)
                found.append(best_from(run, at, body, [*places[0], *places[1]]))
        best = min(found, key=lambda one: one.cost)
        if best.cost >= search.best.cost:
            return search
        return search._replace(best=best, found=(best,))

    def _list_bodies(self, run: Runner, search: Search, seen: Extent) -> list[Body]:
        """The body in every size to try."""
        if run.sized or run.settings.start.scale > 0:
            return [search.best.body]
        usual = (STATURE + STATURES * k for k in self.usual)
        sizes = [max(self.smallest, k * seen.length) for k in self.lengths]
        return [scaled(run.body, s) for s in (*sizes, *(s for s in usual if s > self.larger * seen.length))]


def lying_places(body: Body, frame: BodyObservation, floor: Plane) -> list[list[Poses]]:
    """Lying rest poses at the points: two lists, aligned at the feet and at the head, with the same orientations (the
    head at either end, WAYS rotations about the long axis)."""
    seen, height = extent(frame.points, floor), float(rest_box(body)[1][2])
    sight = seen.middle - frame.origins[int(np.bincount(frame.sensor).argmax())]
    middle = seen.middle + DEEP * float(np.max(np.asarray(body.sizes)[:, 0])) * sight / np.linalg.norm(sight)
    angle = 2 * np.pi * np.arange(WAYS)[:, None] / WAYS
    found: list[list[Poses]] = [[], []]
    for head in (seen.axis, -seen.axis):
        facing = np.cos(angle) * floor.normal + np.sin(angle) * np.cross(floor.normal, head)
        for some, foot in zip(found, (-seen.length / 2, seen.length / 2 - height)):
            at = (middle + foot * head).astype(np.float32)
            poses = place(body, at, head.astype(np.float32), facing.astype(np.float32))
            some += [poses[k] for k in range(WAYS)]
    return found
