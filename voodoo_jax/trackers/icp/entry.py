"""The ICP tracker behind the interface of all trackers."""

from collections.abc import Iterable
from typing import Any, ClassVar

from voodoo_jax.config.options import ReadSettings, Settings
from voodoo_jax.detect.pipeline import find_people, only_named
from voodoo_jax.markers.own_sites import apart_by_names
from voodoo_jax.markers.upward import with_upward
from voodoo_jax.model.body import Body
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.subject import Subject
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import Progress, Source
from voodoo_jax.trackers.icp.people import track_subjects
from voodoo_jax.trackers.icp.runner import by_markers
from voodoo_jax.trackers.icp.tracker import prepare


class IcpTracker:
    """Limbs as cylinders that are fitted to 3D points (Knoop et al. 2006, 2007)."""

    name: ClassVar[str] = "icp"

    def reads(self, read: ReadSettings) -> ReadSettings:
        return read

    def passes(self, settings: Settings) -> int:
        return 1 + settings.looks_ahead("track")

    def prepare(self, body: Body, settings: Settings, source: Source) -> None:
        prepare(body, settings, source.sensors, source.names, source.parts)

    def track(
        self,
        body: Body,
        frames: Iterable[Frame],
        source: Source,
        settings: Settings,
        progress: Progress | None = None,
        visit: Any = None,
    ) -> list[Tracks]:
        found = find_people if source.sensors else only_named
        people = found(frames, source.up, body, settings, source.up_is_given)
        return self.follow(body, people, source, settings, progress, visit)

    def follow(  # 6 parameters beside itself, those of `track`
        self,
        body: Body,
        people: list[Subject],
        source: Source,
        settings: Settings,
        progress: Progress | None = None,
        visit: Any = None,
    ) -> list[Tracks]:
        """Tracks of people who were found before; the others as for `track`."""
        of_points = by_markers(people[0].frames)
        if settings.detect.people != 1 and of_points:
            people = apart_by_names(people[0], body.topology, settings.features)[: settings.detect.people or None]
        each = progress and (lambda count: progress(count / len(people)))
        tracks = track_subjects(body, people, settings, source.path, source.fixed_frame, source.notes(), each, visit)
        return with_upward(tracks, source.up) if of_points and not source.up_is_given else tracks
