"""One recording, tracked: what frames say of themselves, and what is right. Worker processes import this."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.common import errors, human, nearest
from experiments.judged import root_near, whole
from experiments.stress.changes import changes
from voodoo_jax.config.options import Settings
from voodoo_jax.records.tracks import Status
from voodoo_jax.trackers.shared.confidence import CLOSE, clues


@dataclass(frozen=True)
class Job:
    """A recording, what is done to it, and whether it is tracked back in time too."""

    change: str
    both_ways: bool
    log: Path
    frames: int = 0


class Told(NamedTuple):
    """Of the frames with points and truth."""

    clues: np.ndarray  # [frame, joint, clue]
    close: np.ndarray  # [frame, joint] bool
    root: np.ndarray  # [frame] bool
    stature: float  # of the person: tells people apart


def work(job: Job) -> Told:
    """Tracks it and compares."""
    settings = Settings()
    if not job.both_ways:
        settings = replace(settings, track=replace(settings.track, skip=("looks_ahead",)))
    recorded = changes(human(), settings)[job.change](whole(job.log, job.frames))
    log = recorded.log(human(), settings)
    tracks = log.track(human(), settings)
    frame, near = nearest(log, tracks)
    told = near & np.isin(tracks.status[frame], (Status.TRACKED, Status.LOST))
    centres = tracks.body.topology.centres
    found = clues(tracks)[:, [centres.index(n) for n in log.names]]
    close = errors(log, tracks) < CLOSE
    return Told(found[frame][told], close[told], root_near(log, tracks)[told], round(recorded.dims["stature"], 3))
