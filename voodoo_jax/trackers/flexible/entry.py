"""The flexible tracker behind the interface of all trackers."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, ClassVar

from voodoo_jax.config.options import ReadSettings, Settings
from voodoo_jax.model.body import Body
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import Progress, Source
from voodoo_jax.trackers.flexible.tracker import track_frames


class FlexibleTracker:
    """Masses and springs, particle filters on images (Hecht, Azad, Dillmann 2009)."""

    name: ClassVar[str] = "flexible"

    def reads(self, read: ReadSettings) -> ReadSettings:
        """With images; pairs are not matched by the reader, for the tracker does so as far as it needs depth."""
        return replace(read, images=True, matching="none")

    def passes(self, settings: Settings) -> int:
        return 1 + (settings.flexible.backwards and not settings.online)

    def prepare(self, body: Body, settings: Settings, source: Source) -> None:
        """Nothing: its program depends on the size of the images."""

    def track(
        self,
        body: Body,
        frames: Iterable[Frame],
        source: Source,
        settings: Settings,
        progress: Progress | None = None,
        visit: Any = None,
    ) -> list[Tracks]:
        """The main person alone: nobody else is told apart in images."""
        return [track_frames(body, frames, source, settings, progress)]
