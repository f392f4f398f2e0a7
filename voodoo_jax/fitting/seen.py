"""Tracks recordings for a fit, and keeps the person's points of every frame. Host side."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Recording
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Tracks

Log = str | os.PathLike[str] | Recording


class Seen(NamedTuple):
    """One recording, tracked."""

    tracks: Tracks
    people: list[BodyObservation]
    scene: Scene  # for tracking it again with the fitted body
    given: Body | None = None  # the body before the tracker sized it; None: the tracks' own


def tracked(
    body: Body, logs: Sequence[Log], settings: Settings, tell: Callable[[str], None] = lambda what: None
) -> list[Seen]:
    """Tracks every log with the body; `tell` is called with each log's name."""
    from voodoo_jax.detect.opening import open_checked
    from voodoo_jax.detect.pipeline import build_of, find_body
    from voodoo_jax.trackers.base import LogInfo, Task
    from voodoo_jax.trackers.of_points import track_person

    seen = []
    for log in logs:
        if isinstance(log, Recording):
            source, frames = log, iter(log)
        else:
            source = open_checked(log, settings.read, build_of(body, settings.start.scale), settings.detect)
            frames = source.frames()
        tell(f"tracking {Path(source.path).name}")
        scene, people = find_body(frames, source.up, body, settings, source.up_is_given)
        found = track_person(Task(body, LogInfo(source.path, source.fixed_frame), settings), scene, people)
        seen.append(Seen(found, people, scene, body))
    return seen
