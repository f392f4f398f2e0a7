"""Compares a doubtful start with starts in later frames, which may show more. Host side."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import lowest, sized_at, trial
from voodoo_jax.trackers.icp.start.stage import Search
from voodoo_jax.trackers.shared.runner import FEW_POINTS, first_run


@dataclass(frozen=True)
class LaterStart:
    """The best of starts at `start.later` seconds, if the first one is doubtful. Numbers were chosen by hand."""

    name: ClassVar = "later_start"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points"})

    as_well: float = 1.2  # takes the earliest start below this multiple of the least cost: less is tracked backwards
    clearer: float = 0.5  # a later start must cost less than this share of the first one

    def __call__(self, run: Runner, search: Search) -> Search:
        first, found = search.best, list(search.found)
        if first.clear(run.settings.start.sure):
            return search
        low = lowest(run, run.people[search.at])
        for frame in frames_after(run, search.at):
            found.append(trial(run, frame, sized_at(run, frame, low)))
            if found[-1].clear(0.0):  # stricter than for the first start: the person was in doubt
                break
        least = min(b.cost for b in found)
        cheapest = next(b for b in found if b.cost < self.as_well * least)
        best = cheapest if cheapest.cost < self.clearer * first.cost else first
        return search._replace(best=best, found=tuple(found))


def frames_after(run: Runner, at: int) -> list[int]:
    """Frames after `at` to start from: before the first gap without points, and before the body changes."""
    end = min([len(run.people), *(frame for frame, _ in run.pending)])
    seconds = np.array([f.time_ns - run.people[at].time_ns for f in run.people[at:end]]) / 1e9
    empty = np.array([len(f.points) < FEW_POINTS for f in run.people[at:end]], bool)
    # the first gap that is too long to track across
    pause = first_run(empty, run.settings.track.patience)
    found = [int(np.searchsorted(seconds, t)) for t in run.settings.start.later]
    last = len(empty) - run.settings.start.frames  # with fewer frames one leg explains the points of the other one
    return [at + k for k in dict.fromkeys(found) if 0 < k < pause and k <= last and not empty[k]]
