"""Settings that are tried, and a trial of some of them on a recording. Worker processes import this."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from experiments.common import Log, human, without_features
from experiments.judged import Recorded, Verdict, judge, read
from voodoo_jax.settings import Settings

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


def settings_of(choice: Choice) -> Settings:
    """The default settings with some of them changed."""
    settings = Settings()
    for name, value in choice:
        stage, option = name.split(".")
        settings = replace(settings, **{stage: replace(getattr(settings, stage), **{option: value})})
    return settings


def work(job: Job) -> Verdict:
    """Tracks and judges."""
    recorded, log = _told_apart(job.log, job.frames)
    people = log.people if job.features else without_features(log.people)
    return judge(recorded, log, log.track(human(), settings_of(job.choice), people))


@cache
def _told_apart(path: Path, frames: int) -> tuple[Recorded, Log]:
    recorded = read(path, Settings(), frames)
    log = recorded.log(human(), Settings())
    return replace(recorded, frames=[]), log
