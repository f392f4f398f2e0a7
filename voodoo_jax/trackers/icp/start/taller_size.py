"""Tries the size of another start, since people who bend or walk are taller than they look. Host side."""

from dataclasses import dataclass
from typing import ClassVar

from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis, trial
from voodoo_jax.trackers.icp.start.stage import Search


@dataclass(frozen=True)
class TallerSize:
    """The largest size of other standing starts that explains as much. Numbers were chosen by hand."""

    name: ClassVar = "taller_size"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points"})

    alike: float = 3.0  # starts that cost less than so much more than the best may tell the size
    as_well: float = 1.2  # times what it costs in the size that it seems to have, at most, where it is taken for taller
    most: int = 2  # sizes that are tried

    def __call__(self, run: Runner, search: Search) -> Search:
        if search.stance is not None:
            return search
        best = search.best
        near = [b for b in search.found if b.cost < self.alike * best.cost]
        taller = [b.body for b in near if float(b.body.scale) > 1.01 * float(best.body.scale)]
        for body in sorted(taller, key=lambda b: float(b.scale), reverse=True)[: self.most]:
            tried: StartHypothesis = trial(run, best.frame, body)
            if tried.cost < self.as_well * best.cost:  # else a hand was what was highest
                return search._replace(best=tried)
        return search
