"""Tries the size of another start, since a bent or walking person is taller than the points show. Host side."""

from dataclasses import dataclass
from typing import ClassVar

from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import FAR_RIVAL, StartHypothesis, trial
from voodoo_jax.trackers.icp.start.later_start import LaterStart
from voodoo_jax.trackers.icp.start.stage import Search


@dataclass(frozen=True)
class TallerSize:
    """The largest size among other standing starts that explains the points as well."""

    name: ClassVar = "taller_size"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points"})

    def __call__(self, run: Runner, search: Search) -> Search:
        if search.stance is not None:
            return search
        best = search.best
        near = [b for b in search.found if b.cost < FAR_RIVAL * best.cost]
        taller = [b.body for b in near if float(b.body.scale) > 1.01 * float(best.body.scale)]
        for body in sorted(taller, key=lambda b: float(b.scale), reverse=True):
            tried: StartHypothesis = trial(run, best.frame, body)
            if tried.cost < LaterStart.as_well * best.cost:  # otherwise the highest point was a raised hand
                return search._replace(best=tried)
        return search
