"""The ICP tracker behind the interface of all trackers."""

from collections.abc import Iterable
from dataclasses import replace

from voodoo_jax.detect.pipeline import find_people
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Subject
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import Task, Tracker
from voodoo_jax.trackers.icp.people import track_subjects
from voodoo_jax.trackers.icp.tracker import prepare


class IcpTracker(Tracker):
    """Fits limbs, modelled as cylinders, to 3D points (Knoop et al. 2006, 2007)."""

    def prepare(self, task: Task) -> None:
        prepare(task)

    def track(self, task: Task, frames: Iterable[Frame]) -> list[Tracks]:
        source = task.source
        return self.follow(task, find_people(frames, source.up, task.body, task.settings, source.up_is_given))

    def follow(self, task: Task, people: list[Subject]) -> list[Tracks]:
        """Tracks of people who were found before."""
        each = task.progress and (lambda count, tell=task.progress: tell(count / len(people)))
        return track_subjects(replace(task, progress=each), people)
