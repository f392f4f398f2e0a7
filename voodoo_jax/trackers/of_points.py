"""The tracker of 3D points (setting `tracker = "icp"`): ICP for measured surfaces, and a fit of named points for
recordings of these alone."""

from collections.abc import Iterable
from dataclasses import replace

from voodoo_jax.detect.pipeline import find_people, only_named
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene, Subject
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import Task, Tracker
from voodoo_jax.trackers.icp.people import main_first, numbered, track_subjects
from voodoo_jax.trackers.icp.tracker import placed, prepare, track_poses
from voodoo_jax.trackers.markers.tracker import prepare as prepare_named
from voodoo_jax.trackers.markers.tracker import track_all_named, track_named
from voodoo_jax.trackers.shared.runner import names_alone


class PointTracker(Tracker):
    """Fits limbs to 3D points (Knoop et al. 2006, 2007); for recordings of named points alone, to these."""

    def prepare(self, task: Task) -> None:
        (prepare if task.source.sensors else prepare_named)(task)

    def track(self, task: Task, frames: Iterable[Frame]) -> list[Tracks]:
        source, found = task.source, find_people if task.source.sensors else only_named
        tracks = self.follow(task, found(frames, source.up, task.body, task.settings, source.up_is_given))
        return numbered(tracks, main_first(tracks))

    def follow(self, task: Task, people: list[Subject]) -> list[Tracks]:
        """Tracks of people who were found before."""
        if names_alone(people[0].frames):
            return track_all_named(task, people)
        each = task.progress and (lambda count, tell=task.progress: tell(count / len(people)))
        return track_subjects(replace(task, progress=each), people)


def track_person(task: Task, scene: Scene, people: list[BodyObservation]) -> Tracks:
    """Tracks a body through frames in which it was separated from its surroundings before (see find_body)."""
    subject = Subject(1, scene, people)
    return track_named(task, subject) if names_alone(people) else placed(track_poses(task, subject))
