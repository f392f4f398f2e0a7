"""One trial: a changed recording or a simulated scene, tracked and judged. Worker processes import this."""

from dataclasses import dataclass
from pathlib import Path

from experiments.common import human
from experiments.judged import Verdict, judge, whole
from experiments.stress.changes import changes
from experiments.stress.scenes import scenes, shoot
from voodoo_jax.config.options import Settings


@dataclass(frozen=True)
class Job:
    """One log with one change, or one scene."""

    row: str
    log: Path | None  # None: a simulated scene
    frames: int = 0


def work(job: Job) -> Verdict:
    """Makes the recording, tracks it, judges the tracks."""
    body, settings = human(), Settings()
    if job.log is None:
        recorded = shoot(job.row, scenes()[job.row](), job.frames)
    else:
        recorded = changes(body, settings)[job.row](whole(job.log, job.frames))
    log = recorded.log(body, settings)
    return judge(recorded, log, log.track(body, settings))
