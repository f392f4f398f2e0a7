"""Tries the size of another start, since a bent or walking person is taller than the points show. Host side."""

from dataclasses import dataclass
from typing import ClassVar

from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis, trial
from voodoo_jax.trackers.icp.start.stage import Search


@dataclass(frozen=True)
class TallerSize:
    """The largest size among other standing starts that explains the points as well. Numbers were chosen by hand."""

    name: ClassVar = "taller_size"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points"})

    alike: float = 3.0  # starts below this multiple of the best cost give sizes to try
    as_well: float = 1.2  # a larger size is taken up to this multiple of the cost in the measured size
    most: int = 2  # sizes to try

    def __call__(self, run: Runner, search: Search) -> Search:
        if search.stance is not None:
            return search
        best = search.best
        near = [b for b in search.found if b.cost < self.alike * best.cost]
        taller = [b.body for b in near if float(b.body.scale) > 1.01 * float(best.body.scale)]
        for body in sorted(taller, key=lambda b: float(b.scale), reverse=True)[: self.most]:
            tried: StartHypothesis = trial(run, best.frame, body)
            if tried.cost < self.as_well * best.cost:  # otherwise the highest point was a raised hand
                return search._replace(best=tried)
        return search
