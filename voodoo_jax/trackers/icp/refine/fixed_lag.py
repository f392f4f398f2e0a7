"""Results that may wait: a pass back in time from as far ahead as settings allow, made one with the pass forwards."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from voodoo_jax.trackers.icp.refine.forward_backward import ForwardBackward
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.shared.segment import Followed


@dataclass(frozen=True)
class FixedLag:
    """Frames between half and all of `online_lag` ago, in a pass back in time from now, see ForwardBackward: the result
    for a frame knows nothing that is later than that frame by more than the lag. With a pass for every frame each frame
    would know all of it, and be tracked as often as there are frames in a lag; so each is tracked three times."""

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
        return found
