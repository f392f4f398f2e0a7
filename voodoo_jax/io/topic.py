"""Data on each topic from the first pass over a log."""

from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Any

from voodoo_jax.io.landmark_table import Gathered
from voodoo_jax.records.messages import Calibration, Features

DEPTH_USES = ("depth image", "point cloud", "stereo pair", "laser scan")
SKIN_USE, POSE_USE = "skin colour", "key points"  # of images that read.skin and read.pose_net look at


class Problem(Enum):
    """Why a topic gives nothing, as far as notes and errors depend on it."""

    CALIBRATION = auto()  # a depth image without a calibration that can be used
    FEATURES = auto()  # 2D features, likewise
    STEREO = auto()  # the calibrations of a pair
    BROKEN = auto()  # no message can be decoded
    LOST = auto()  # no message can be read
    CLOCK = auto()  # it differs from the others' by an unknown time
    NO_DEPTH = auto()  # an image whose content is no depth
    JPEG = auto()  # depth that was packed as a photograph


class Unused(str):
    """The use of a topic that gives nothing: "not used: <reason>"."""

    problem: Problem | None

    @classmethod
    def because(cls, reason: str, problem: Problem | None = None) -> "Unused":
        use = cls(f"not used: {reason}")
        use.problem = problem
        return use

    @property
    def reason(self) -> str:
        return self.removeprefix("not used: ")


@dataclass
class Topic:
    """Data on a topic from the first pass."""

    type: str
    encoding: str
    kind: str
    why_not: str
    stamps: list[int] = field(default_factory=list)
    log_times: list[int] = field(default_factory=list)
    sample: Any = None  # first message that could be decoded
    error: str = ""  # why the first broken message could not be
    whole: bool = True  # whether broken messages are so by their sender's making
    broken: int = 0
    calibration: Calibration | None = None
    given: Calibration | None = None  # by the settings, for this topic
    fallback: Calibration | None = None  # by the settings, for whatever has none
    features: list[Features] = field(default_factory=list)  # one per entry of log_times
    gathered: Gathered | None = None  # all of them, for a topic of features
    count: int = 0
    foreign: str = ""  # why it cannot be used though it can be decoded: its clock
    up: str = ""  # which way is up by the format that the log was converted from, as in read.up
    stated: int = 0  # number of messages by the file's own statistics
