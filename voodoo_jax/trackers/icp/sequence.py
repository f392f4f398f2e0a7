"""Tracks a whole recording of depth, segment by segment, each through the stages of refinement."""

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.tracks import Status
from voodoo_jax.solve.scan import State
from voodoo_jax.trackers.icp.initialise import begin, clearer
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.segment import backwards
from voodoo_jax.trackers.icp.stage import Named, Stage, is_active, looked, refined
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis
from voodoo_jax.trackers.shared.segment import Followed
from voodoo_jax.trackers.shared.sequence import Method, Progress, follow


@dataclass(frozen=True)
class Stages(Method):
    """Start of segments (see initialise.py), and their stages."""

    stages: tuple[Stage, ...]

    def begin(self, run: Runner, at: int, before: Poses | None) -> StartHypothesis:
        return begin(run, at, before)

    def clearer(self, run: Runner, at: int) -> StartHypothesis | None:
        return clearer(run, at)

    def looked(self, run: Runner, found: Followed) -> tuple[Followed, State | None]:
        return looked(run, found, self.stages)

    def refine(self, run: Runner, segment: Followed) -> Followed:
        return refined(run, segment, self.stages)

    def refines(self, run: Runner) -> bool:
        return any(is_active(run, stage) for stage in self.stages)


@dataclass(frozen=True)
class Whole:
    """A tracked recording between the stages for whole recordings."""

    run: Runner
    segment: Followed  # all its frames
    begin: int  # frame in which tracking began
    first: int  # the first one that was tracked, back in time from there
    enough: Bool[np.ndarray, " frame"]  # frames with points enough to look anew for a body that was lost
    notes: tuple[str, ...] = ()  # what stages want to be known

    def tracked_anew(
        self, stages: tuple[Stage, ...], people: list[BodyObservation] | None = None, body: Body | None = None
    ) -> "Whole":
        """The recording tracked again, with other points on the body, or with a body whose size is known; with the same
        notes."""
        other = track_whole(self.run.anew(people, body), self.begin, self.first, self.enough, stages)
        return replace(other, notes=self.notes)


@runtime_checkable
class RecordingStage(Named, Protocol):
    """A correction of a wholly tracked recording."""

    def __call__(self, whole: Whole) -> Whole: ...


def track_whole(
    run: Runner,
    begin: int,
    first: int,
    enough: Bool[np.ndarray, " frame"],
    stages: tuple[Stage, ...],
    progress: Progress | None = None,
) -> Whole:
    """Tracks from frame `begin` on; each segment goes through the stages. Then tracks backwards from there to frame
    `first`, if it is earlier. `enough` see Whole."""
    segment = Followed.blank(len(run.people), run.body.limb_count)
    follow(run, begin, enough, segment, Stages(stages), progress)
    if first < begin and segment.status[begin] == Status.TRACKED:
        segment.put(backwards(run, segment.pose_at(begin), first, begin + 1)[:-1])
    return Whole(run, segment, begin, first, enough)
