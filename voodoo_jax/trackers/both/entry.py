"""Both trackers together, behind the interface of all trackers."""

import time
from collections.abc import Iterable
from dataclasses import replace

from voodoo_jax.config.options import ReadSettings, Settings
from voodoo_jax.detect.pipeline import find_people
from voodoo_jax.records.notes import as_few
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Subject
from voodoo_jax.records.tracks import Tracks, scale_confidence
from voodoo_jax.trackers.base import Task, Tracker
from voodoo_jax.trackers.both.merge import merged
from voodoo_jax.trackers.flexible.entry import FlexibleTracker
from voodoo_jax.trackers.flexible.observed import Watching
from voodoo_jax.trackers.flexible.tracker import check_suited, follow
from voodoo_jax.trackers.icp.diagnostics import log_doubts
from voodoo_jax.trackers.icp.people import main_first, numbered
from voodoo_jax.trackers.of_points import PointTracker
from voodoo_jax.trackers.shared.notes import looked_at_again

NOBODY = "The flexible tracker found nobody: these are the ICP tracker's tracks."
MOVING = "The camera moves, and the log does not say so: these are the ICP tracker's tracks."


class BothTrackers(Tracker):
    """The ICP tracker's tracks; those of the main person are merged with the flexible tracker's."""

    def __init__(self):
        self._icp, self._flexible = PointTracker(), FlexibleTracker()

    def reads(self, read: ReadSettings) -> ReadSettings:
        """Adds images; the flexible tracker matches stereo pairs that the reader does not match."""
        return replace(read, images=True)

    def passes(self, settings: Settings) -> int:
        return self._icp.passes(settings) + self._flexible.passes(settings)

    def prepare(self, task: Task) -> None:
        self._icp.prepare(task)

    def track(self, task: Task, frames: Iterable[Frame]) -> list[Tracks]:
        """Tracks all people by points, and the main person in images, too."""
        body, settings, source = task.body, task.settings, task.source
        check_suited(body, settings)
        watching = Watching(settings, source.path, given=True)
        try:
            people = find_people(watching(frames), source.up, body, settings, source.up_is_given)
            icp = self._icp.follow(task, people)
            order = main_first(icp)
            began, person = time.perf_counter(), people[order[0]]
            seen = watching.observed([person.frames[row] for row in watching.rows], person.scene)
            flexible = follow(body, seen, settings, source.path, source.fixed_frame, (), task.progress, began)
        finally:
            watching.close()
        main, *others = numbered(icp, order)
        return [together(main, flexible, person, settings), *others]


def together(icp: Tracks, flexible: Tracks, person: Subject, settings: Settings) -> Tracks:
    """Merges the tracks of both trackers over the last frames, as many as `person` has, and applies the doubts about
    the log."""
    if not flexible.tracked.any() or any(f.T_fixed_steady is not None for f in person.frames):
        note = MOVING if flexible.tracked.any() else NOBODY
        return replace(icp.since(-len(person.frames)), notes=as_few((*icp.notes, note)))
    track = settings.track
    found = merged(icp, flexible, person.frames, track.lost_confidence, track.chunk, settings.looks_ahead("track"))
    doubts = log_doubts(icp.body, person.scene, person.frames, settings)
    found = scale_confidence(looked_at_again(found), doubts.right)
    return replace(found, notes=as_few((*found.notes, *flexible.notes)))
