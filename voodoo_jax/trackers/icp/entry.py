"""The ICP tracker behind the interface of all trackers."""

from collections.abc import Iterable
from typing import ClassVar

from voodoo_jax.config.options import ReadSettings, Settings
from voodoo_jax.detect.pipeline import find_people, only_named
from voodoo_jax.markers.own_sites import apart_by_names
from voodoo_jax.markers.upward import with_upward
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.subject import Subject
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import Task
from voodoo_jax.trackers.icp.people import main_first, numbered, track_subjects
from voodoo_jax.trackers.icp.runner import by_markers
from voodoo_jax.trackers.icp.tracker import prepare


class IcpTracker:
    """Limbs as cylinders that are fitted to 3D points (Knoop et al. 2006, 2007)."""

    name: ClassVar[str] = "icp"

    def reads(self, read: ReadSettings) -> ReadSettings:
        return read

    def passes(self, settings: Settings) -> int:
        return 1 + settings.looks_ahead("track")

    def prepare(self, task: Task) -> None:
        prepare(task.body, task.settings, task.source.sensors, task.source.names, task.source.parts)

    def track(self, task: Task, frames: Iterable[Frame]) -> list[Tracks]:
        source, found = task.source, find_people if task.source.sensors else only_named
        tracks = self.follow(task, found(frames, source.up, task.body, task.settings, source.up_is_given))
        return numbered(tracks, main_first(tracks))

    def follow(self, task: Task, people: list[Subject]) -> list[Tracks]:
        """Tracks of people who were found before."""
        settings, source, of_points = task.settings, task.source, by_markers(people[0].frames)
        if settings.detect.people != 1 and of_points:
            people = apart_by_names(people[0], task.body.topology, settings.features)[: settings.detect.people or None]
        each = task.progress and (lambda count, tell=task.progress: tell(count / len(people)))
        log = source.path, source.fixed_frame, source.notes()
        tracks = track_subjects(task.body, people, settings, *log, each, task.visit)
        return with_upward(tracks, source.up) if of_points and not source.up_is_given else tracks
