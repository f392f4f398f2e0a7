"""The tracker of named points behind the interface of all trackers."""

from collections.abc import Iterable
from dataclasses import replace

from voodoo_jax.detect.pipeline import only_named
from voodoo_jax.markers.own_sites import apart_by_names
from voodoo_jax.markers.upward import with_upward
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.subject import Subject
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import Task, Tracker
from voodoo_jax.trackers.markers.tracker import prepare, track_named


class MarkerTracker(Tracker):
    """Fits limbs to named points, each with a place of its own on the body."""

    def prepare(self, task: Task) -> None:
        prepare(task)

    def track(self, task: Task, frames: Iterable[Frame]) -> list[Tracks]:
        source = task.source
        return self.follow(task, only_named(frames, source.up, task.body, task.settings, source.up_is_given))

    def follow(self, task: Task, people: list[Subject]) -> list[Tracks]:
        """Tracks of all people that the names distinguish, at most as many as the settings allow."""
        settings, source = task.settings, task.source
        if settings.detect.people != 1:
            people = apart_by_names(people[0], task.body.topology, settings.features)[: settings.detect.people or None]
        several = sum(bool(one.name) for one in people)
        each = task.progress and (lambda count, tell=task.progress: tell(count / len(people)))
        tracks = []
        for one in people:
            whose = [f"Named points of {several} people: these tracks are of '{one.name}'."] if one.name else []
            own = replace(task, progress=each, source=source.noted(*whose))
            tracks.append(replace(track_named(own, one), person=one.number, people=len(people)))
        return tracks if source.up_is_given else with_upward(tracks, source.up)
