"""Removes furniture that the body touches all the time and that is not flat. Host side, NumPy; looks ahead."""

from dataclasses import dataclass, replace
from typing import ClassVar

from voodoo_jax.detect.disk_buffer import spilled
from voodoo_jax.trackers.icp.sequence import Whole
from voodoo_jax.trackers.icp.stage import Stage
from voodoo_jax.trackers.shared.leftovers import FURNITURE_NOTE, Leftovers


@dataclass(frozen=True)
class DropUnexplained(Leftovers):
    """Tracks the recording again without points at rest that the body does not explain, as long as there are any."""

    name: ClassVar = "drop_unexplained"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body"})

    among: tuple[Stage, ...] = ()  # stages that segments go through when they are tracked anew

    def __call__(self, whole: Whole) -> Whole:
        for _ in range(self.most):
            left = self.without(whole.run.people, whole.run.bodies, whole.segment)
            if left is None:
                break
            whole = replace(whole.tracked_anew(self.among, spilled(left)), notes=(*whole.notes, FURNITURE_NOTE))
        return whole
