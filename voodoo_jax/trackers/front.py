"""`vj.track`: a recording in memory, by the tracker that settings name."""

from dataclasses import replace
from typing import Literal

from voodoo_jax.compile.cache_dir import users_cache
from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import Body
from voodoo_jax.records.recording import Recording
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import Progress, source_of, tracker_of
from voodoo_jax.trackers.stages import check_stages


@users_cache()
def track(
    body: Body,
    recording: Recording,
    settings: Settings | None = None,
    progress: Progress | None = None,
    *,
    tracker: Literal["", "icp", "flexible"] = "",
) -> Tracks:
    """Tracks a body through a recording; nothing about the person need be known.

    **Arguments:** `body` any body, scaled to what is seen unless `settings.start.scale` says otherwise; `progress` is
    called with the number of frames done since the last call, for each pass (see README); `tracker` instead of the one
    that `settings` name.

    **Returns:** Tracks in the recording's fixed frame, one row per frame of the recording.

    Raises Unsuitable (a ValueError) if the tracker cannot take the recording or the body.
    """
    settings = settings or Settings()
    settings = replace(settings, tracker=tracker) if tracker else settings
    check_stages(settings)
    chosen, source = tracker_of(settings), source_of(recording)
    if recording.frames:
        chosen.prepare(body, settings, source)
    return chosen.track(body, recording, source, settings, progress)
