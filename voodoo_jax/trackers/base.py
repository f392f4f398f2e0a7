"""The interface of all trackers, and the table of trackers by name (setting `tracker`)."""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float32

from voodoo_jax.config.options import ReadSettings, Settings
from voodoo_jax.io.opened_log import LogReader
from voodoo_jax.model.body import Body
from voodoo_jax.records.recording import Frame, Recording
from voodoo_jax.records.tracks import Tracks

# called with the number of frames done since the last call, for each pass; of several people each one's share
Progress = Callable[[float], None]


class Unsuitable(ValueError):
    """The chosen tracker cannot use a recording or body; the message states the reason, and a tracker that can."""


@dataclass(frozen=True)
class LogInfo:
    """What a log states besides its frames."""

    path: str = ""
    fixed_frame: str = ""
    up: Float32[np.ndarray, "3"] = field(default_factory=lambda: np.array([0, 0, 1], np.float32))  # unit, fixed frame
    sensors: int = 1  # that give points
    names: Collection[tuple[str, ...]] = ()  # of the features that frames have at once
    parts: bool = False  # whether points have limbs assigned
    notes: Callable[[], tuple[str, ...]] = tuple  # complete once all frames were taken
    up_is_given: bool = False  # a user has said it

    def noted(self, *notes: str) -> "LogInfo":
        """The same with additional notes."""
        before = self.notes
        return replace(self, notes=lambda: (*before(), *notes)) if notes else self


@dataclass(frozen=True)
class Task:
    """A log to be tracked, with the body and the settings."""

    body: Body
    source: LogInfo
    settings: Settings
    progress: Progress | None = None
    visit: Any = None  # runs programs of several recordings as one batch, where the tracker can


class Tracker:
    """Follows a body through the frames of a log."""

    def reads(self, read: ReadSettings) -> ReadSettings:
        """How this tracker reads logs."""
        return read

    def passes(self, settings: Settings) -> int:
        """How often it reports each frame as done, not counting the reading."""
        return 1 + settings.looks_ahead("track")

    def prepare(self, task: Task) -> None:
        """Begins to compile, in threads, while the log is read."""

    def track(self, task: Task, frames: Iterable[Frame]) -> list[Tracks]:
        """Tracks of all people that the tracker distinguishes, at most `settings.detect.people` and at least one; the
        person seen longest first. One row per frame of the log. Raises Unsuitable."""
        raise NotImplementedError


TRACKERS = {
    "icp": "voodoo_jax.trackers.of_points:PointTracker",
    "flexible": "voodoo_jax.trackers.flexible.entry:FlexibleTracker",
    "both": "voodoo_jax.trackers.both.entry:BothTrackers",
}


def tracker_of(settings: Settings) -> Tracker:
    """The tracker that settings name; it is imported here."""
    module, _, name = TRACKERS[settings.tracker].partition(":")
    return getattr(import_module(module), name)()


def alone(settings: Settings) -> Settings:
    """Settings that track only the main person and search for no others."""
    return replace(settings, detect=replace(settings.detect, people=1))


def check_arguments(bodies: Iterable[Any], recordings: Iterable[Any]) -> None:
    """Raises TypeError, with a suggestion, unless these are bodies and recordings in memory."""
    for each in bodies:
        if not isinstance(each, Body):
            what, names = type(each).__name__, "vj.human(), vj.load_body(NAME) or vj.read_body(FILE)"
            raise TypeError(f"The first argument is a body, and this is of type {what}. Try {names}.")
    for each in recordings:
        if not isinstance(each, Recording):
            tracked = "vj.replay_logs([PATH], OUT) tracks files as the command does"
            what = f"The second argument is a recording in memory, and this is of type {type(each).__name__}"
            raise TypeError(f"{what}. Read the log first: vj.read_log(PATH). {tracked}.")


def source_of(recording: Recording) -> LogInfo:
    """What a recording in memory states besides its frames."""
    frames = recording.frames
    sensors = len(frames[0].origins) if frames and any(len(f.points) for f in frames) else 0
    names = {(*f.rays.names, *f.pairs.names) for f in frames}
    parts = bool(frames) and frames[0].part is not None
    r = recording
    return LogInfo(r.path, r.fixed_frame, r.up, sensors, names, parts, lambda: r.notes, r.up_is_given)


def source_of_log(log: LogReader) -> LogInfo:
    """What a log read frame by frame states besides its frames."""
    sensors, names, parts = len(log.sensors), log.named_at_once, bool(log.parts)
    return LogInfo(log.path, log.fixed_frame, log.up, sensors, names, parts, lambda: log.notes, log.up_is_given)
