"""Start of the backward pass: a new one near a segment's end, if that explains more. Host side."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Float32

from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.start.hypothesis import noise_of, trial, tried_on
from voodoo_jax.trackers.icp.trials import facing


@dataclass(frozen=True)
class FreshEnd:
    """Poses in a segment's last frame from a start shortly before. Numbers were chosen by hand."""

    name: ClassVar = "fresh_end"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points"})

    better: float = 0.9  # a fresh start replaces a track where it costs less than this share of it
    much_better: float = 0.5  # of its cost, where the fresh start is in doubt, too

    def __call__(
        self, run: Runner, first: int, cost: Float[np.ndarray, " frame"], rotation: Float32[np.ndarray, "frame limb 4"]
    ) -> Poses | None:
        """Poses in the last of some frames, the first of them `first`, from a new start shortly before, if it is
        certain and explains more than the track with this `cost` and these `rotation`s: so a wrong track can be
        left."""
        count = 3 * run.settings.start.frames
        skip = max(0, len(cost) - count)
        at, end = first + skip, first + len(cost)
        if end - at < 2 * run.settings.start.frames or not run.can_start(at):
            return None
        tried = tried_on(run, at)
        here = float(np.mean(cost[skip : skip + len(tried)]))
        if here - noise_of(tried) ** 2 <= run.settings.start.sure:  # it is in no doubt itself
            return None
        best = trial(run, at, run.body)
        if (rival := best.close_rival) is not None:
            # a few frames hardly tell front from back: the track knows it from all before
            ways = facing(on_host(run.body), np.stack([rotation[skip], best.poses.rotation]))
            best = best if ways[0] @ ways[1] > 0 else rival
        if not best.cost < (self.better if best.unexplained <= run.settings.start.sure else self.much_better) * here:
            return None
        return run.through(best.poses, run.people[at:end])[0].poses
