"""Size of people whose lower body is outside the image, without a visible floor: from head and shoulders, not from the
height of the head.

Host side.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from voodoo_jax.model.body import scaled
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import HIDDEN, lowest, trial
from voodoo_jax.trackers.icp.start.stage import Search
from voodoo_jax.trackers.shared.confidence import STATURE, STATURES


@dataclass(frozen=True)
class CutOffSize:
    """If the assumed floor would make a person unusually tall or small: the best of starts in several sizes, each on a
    floor at that distance below the head. Unusual sizes must explain more. Numbers were chosen by hand, except for the
    distribution of stature."""

    name: ClassVar = "cut_off_size"
    looks_ahead: ClassVar = False
    needs: ClassVar = frozenset({"points"})

    # standard deviations; people of sizes in between are taken to stand on the assumed floor
    sizes: tuple[float, ...] = (-2.0, -1.0, 0.0, 1.0, 2.0)

    def __call__(self, run: Runner, search: Search) -> Search:
        best, scene = search.best, run.scene
        known = run.sized or run.settings.start.scale > 0 or run.body.scale_name != "stature" or scene.floor_seen
        usual = abs(float(best.body.scale) - STATURE) < max(self.sizes) * STATURES
        if known or usual or lowest(run, run.people[best.frame]) < HIDDEN:
            return search
        found = [(best.cost, scene, best)]
        for size in STATURE + STATURES * np.array(self.sizes):
            deeper = float(size) - float(best.body.scale)
            run.scene = replace(scene, floor=replace(scene.floor, offset=scene.floor.offset - deeper))
            tried = trial(run, best.frame, scaled(run.body, float(size)))
            found.append((tried.cost, run.scene, tried))
        _, run.scene, best = min(found, key=lambda each: each[0])
        return search._replace(best=best, found=(best,))
