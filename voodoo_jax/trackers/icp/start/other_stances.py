"""A start that is in doubt is compared with starts with arms raised or sitting. Host side."""

from dataclasses import dataclass
from typing import ClassVar

from voodoo_jax.model.body import scaled
from voodoo_jax.model.pose_library import STANCES, Stance, in_stance
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis, sized_at, trial
from voodoo_jax.trackers.icp.start.stage import Search


@dataclass(frozen=True)
class OtherStances:
    """The best of starts in the stances of the pose library, for a body that can take them. Numbers by hand."""

    name: ClassVar = "other_stances"
    looks_ahead: ClassVar = False
    needs: ClassVar = frozenset({"points"})

    likelier: float = 0.8  # to stand, or what was found before, is left where another costs less than this share of it

    def __call__(self, run: Runner, search: Search) -> Search:
        # who sat before what is at rest was taken away did not stand up by that; else people stand
        earlier = run.stances.pop(search.at, None)
        posed = in_stances(run, search.best.frame) if search.best.unexplained > run.settings.start.sure else []
        odds = lambda found: found[0].cost * (self.likelier if found[1] is earlier else 1.0)  # noqa: E731
        best, stance = min([(search.best, None), *posed], key=odds)
        if stance is not None:
            run.stances[search.at] = stance
        return search._replace(best=best, stance=stance)


def in_stances(run: Runner, at: int) -> list[tuple[StartHypothesis, Stance]]:
    """Starts from frame `at` with arms raised or sitting; none for a body that can do neither."""
    found, seen = [], sized_at(run, at)
    for stance in STANCES:
        # where the size is known, so is what the highest point is
        for size in (1.0,) if run.sized else stance.sizes:
            body = seen if size == 1.0 else scaled(seen, float(seen.scale) * size)
            posed = in_stance(body, stance)
            if posed is not None:
                found.append((trial(run, at, body, rest=posed), stance))
    return found
