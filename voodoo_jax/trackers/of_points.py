"""The tracker of 3D points (setting `tracker = "icp"`): ICP for measured surfaces, and a fit of named points for
recordings of these alone."""

from collections.abc import Iterable

from voodoo_jax.detect.pipeline import find_people, only_named
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.subject import Subject
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import Task, Tracker
from voodoo_jax.trackers.icp.entry import IcpTracker
from voodoo_jax.trackers.icp.people import main_first, numbered
from voodoo_jax.trackers.icp.tracker import placed, track_poses
from voodoo_jax.trackers.markers.entry import MarkerTracker
from voodoo_jax.trackers.markers.tracker import track_named
from voodoo_jax.trackers.shared.runner import names_alone


class PointTracker(Tracker):
    """The ICP tracker, or the one of named points for recordings of these alone."""

    def prepare(self, task: Task) -> None:
        (IcpTracker() if task.source.sensors else MarkerTracker()).prepare(task)

    def track(self, task: Task, frames: Iterable[Frame]) -> list[Tracks]:
        source, found = task.source, find_people if task.source.sensors else only_named
        tracks = self.follow(task, found(frames, source.up, task.body, task.settings, source.up_is_given))
        return numbered(tracks, main_first(tracks))

    def follow(self, task: Task, people: list[Subject]) -> list[Tracks]:
        """Tracks of people who were found before."""
        return (MarkerTracker() if names_alone(people[0].frames) else IcpTracker()).follow(task, people)


def track_person(task: Task, scene: Scene, people: list[BodyObservation]) -> Tracks:
    """Tracks a body through frames in which it was separated from its surroundings before (see find_body)."""
    subject = Subject(1, scene, people)
    return track_named(task, subject) if names_alone(people) else placed(track_poses(task, subject))
