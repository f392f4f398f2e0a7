"""Removes jumps of a segment: bodies do not jump from one frame to the next. Host side.

Limbs may jump where two passes that disagree are joined, or where a stretch was tracked again: one of the two sides is
wrong. Each side is continued across the jump, and kept where it explains more.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from voodoo_jax.geometry.rotations import limb_ends
from voodoo_jax.model.body import Body
from voodoo_jax.records.segment import Segment
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.segment import backwards, forwards, pass_of
from voodoo_jax.trackers.icp.trials import moved, turns_about
from voodoo_jax.trackers.shared.segment import Followed


@dataclass(frozen=True)
class MendDiscontinuities:
    """One side of a jump carried on over the other one, where that explains more. Numbers were chosen by hand."""

    name: ClassVar = "mend_discontinuities"
    looks_ahead: ClassVar = True
    needs: ClassVar = frozenset({"points", "one body"})

    far: float = 0.2  # metres that a limb's end goes farther from one frame to the next than ...
    moves: float = 2.0  # ... so many times what it goes in the frames before and after: a jump
    same: float = 0.06  # metres between limbs' ends of poses that are the same
    most: int = 60  # frames over which one side is carried on, at most
    better: float = 0.9  # it is kept where it costs less than this share
    # where the body turns about, one of the sides is back to front: carried on where that costs less than so much more
    anyway: float = 1.1
    every: int = 30  # frames of a segment for each of the jumps that are looked at

    def __call__(self, run: Runner, segment: Followed) -> Followed:
        left: set[int] = set()
        for _ in range(1 + len(segment) // self.every):
            found = [k for k in self.jumps(run.body, segment) if k not in left]
            if not found:
                break
            other = self._mended(run, segment, found[0])
            if other is segment:
                left.add(found[0])
            segment = other
        return segment

    def jumps(self, body: Body, segment: Segment) -> list[int]:
        """Frames in which a limb that carries others has moved far from its place in the previous frame, the farthest
        jump first."""
        if len(segment) < 2:
            return []
        gone = moved(body, segment)
        usual = np.pad(gone, ((1, 1), (0, 0)))
        over = np.max(gone - self.moves * np.maximum(usual[:-2], usual[2:]), 1)
        tracked = segment.tracked
        over = np.where(tracked[1:] & tracked[:-1], over, 0.0)
        found = 1 + np.flatnonzero(over > self.far)
        return found[np.argsort(-over[found - 1])].tolist()

    def _mended(self, run: Runner, segment: Followed, at: int) -> Followed:
        """The segment with the cheaper one of the sides of the jump into its frame `at` carried on over the other one,
        up to where both are the same; the same segment if none explains more."""
        lengths, first = np.asarray(run.body.sizes)[:, 4], segment.first
        low, high = max(0, at - self.most), min(len(segment), at + self.most)
        ahead = forwards(run, segment.pose_at(at - 1), first + at - 1, first + high)
        back = backwards(run, segment.pose_at(at), first + low, first + at + 1)
        step = slice(at - 1, at + 1)
        turned = turns_about(run.body, segment.rotation[step], run.people[first + at - 1 : first + at + 1])
        found, least = segment, self.anyway if turned.any() else self.better
        for other, begin, end, order in ((ahead[1:], at, high, 1), (back[:-1], low, at, -1)):
            both = segment[begin:end], other
            mine, theirs = (limb_ends(some.rotation, some.translation, lengths) for some in both)
            same = np.max(np.linalg.norm(mine - theirs, axis=-1), (0, 2)) < self.same
            used = np.logical_and.accumulate(~same[::order])[::order]
            if not used.any():
                continue
            costs = [np.log(pass_of(run, some).cost[used]) for some in both]
            share = float(np.exp(np.mean(costs[1] - costs[0])))
            if share < least:
                found, least = segment.spliced(begin, other, used), share
        return found
