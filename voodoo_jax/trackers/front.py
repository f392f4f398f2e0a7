"""`vj.track` and `vj.track_people`: a recording in memory, by the tracker that settings name."""

from dataclasses import replace
from typing import Literal

from voodoo_jax.compile.cache_dir import users_cache
from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import Body
from voodoo_jax.records.recording import Recording
from voodoo_jax.records.tracks import Tracks, for_users
from voodoo_jax.trackers.base import Progress, Task, alone, check_arguments, source_of, tracker_of
from voodoo_jax.trackers.stages import check_stages


@users_cache()
def track(
    body: Body,
    recording: Recording,
    settings: Settings | None = None,
    progress: Progress | None = None,
    *,
    tracker: Literal["", "icp", "flexible", "both"] = "",
) -> Tracks:
    """Tracks a body through a recording; it finds the person's start, place and size.

    **Arguments:** `body` any body, scaled to the person unless `settings.start.scale` is set; `progress` is
    called with the number of frames done since the last call, for each pass (see README); `tracker` instead of the one
    in `settings`.

    **Returns:** Tracks in the recording's fixed frame, one row per frame of the recording.

    Raises Unsuitable (a ValueError) if the tracker cannot take the recording or the body.
    """
    settings = replace(settings or Settings(), tracker=tracker) if tracker else settings or Settings()
    return for_users(_tracked(body, recording, alone(settings), progress)[0], recording)


@users_cache()
def track_people(
    body: Body,
    recording: Recording,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> list[Tracks]:
    """Tracks all people in a recording, or `settings.detect.people` of them; it finds their start, place and size.

    **Arguments:** `body` for each of them, scaled to each person; the others as for `track`.

    **Returns:** Tracks for each person, those in view for longest first, with one row per frame of the recording;
    frames without the person are not `tracked`. The list has one entry at least, also for a recording without people.
    """
    return [for_users(tracks, recording) for tracks in _tracked(body, recording, settings or Settings(), progress)]


def _tracked(body: Body, recording: Recording, settings: Settings, progress: Progress | None) -> list[Tracks]:
    """By the tracker that settings name, in the recording's own places."""
    check_arguments([body], [recording])
    check_stages(settings)
    chosen, task = tracker_of(settings), Task(body, source_of(recording), settings, progress)
    if recording.frames:
        chosen.prepare(task)
    return chosen.track(task, recording)
