"""Which way somebody faces, by the half second that a start takes, for who may not look farther ahead. Host side."""

from dataclasses import dataclass
from typing import ClassVar

from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.segment import forwards
from voodoo_jax.trackers.icp.start.facing_odds import FacingOdds
from voodoo_jax.trackers.icp.start.stage import Search


@dataclass(frozen=True)
class FirstFacing:
    """The start's rival, where that costs hardly more or the start is in doubt, and FacingOdds are clearly for it over
    the frames that a size is found from. Who may look ahead is asked of the whole segment, later."""

    name: ClassVar = "first_facing"
    looks_ahead: ClassVar = False
    needs: ClassVar = frozenset({"points", "one body"})

    choose: FacingOdds = FacingOdds()

    def __call__(self, run: Runner, search: Search) -> Search:
        start, s, body = search.best, run.settings.start, run.body
        sure = start.close_rival is None and start.clear(s.sure)
        if run.settings.looks_ahead("track") or start.rival is None or sure:
            return search
        run.body, end = start.body, min(start.frame + s.size_frames, len(run.people))
        ways = [forwards(run, each.poses, start.frame, end) for each in (start, start.rival)]
        odds, run.body = self.choose.odds(run, start, *ways), body
        if odds > -self.choose.clearly:
            return search
        return search._replace(best=start.rival._replace(rival=start._replace(rival=None)))
