"""Compares a doubtful start with starts with arms raised or sitting. Host side."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from voodoo_jax.model.body import scaled
from voodoo_jax.model.pose_library import STANCES, Stance, in_stance
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import BADLY, LIKELIER, StartHypothesis, size_odds, sized_at, trial
from voodoo_jax.trackers.icp.start.stage import Search


@dataclass(frozen=True)
class OtherStances:
    """The best of starts in the stances of the pose library, for a body that can take them. A person in a skirt looks
    much like a sitting person who is much taller. The worse all starts fit, the less their costs mean, so a stance
    that makes a person unusually tall must explain more."""

    name: ClassVar = "other_stances"
    looks_ahead: ClassVar = False
    needs: ClassVar = frozenset({"points"})

    def __call__(self, run: Runner, search: Search) -> Search:
        # a person sitting before static objects were removed still sits after it; otherwise people stand
        earlier = run.stances.pop(search.at, None)
        posed = in_stances(run, search.best.frame) if search.best.unexplained > run.settings.start.sure else []
        every = [(search.best, None), *posed]
        unexplained = max(min(found.unexplained for found, _ in every), 1e-9)
        fit = min(1.0, BADLY * run.settings.start.sure / unexplained)

        def penalised_cost(one: tuple[StartHypothesis, Stance | None]) -> float:
            found, stance = one
            odds = size_odds(run, found.body)
            return fit * (float(np.log(found.cost * (LIKELIER if stance is earlier else 1.0))) - odds) + odds

        best, stance = min(every, key=penalised_cost)
        if stance is not None:
            run.stances[search.at] = stance
        return search._replace(best=best, stance=stance)


def in_stances(run: Runner, at: int) -> list[tuple[StartHypothesis, Stance]]:
    """Starts from frame `at` with arms raised or sitting; none for a body without these stances."""
    found, seen = [], sized_at(run, at)
    for stance in STANCES:
        # with a known size the stance need not explain the height
        for size in (1.0,) if run.sized else stance.sizes:
            body = seen if size == 1.0 else scaled(seen, float(seen.scale) * size)
            posed = in_stance(body, stance)
            if posed is not None:
                found.append((trial(run, at, body, rest=posed), stance))
    return found
