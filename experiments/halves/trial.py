"""Settings that are tried, and a trial of some of them on a recording. Worker processes import this."""

from dataclasses import dataclass
from pathlib import Path

from experiments.common import human, settings_with, without_features
from experiments.judged import Verdict, judge, told_apart

Choice = tuple[tuple[str, float], ...]  # stage.option and its value; what is not named is as by default
# about a factor of two below and above the default
TRIED: dict[str, tuple[float, ...]] = {
    "solve.ratio": (0.3, 1.2),
    "solve.floor": (0.015, 0.06),
    "solve.robust_scale": (0.1, 0.22),
    "solve.prior": (0.0001, 0.001),
    "solve.steady": (0.0, 16.0),
    "track.damping": (0.5, 0.9),
    "solve.max_distance": (0.25, 0.5),
}


@dataclass(frozen=True)
class Job:
    """Some settings on one recording."""

    choice: Choice
    log: Path
    features: bool
    frames: int = 0


def work(job: Job) -> Verdict:
    """Tracks and judges."""
    recorded, log = told_apart(job.log, frames=job.frames)
    people = log.people if job.features else without_features(log.people)
    return judge(recorded, log, log.track(human(), settings_with(dict(job.choice)), people))
