"""What joint_confidence is worth on stereo pairs, by each tracker."""

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.promises.confidence import said_and_right
from experiments.scoreboard.tracked import Outcome, TrackLog

TRACKERS = {"ICP": "default", "flexible": "flexible", "both": "both"}


def measure(logs: list[Outcome]) -> dict[str, float]:
    """By tracker, how far what is said is from what is within 10 cm."""
    out = {}
    for k, name in enumerate(TRACKERS):
        said, right = said_and_right(logs[k :: len(TRACKERS)])
        out[f"{name}: said minus right, % (absolute)"] = 100 * abs(float(said.mean() - right.mean()))
    return out


PROMISE = Promise(
    name="stereo_confidence",
    sentence="On stereo pairs what is said and what is within 10 cm differ by at most three points, by each tracker.",
    data="the nine recordings in stereo/",
    figures=tuple(Figure(f"{name}: said minus right, % (absolute)", 3.0, tolerance=1.0) for name in TRACKERS),
    jobs=lambda data: [
        TrackLog(log, preset=preset) for log in data.part(data.logs("stereo"), 2) for preset in TRACKERS.values()
    ],
    measure=measure,
)
