"""Size of people who are cut off below, without a visible floor: from head and shoulders, not from the head's height.

Host side.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from voodoo_jax.model.body import scaled
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import HIDDEN, TELLS, lowest, trial
from voodoo_jax.trackers.icp.start.stage import Search
from voodoo_jax.trackers.shared.confidence import STATURE, STATURES


@dataclass(frozen=True)
class CutOffSize:
    """If the assumed floor would make a person unusually tall or small: the best of starts in several sizes, each on a
    floor at that distance below the head; unusual ones must explain more. Numbers were chosen by hand, but for the
    usual stature."""

    name: ClassVar = "cut_off_size"
    looks_ahead: ClassVar = False
    needs: ClassVar = frozenset({"points"})

    usual: float = STATURE  # metres and ...
    spread: float = STATURES  # ... its standard deviation
    unusual: float = 2.0  # standard deviations: who is less unusual stands on the floor that is supposed
    sizes: tuple[float, ...] = (-2.0, -1.0, 0.0, 1.0, 2.0)  # standard deviations
    counts: float = TELLS  # odds for each of a cost

    def __call__(self, run: Runner, search: Search) -> Search:
        best, scene = search.best, run.scene
        known = run.sized or run.settings.start.scale > 0 or run.body.scale_name != "stature" or scene.floor_seen
        usual = abs(float(best.body.scale) - self.usual) < self.unusual * self.spread
        if known or usual or lowest(run, run.people[best.frame]) < HIDDEN:
            return search
        found = [(best.cost * self._unlikely(float(best.body.scale)), scene, best)]
        for size in self.usual + self.spread * np.array(self.sizes):
            deeper = float(size) - float(best.body.scale)
            run.scene = replace(scene, floor=replace(scene.floor, offset=scene.floor.offset - deeper))
            tried = trial(run, best.frame, scaled(run.body, float(size)))
            found.append((tried.cost * self._unlikely(float(size)), run.scene, tried))
        _, run.scene, best = min(found, key=lambda each: each[0])
        return search._replace(best=best, found=(best,))

    def _unlikely(self, size: float) -> float:
        """Factor on a start's cost for its size."""
        return float(np.exp(((size - self.usual) / self.spread) ** 2 / (2 * self.counts)))
