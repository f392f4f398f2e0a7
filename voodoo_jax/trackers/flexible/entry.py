"""The flexible tracker behind the interface of all trackers."""

from collections.abc import Iterable
from dataclasses import replace

from voodoo_jax.config.options import ReadSettings, Settings
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import Task, Tracker
from voodoo_jax.trackers.flexible.tracker import track_frames


class FlexibleTracker(Tracker):
    """Masses and springs with particle filters on images (Hecht, Azad, Dillmann 2009)."""

    def reads(self, read: ReadSettings) -> ReadSettings:
        """Adds images; the tracker matches stereo pairs itself, only where it needs depth."""
        return replace(read, images=True, matching="none")

    def passes(self, settings: Settings) -> int:
        return 1 + (settings.flexible.backwards and not settings.online)

    def track(self, task: Task, frames: Iterable[Frame]) -> list[Tracks]:
        """Tracks the main person alone: images do not separate several people."""
        return [track_frames(task.body, frames, task.source, task.settings, task.progress)]
