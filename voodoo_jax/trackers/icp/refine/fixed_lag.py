"""Delayed results: a backward pass from the permitted delay after each frame, combined with the forward pass."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from voodoo_jax.trackers.icp.refine.forward_backward import ForwardBackward
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.shared.segment import Followed


@dataclass(frozen=True)
class FixedLag:
    """Frames between half and all of `online_lag` ago, in a backward pass from now, see ForwardBackward: the result for
    a frame uses nothing later than that frame by more than the lag. A pass for every frame would use all of the lag,
    but track each frame as often as a lag has frames; so each is tracked three times."""

    name: ClassVar = "fixed_lag"
    looks_ahead: ClassVar = False  # no farther than results wait
    needs: ClassVar = frozenset({"points", "one body", "lag"})

    passes: ForwardBackward = ForwardBackward()

    def __call__(self, run: Runner, segment: Followed) -> Followed:
        ns = np.array([f.time_ns for f in run.people[segment.first : segment.end]], np.int64)
        time, lag = (ns - ns[:1]) / 1e9, run.settings.online_lag
        at = max(0, run.bodies[-1][0] - segment.first)  # a size that was mended: before, it is another one
        found, now = segment[:at], at
        while now < len(segment):
            at, now = now, int(np.searchsorted(time, time[now] + lag, "right"))
            seen = now
            if now < len(segment):
                now = max(at + 1, int(np.searchsorted(time, time[seen - 1] - lag / 2, "right")))
            found = found.joined(self.passes(run, segment[at:seen])[: now - at])
        return replace(found, facing_odds=segment.facing_odds)  # it faces as it did
